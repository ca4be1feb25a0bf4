"""The part that all arm drivers share, on an arm of numbers. The drivers themselves: make test-robot."""

import re
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from reorient import se3, so3
from reorient.errors import ReorientError, StationError
from reorient.stations.arms.supervised import MIN_DURATION_S, StraightPath, SupervisedArm, apart, connected, one_line

ROOT = Path(__file__).parents[2]


def pose(rotvec_rad: tuple[float, ...] = (0.0, 0.0, 0.0), t_m: tuple[float, ...] = (0.4, 0.0, 0.3)) -> np.ndarray:
    return se3.transform(so3.exp(np.array(rotvec_rad, float)), np.array(t_m, float))


@dataclass(kw_only=True, eq=False)
class NumbersArm(SupervisedArm):
    """Follows its path exactly, until ``fault`` at half of the way."""

    fault: BaseException | None = None
    jump: np.ndarray | None = None
    end: float = 1.0
    """The part of the way after which it stays."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.T, self.current, self.stops = pose(), None, 0

    def pose(self) -> np.ndarray:
        if self.current is not None:
            path, since_s = self.current
            elapsed_s = time.monotonic() - since_s
            self.T = path.at(min(elapsed_s, self.end * path.duration_s))
            if elapsed_s > path.duration_s / 2 and self.fault is not None:
                raise self.fault
            if elapsed_s > path.duration_s / 2 and self.jump is not None:
                self.T = self.jump
        return self.T

    def stop(self) -> None:
        self.current, self.stops = None, self.stops + 1

    def _begin(self, path: StraightPath) -> None:
        self.current = path, time.monotonic()

    def _executing(self) -> bool:
        path, since_s = self.current
        return time.monotonic() - since_s < path.duration_s


FAST = {"speed_m_s": 1.0, "speed_deg_s": 180.0, "acceleration_m_s2": 10.0, "acceleration_deg_s2": 2000.0}


def test_a_path_is_straight_smooth_and_within_the_limits():
    arm = NumbersArm(speed_m_s=0.1, speed_deg_s=30.0, acceleration_m_s2=0.5, acceleration_deg_s2=60.0)
    rng = np.random.default_rng(3)
    for _ in range(5):
        rotvec_rad, shift_m = so3.sample_axes(rng, 1)[0] * rng.uniform(0, 2), rng.uniform(-0.2, 0.2, 3)
        start, end = pose(so3.sample_axes(rng, 1)[0]), pose(rotvec_rad, shift_m)
        path = arm.path(start, end)
        t = np.linspace(-0.1, path.duration_s + 0.1, 150)
        T = np.array([path.at(x) for x in t])
        assert np.allclose(T[0], start)
        assert np.allclose(T[-1], end)
        steps = np.array([apart(a, b) for a, b in pairwise(T)])
        speeds = steps / np.diff(t)[:, None]
        accelerations = np.abs(np.diff(speeds, axis=0)) / np.diff(t)[1:, None]
        assert np.all(speeds.max(0) < np.array([0.1, 30.0]) * 1.01)
        assert np.all(accelerations.max(0) < np.array([0.5, 60.0]) * 1.05)
        # straight, about a fixed axis: the steps add up to the whole
        assert np.allclose(steps.sum(0), apart(start, end), rtol=1e-3, atol=1e-3)
        # not slower than needed: one of the four limits is met, or the move is the shortest one
        used = np.r_[speeds.max(0) / [0.1, 30.0], accelerations.max(0) / [0.5, 60.0]]
        assert used.max() > 0.9 or path.duration_s == MIN_DURATION_S


def test_a_move_returns_the_measured_pose():
    arm = NumbersArm(**FAST)
    goal = pose((0, 0, 0.4), (0.42, 0, 0.3))
    assert np.allclose(arm.move_to(goal), goal)
    assert arm.stops == 0


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"fault": StationError("connection lost")}, "connection lost"),
        ({"jump": pose(t_m=(0.9, 0, 0.3))}, "the measured pose jumped by"),
        ({"end": 0.5}, r"pose not reached: at rest 0.0 mm and 11.5 deg from it"),
        ({"fault": KeyboardInterrupt()}, None),
    ],
)
def test_a_failed_move_stops_the_arm_for_good(fault, message):
    arm = NumbersArm(**FAST, **fault)
    with pytest.raises((StationError, KeyboardInterrupt), match=message):
        arm.move_to(pose((0, 0, 0.4)))
    assert arm.stops == 1
    arm.fault = arm.jump = None
    with pytest.raises(StationError, match="the arm is not moved again after: "):
        arm.move_to(pose())
    assert arm.current is None


@pytest.mark.parametrize("T", [np.full((4, 4), np.nan), 2 * np.eye(4), pose(t_m=(np.inf, 0, 0))])
def test_no_pose_is_refused_before_the_arm_moves(T):
    arm = NumbersArm(**FAST)
    with pytest.raises(StationError, match="refused to move: expected T_base_tool"):
        arm.move_to(T)
    assert (arm.current, arm.stops, arm.failure) == (None, 0, "")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"speed_m_s": 0.0}, "speed_m_s=0.0: expected a number above 0"),
        ({"speed_m_s": 50.0}, "speed_m_s=50.0: expected a number above 0 to 1"),  # mm/s, perhaps
        ({"timeout_s": float("inf")}, "timeout_s=inf"),
    ],
)
def test_unsafe_limits_are_refused(settings, message):
    with pytest.raises(ReorientError, match=message):
        NumbersArm(**settings)


def test_a_connection_that_fails_or_hangs_is_one_line():
    assert connected(lambda: 3, 1.0, "a robot") == 3
    with pytest.raises(StationError, match=r"no connection \(no route\): expected a robot"):
        connected(lambda: (_ for _ in ()).throw(RuntimeError("no route\nmuch more")), 1.0, "a robot")
    with pytest.raises(StationError, match=r"no answer within 0.05 s: expected a robot"):
        connected(lambda: time.sleep(0.5), 0.05, "a robot")
    assert one_line(ValueError()) == "ValueError"


def test_each_row_of_the_conventions_is_a_test():
    page = ROOT / "docs" / "drivers.md"
    if not page.is_file():
        pytest.skip("a source distribution has no docs")
    rows = [line for line in page.read_text().split("## Conventions")[1].split("##")[0].splitlines() if line[:1] == "|"]
    assert len(rows) > 10
    for row in rows[2:]:
        file, name = re.search(r"`(tests/\S+\.py)::(\w+)`", row).groups()
        assert f"def {name}(" in (ROOT / file).read_text(), row
