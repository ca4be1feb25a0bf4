"""Algorithm 1: what it does with known estimates, how it ends, and that its record survives failures."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from reorient import Proportional, StationError, load_estimator, orient, so3
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage
from reorient.registration import Evidence
from reorient.stations.rendered import RenderedStation
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")


class Oracle:
    """Knows the station's truth; an estimator for testing the loop alone."""

    def __init__(self, station, R_goal):
        self.station, self.R_goal = station, R_goal

    def estimate(self, current, goal, pivot_m=None, history=()):
        R = self.R_goal @ self.station.R_camera_object.T
        return RotationEstimate(R, np.zeros(3), Evidence(1, 0, 0, 0, 0.0))


@pytest.fixture
def cell(mesh):
    """A station 30 degrees away from its goal: (station, goal image, goal orientation)."""
    rng = np.random.default_rng(5)
    station = RenderedStation(mesh, WORLD, randomised(), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    turn = np.radians(30)
    station.rotate(so3.matrix_from_quat(so3.sample_bounded(rng, 1, turn, turn))[0])
    return station, goal, R_goal


def left_deg(station, R_goal):
    return float(np.degrees(so3.angle_difference(R_goal, station.R_camera_object)))


def test_each_move_takes_the_share_eta(cell):
    station, goal, R_goal = cell
    left = []
    result = orient(
        station, goal, Oracle(station, R_goal), subscribers=[lambda _: left.append(left_deg(station, R_goal))]
    )
    np.testing.assert_allclose(left[:-1], 30 * 0.8 ** np.arange(1, len(left)), rtol=1e-6)  # the last step does not move
    assert result.converged
    assert left[-1] <= 0.5 < left[-3]
    assert result.moves == len(result.steps) - 1


def test_a_right_multiplied_move_would_not_converge_like_this(cell):
    station, goal, R_goal = cell

    class ObjectAxes:  # as in the paper's listing: q(k-1) q_hat
        pivot_m = None
        capture = staticmethod(station.capture)

        @staticmethod
        def rotate(R_step):
            R = station.R_camera_object
            return station.rotate(R @ R_step @ R.T)

    result = orient(ObjectAxes(), goal, Oracle(station, R_goal), Proportional(max_steps=30))
    assert left_deg(station, R_goal) > 5
    assert not result.converged


def test_gicp_closes_the_loop(cell):
    station, goal, R_goal = cell
    result = orient(station, goal, load_estimator("gicp"))
    assert result.converged
    assert left_deg(station, R_goal) < 0.6
    assert 15 <= result.moves <= 25
    assert "predicted angle" in result.reason


def test_limit(cell):
    station, goal, R_goal = cell
    result = orient(station, goal, Oracle(station, R_goal), Proportional(max_steps=3))
    assert not result.converged
    assert (len(result.steps), result.moves, result.reason) == (3, 3, "limit of 3 images")


def test_records_what_was_done_not_what_was_asked(cell):
    station, goal, R_goal = cell

    class Weak:
        pivot_m = station.pivot_m
        capture = staticmethod(station.capture)

        @staticmethod
        def rotate(R_step):
            return station.rotate(so3.exp(so3.log(R_step) / 2))

    result = orient(Weak(), goal, Oracle(station, R_goal), Proportional(max_steps=2))
    step = result.steps[0]
    assert so3.angle(step.R_executed) == pytest.approx(so3.angle(step.R_step) / 2)


@pytest.mark.parametrize(
    ("fails", "moves", "said"),
    [
        ("capture", 2, "the station failed to capture: no frame"),
        ("rotate", 2, "the station failed to rotate: refused"),
        ("nothing", 0, r"the station failed to rotate: rotate\(\) returned no rotation"),
        ("estimate", 2, "the estimator failed: current image has"),
        ("driver", 2, "the station failed to capture: OSError: unplugged"),
    ],
)
def test_failures_end_the_loop_with_the_record_kept(cell, fails, moves, said):
    station, goal, R_goal = cell

    class Failing:
        pivot_m = None
        captures = rotations = 0

        def capture(self):
            self.captures += 1
            if fails == "capture" and self.captures == 3:
                raise StationError("no frame")
            if fails == "driver" and self.captures == 3:
                raise OSError("unplugged")
            return station.capture()

        def rotate(self, R_step):
            self.rotations += 1
            if fails == "rotate" and self.rotations == 3:
                raise StationError("refused")
            done = station.rotate(R_step)
            return None if fails == "nothing" else done

    class FailingOracle(Oracle):
        calls = 0

        def estimate(self, current, goal, pivot_m=None, history=()):
            self.calls += 1
            if fails == "estimate" and self.calls == 3:
                raise ReorientError("current image has 3 returns")
            return super().estimate(current, goal)

    result = orient(Failing(), goal, FailingOracle(station, R_goal))
    assert not result.converged
    assert result.moves == moves
    assert re.search(said, result.reason)


def test_bad_arguments(cell, unchecked):
    station, goal, R_goal = cell
    with pytest.raises(ReorientError, match="expected K >= 1, 0 < eta <= 1"):
        Proportional(eta=1.5)
    with pytest.raises(ReorientError, match="goal is a ndarray: expected DepthImage"):
        orient(station, goal.depth_m, Oracle(station, R_goal))
    with pytest.raises(ReorientError, match="limits 3: expected reorient.Limits"):
        orient(station, goal, Oracle(station, R_goal), limits=3)
    with pytest.raises(ReorientError, match="max_steps ten: expected at least 2"):
        orient(station, goal, Oracle(station, R_goal), max_steps="ten")


@pytest.mark.parametrize("confidence", [None, 0.97])
def test_any_object_with_the_fields_of_an_estimate_will_do(cell, confidence):
    station, goal, R_goal = cell

    class Plain(Oracle):
        def estimate(self, current, goal, pivot_m=None, history=()):
            R = super().estimate(current, goal).R_goal_current
            t_m = station.placement.center_m - R @ station.placement.center_m
            return SimpleNamespace(R_goal_current=R.tolist(), t_goal_current_m=t_m, confidence=confidence)

    result = orient(station, goal, Plain(station, R_goal))
    assert result.converged
    assert left_deg(station, R_goal) < 0.5
    assert result.steps[-1].estimate.evidence.inlier_ratio > 0.9


@pytest.mark.parametrize(
    "answer", [None, SimpleNamespace(R_goal_current=np.zeros((3, 3)), t_goal_current_m=np.zeros(3))]
)
def test_what_is_no_estimate_is_a_failure_of_the_estimator(cell, answer):
    station, goal, _ = cell
    wrong = SimpleNamespace(estimate=lambda *_: answer)
    result = orient(station, goal, wrong, Proportional())
    assert "the estimator failed" in result.reason
    assert "expected R_goal_current, a (3, 3) rotation matrix" in result.reason


def test_what_is_no_image_is_a_failure_of_the_station(cell):
    station, goal, R_goal = cell
    blind = SimpleNamespace(capture=lambda: None, rotate=station.rotate, pivot_m=None)
    result = orient(blind, goal, Oracle(station, R_goal), Proportional())
    assert result.reason.endswith("capture() returned a NoneType: expected DepthImage(depth_m, camera)")


def test_rendered_station(mesh):
    station = RenderedStation(mesh, WORLD, randomised(), np.random.default_rng(0))
    before = station.R_camera_object
    R_step = so3.exp(np.array([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(station.rotate(R_step), R_step)
    np.testing.assert_allclose(station.R_camera_object, R_step @ before)  # on the left
    first, second = station.capture(), station.capture()
    assert isinstance(first, DepthImage)
    assert second.stamp_s > first.stamp_s
    assert np.abs(station.pivot_m - station.placement.center_m).max() <= 0.01
    assert np.count_nonzero(station.capture_goal().depth_m) > np.count_nonzero(first.depth_m)  # no rectangle on goals
    with pytest.raises(StationError, match="expected a \\(3, 3\\) rotation matrix"):
        station.rotate(2 * np.eye(3))


def test_history_takes_earlier_images_to_now(cell):
    station, goal, R_goal = cell
    seen: list = []

    class Sloppy:  # each move ends a little elsewhere, so that moves do not commute
        pivot_m = station.pivot_m
        capture = staticmethod(station.capture)

        @staticmethod
        def rotate(R_step):
            return station.rotate(so3.exp(np.array([0.3, -0.1 * len(seen), 0.2])) @ R_step)

    class Remembering(Oracle):
        def estimate(self, current, goal, pivot_m=None, history=()):
            seen.append((station.R_camera_object, list(history)))
            return super().estimate(current, goal)

    result = orient(Sloppy(), goal, Remembering(station, R_goal), Proportional(max_steps=4))
    for R_now, history in seen:
        assert [image for image, _ in history] == [step.image for step in result.steps[: len(history)]]
        for (_, R_now_then), (R_then, _) in zip(history, seen, strict=False):
            np.testing.assert_allclose(R_now_then @ R_then, R_now, atol=1e-12)
    assert [len(history) for _, history in seen] == [0, 1, 2, 3]


def test_bad_stations_and_pivots_are_refused_before_anything_moves(cell, unchecked):
    station, goal, R_goal = cell
    before = station.R_camera_object
    with pytest.raises(ReorientError, match="expected an object with estimate"):
        orient(station, goal, "gicp")
    with pytest.raises(ReorientError, match="expected an object with capture, rotate, pivot_m"):
        orient(RenderedStation, goal, Oracle(station, R_goal))
    with pytest.raises(ReorientError, match="pivot .* expected three finite metres"):
        orient(station, goal, Oracle(station, R_goal), pivot_m=np.zeros(2))
    np.testing.assert_array_equal(station.R_camera_object, before)
