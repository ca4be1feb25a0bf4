"""The loop: what it records, how it ends, limits, errors of station and estimator; Algorithm 1 in it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from oracles import NOW, WORLD, Always, Hiding, Oracle, Wrapped, left_deg
from oracles import cell as away_cell

from reorient import Algorithm1, Fusing, Limits, StationError, load_estimator, orient, so3
from reorient.controller.algorithm1 import LatestStep
from reorient.controller.base import degrees
from reorient.controller.limits import nearest_reachable
from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.stations.faulty import FaultyStation
from reorient.stations.rendered import RenderedStation
from reorient.world.sensing import randomised


@pytest.fixture
def cell(mesh):
    """A station 30 degrees away from its goal: (station, goal image, goal orientation)."""
    return away_cell(mesh, 30.0)


def uncalibrated(station, R_goal):
    return Oracle(station, R_goal, confidence=None)


def test_each_move_takes_the_share_eta(cell):
    station, goal, R_goal = cell
    left = []
    oracle = uncalibrated(station, R_goal)
    result = orient(station, goal, oracle, subscribers=[lambda _: left.append(left_deg(station, R_goal))])
    np.testing.assert_allclose(left[:-1], 30 * 0.8 ** np.arange(1, len(left)), rtol=1e-6)  # the last step does not move
    assert result.status == "converged"
    assert left[-1] <= 0.5 < left[-3]
    assert result.moves == len(result.steps) - 1


@pytest.mark.slow
def test_a_right_multiplied_move_does_not_converge(cell):
    station, goal, R_goal = cell

    class ObjectAxes(Wrapped):  # as in the paper's listing: q(k-1) q_hat
        def rotate(self, R_step):
            return station.rotate(so3.exp(station.R_camera_object @ so3.log(R_step)))

    result = orient(ObjectAxes(station), goal, uncalibrated(station, R_goal), Algorithm1(max_images=30))
    assert left_deg(station, R_goal) > 5
    assert result.status == "max_images"


def test_gicp_closes_the_loop(cell):
    station, goal, R_goal = cell
    result = orient(station, goal, load_estimator("gicp"))
    assert result.converged
    assert left_deg(station, R_goal) < 0.6
    assert 15 <= result.moves <= 25


def test_the_limit_of_images(cell):
    station, goal, R_goal = cell
    result = orient(station, goal, uncalibrated(station, R_goal), Algorithm1(max_images=3))
    assert (len(result.steps), result.moves, result.status) == (3, 3, "max_images")


def test_the_executed_move_is_recorded_beside_the_commanded_one(cell):
    station, goal, R_goal = cell

    class Weak(Wrapped):
        def rotate(self, R_step):
            return self.station.rotate(so3.exp(so3.log(R_step) / 2))

    result = orient(Weak(station), goal, uncalibrated(station, R_goal), Algorithm1(max_images=2))
    step = result.steps[0]
    assert so3.angle(step.R_executed) == pytest.approx(so3.angle(step.R_step) / 2)


class Failing(Wrapped):
    """Raises an error at the third capture or rotation, or returns nothing from a rotation."""

    captures = rotations = 0

    def __init__(self, station, fails, error):
        super().__init__(station)
        self.fails, self.error = fails, error

    def capture(self):
        self.captures += 1
        if self.fails == "capture" and self.captures == 3:
            raise self.error
        return self.station.capture()

    def rotate(self, R_step):
        self.rotations += 1
        if self.fails == "rotate" and self.rotations == 3:
            raise self.error
        done = self.station.rotate(R_step)
        return None if self.fails == "nothing" else done


@pytest.mark.parametrize(
    ("fails", "error", "status", "moves"),
    [
        ("capture", StationError("no frame"), "station_failed", 2),
        ("capture", OSError("unplugged"), "station_failed", 2),
        ("capture", KeyboardInterrupt(), "interrupted", 2),
        ("rotate", StationError("refused"), "station_failed", 2),
        ("rotate", KeyboardInterrupt(), "interrupted", 2),
        ("nothing", None, "station_failed", 0),
    ],
)
def test_an_error_of_the_station_ends_the_loop_with_the_record_kept(cell, fails, error, status, moves):
    station, goal, R_goal = cell
    result = orient(Failing(station, fails, error), goal, uncalibrated(station, R_goal))
    assert (result.status, result.moves, result.converged) == (status, moves, False)
    assert len(result.steps) == max(moves, 1) + (fails == "rotate")
    assert [step.motion_unknown for step in result.steps[-1:]] == [fails != "capture"]
    assert str(error or "no rotation") in result.reason + result.steps[-1].error


@pytest.mark.parametrize(
    ("error", "status"), [(ReorientError("empty"), "estimator_failed"), (KeyboardInterrupt(), "interrupted")]
)
def test_an_error_of_the_estimator_ends_the_loop_with_the_record_kept(cell, error, status):
    station, goal, R_goal = cell

    class Raising(Oracle):
        def estimate(self, current, goal, pivot_m=None, history=()):
            if len(self.histories) == 2:
                raise error
            return super().estimate(current, goal)

    result = orient(station, goal, Raising(station, R_goal, confidence=None))
    assert (result.status, result.moves, len(result.steps)) == (status, 2, 2)


def test_bad_arguments_are_refused_before_anything_moves(cell, unchecked):
    station, goal, R_goal = cell
    before, oracle = station.R_camera_object, uncalibrated(station, R_goal)
    for station_, goal_, estimator, more, expected in (
        (station, goal.depth_m, oracle, {}, "expected DepthImage"),
        (station, goal, oracle, {"limits": 3}, "expected reorient.Limits"),
        (station, goal, "gicp", {}, "expected an object with estimate"),
        (RenderedStation, goal, oracle, {}, "expected an object with capture, rotate, pivot_m"),
        (station, goal, oracle, {"pivot_m": np.zeros(2)}, "expected three finite metres"),
        (station, goal, oracle, {"strategy": "fusing"}, "expected an object with max_images, patience"),
        (station, goal, oracle, {"strategy": Fusing}, "expected an object with max_images, patience"),
    ):
        with pytest.raises(ReorientError, match=expected):
            orient(station_, goal_, estimator, **more)
    np.testing.assert_array_equal(station.R_camera_object, before)


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
def test_what_is_no_estimate_is_an_error_of_the_estimator(cell, answer):
    station, goal, _ = cell
    result = orient(station, goal, SimpleNamespace(estimate=lambda *_: answer), Algorithm1())
    assert result.status == "estimator_failed"
    assert len(result.errors) == 1


def test_what_is_no_image_is_an_error_of_the_station(cell):
    station, goal, R_goal = cell
    blind = SimpleNamespace(capture=lambda: None, rotate=station.rotate, pivot_m=None)
    assert orient(blind, goal, Oracle(station, R_goal), Algorithm1()).status == "station_failed"


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


@pytest.mark.parametrize("history", [True, False])
def test_the_estimator_receives_history_where_the_strategy_wants_it(cell, history):
    """Each earlier image with the rotation to now, by the executed moves."""
    station, goal, R_goal = cell
    oracle = uncalibrated(station, R_goal)
    result = orient(station, goal, oracle, Algorithm1(max_images=4, history=history))
    assert [len(images) for _, images in oracle.histories] == ([0, 1, 2, 3] if history else [0] * 4)
    for R_now, images in oracle.histories:
        assert all(image is step.image for (image, _), step in zip(images, result.steps, strict=False))
        for (_, R_now_then), (R_then, _) in zip(images, oracle.histories, strict=False):
            np.testing.assert_allclose(R_now_then @ R_then, R_now, atol=1e-12)


def test_the_default_strategy_suits_the_estimator(mesh):
    station, goal, R_goal = away_cell(mesh)
    assert orient(station, goal, Oracle(station, R_goal)).moves == 1
    station, goal, R_goal = away_cell(mesh)
    assert orient(station, goal, uncalibrated(station, R_goal)).moves > 15


@pytest.mark.parametrize(("kind", "undone"), [("gone", True), ("refused", False)])
def test_repeated_errors_end_the_loop_with_the_record_kept(mesh, kind, undone):
    station, goal, R_goal = away_cell(mesh, 60.0)
    faulty = FaultyStation(station, np.random.default_rng(0), planned=[kind] * 20)
    result = orient(faulty, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert result.status == "station_failed"
    assert result.reason == result.errors[-1]
    assert any(step.undone for step in result.steps) == undone  # then observed from the pose before, too
    assert len(result.errors) == (Fusing().patience + 1) * (1 + undone) + undone
    assert left_deg(station, R_goal) == pytest.approx(60)


@pytest.mark.parametrize(
    ("strategy", "limits", "rotates_back", "undone"),
    [
        (Fusing(), NOW, True, True),
        (Fusing(), NOW, False, True),
        (Fusing(), Limits(max_rotation_rad=np.radians(150), wait_s=0.0), True, False),
        (Algorithm1(eta=1.0, patience=3), NOW, True, False),
    ],
)
def test_a_move_that_hides_the_object_is_undone_where_that_is_possible(mesh, strategy, limits, rotates_back, undone):
    station, goal, R_goal = away_cell(mesh, 80.0)
    hiding = Hiding(station, R_goal, rotates_back)
    result = orient(hiding, goal, Oracle(station, R_goal), strategy, limits=limits)
    assert any(step.undone for step in result.steps) == undone
    assert hiding.hides() == (not (undone and rotates_back))
    assert result.status == ("unsure" if undone and rotates_back else "station_failed")


def test_an_error_of_the_estimator_is_retried_with_another_image(mesh):
    station, goal, R_goal = away_cell(mesh)

    class Moody(Oracle):
        calls = 0

        def estimate(self, *arguments):
            self.calls += 1
            if self.calls % 2:
                raise ZeroDivisionError("singular")
            return super().estimate(*arguments)

    result = orient(station, goal, Moody(station, R_goal), limits=NOW)
    assert result.converged
    assert "ZeroDivisionError: singular" in result.errors[0]


def test_a_frame_from_before_the_move_is_refused(mesh):
    station, goal, R_goal = away_cell(mesh)
    images = [station.capture(), station.capture()]  # both before any move

    class Buffered(Wrapped):
        clock_s = staticmethod(station.clock_s)

        def capture(self):
            return images.pop(0)

    result = orient(Buffered(station), goal, Oracle(station, R_goal), Algorithm1())
    assert (result.moves, result.status) == (1, "station_failed")
    assert "stale" in result.errors[0]


@pytest.mark.parametrize("clock", [True, False])
def test_frames_are_stale_by_the_last_move_alone(mesh, clock):
    """Two observations of one pose may share a stamp, and a frame may be stamped with the move's end."""
    station, goal, R_goal = away_cell(mesh)

    class Coarse(Wrapped):
        moves = 0

        def capture(self):
            return replace(self.station.capture(), stamp_s=float(self.moves))

        def rotate(self, R_step):
            self.moves += 1
            return self.station.rotate(R_step)

    coarse = Coarse(station)
    if clock:
        coarse.clock_s = lambda: np.float32(coarse.moves)
    result = orient(coarse, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert result.converged
    assert not result.errors


@pytest.mark.parametrize("clock", [True, False])
def test_frames_from_before_a_move_that_failed_are_stale_and_it_counts(mesh, clock):
    station, goal, _ = away_cell(mesh, 60.0)

    class Late(Wrapped):
        """Rotates, and then raises; its driver hands out an old frame first."""

        old = None
        rotated_deg = 0.0

        def capture(self):
            image, self.old = self.old or station.capture(), None
            return image

        def rotate(self, R_step):
            self.old = station.capture()
            station.rotate(R_step)
            self.rotated_deg += float(np.degrees(so3.angle(R_step)))
            raise TimeoutError("no answer")

    late = Late(station)
    if clock:
        late.clock_s = station.clock_s
    limits = Limits(max_rotation_rad=np.radians(100), wait_s=0.0)
    result = orient(late, goal, Always(np.radians(40)), Fusing(patience=9), limits=limits)
    assert late.rotated_deg == pytest.approx(80)
    assert result.status == "max_rotation"
    assert any("stale" in error for error in result.errors) == clock


def limited(mesh, **limits):
    """A loop from 100 degrees under limits: the result, and the rotations that the station made, in degrees."""
    station, goal, R_goal = away_cell(mesh, 100.0)
    parts = []

    class Counting(Wrapped):
        def rotate(self, R_step):
            parts.append(float(np.degrees(so3.angle(R_step))))
            return self.station.rotate(R_step)

    return orient(Counting(station), goal, Oracle(station, R_goal), Fusing(), limits=Limits(**limits)), parts


def test_limits(mesh):
    result, parts = limited(mesh, max_step_rad=np.radians(30))
    assert result.converged
    np.testing.assert_allclose(parts, [25] * 4, atol=1e-6)
    result, parts = limited(mesh, max_rotation_rad=np.radians(90))
    assert (parts, result.status) == ([], "max_rotation")
    result, parts = limited(mesh, dry_run=True)
    assert (parts, result.moves, result.status, len(result.steps)) == ([], 0, "dry_run", 1)
    assert "100.0 deg" in result.reason
    asked = []
    result, parts = limited(mesh, confirm=lambda R: bool(asked.append(R)))
    assert (parts, len(asked), result.status) == ([], 1, "declined")
    result, parts = limited(mesh, confirm=lambda R: asked.append(R) is None)
    assert result.converged
    assert len(asked) == 2  # the first move only
    with pytest.raises(ReorientError, match="expected angles above 0"):
        Limits(max_step_rad=0)


def test_a_dry_run_ends_with_the_first_decision(mesh):
    station, goal, R_goal = away_cell(mesh, 0.5)
    result = orient(station, goal, Oracle(station, R_goal), Fusing(), limits=Limits(dry_run=True))
    assert (len(result.steps), result.status, result.steps[0].phase) == (1, "dry_run", "verify")


def test_a_goal_out_of_reach_is_approached_as_far_as_possible(mesh):
    station, goal, R_goal = away_cell(mesh, 100.0)

    class Narrow(Wrapped):
        """Rotates by at most 60 degrees from where it began."""

        rotated = np.eye(3)

        def reachable(self, R_step):
            return bool(so3.angle(R_step @ self.rotated) < np.radians(60))

        def rotate(self, R_step):
            if not self.reachable(R_step):
                raise StationError("out of reach")
            self.rotated = R_step @ self.rotated
            return self.station.rotate(R_step)

    result = orient(Narrow(station), goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert result.status == "unreachable"
    assert left_deg(station, R_goal) < 47  # 40 at best


def test_nearest_reachable():
    R_step = so3.exp(np.array([0, 0, 1.5]))
    near = nearest_reachable(R_step, lambda R: float(so3.angle(R)) < 1.0)
    assert float(so3.angle_difference(near, R_step)) < 0.6
    assert nearest_reachable(R_step, lambda R: False) is None


def test_the_nearest_reachable_move_keeps_to_the_limits(mesh):
    """A station that cannot make small moves makes larger ones than were commanded."""
    asked, rotated = [], []

    class Clumsy(Wrapped):
        def reachable(self, R_step):
            return bool(so3.angle(R_step) > np.radians(50))

        def rotate(self, R_step):
            rotated.append(R_step)
            return self.station.rotate(R_step)

    def run(**limits):
        station, goal, _ = away_cell(mesh, 40.0)
        strategy = Algorithm1(eta=1.0, max_images=1)
        return orient(Clumsy(station), goal, Always(np.radians(40)), strategy, limits=Limits(wait_s=0.0, **limits))

    assert run(max_rotation_rad=np.radians(45)).status == "max_rotation"
    assert rotated == []
    run(confirm=lambda R: asked.append(R) is None)
    np.testing.assert_allclose(asked, rotated, atol=1e-12)
    assert np.degrees(so3.angle(rotated[0])) > 50
    assert f"{np.degrees(so3.angle(rotated[0])):.1f} deg" in run(dry_run=True).reason


@pytest.mark.parametrize("member", ["start", "decide", "updated"])
def test_an_error_of_the_strategy_ends_the_loop_with_the_record_kept(mesh, member):
    class Broken(LatestStep):
        """A belief that cannot be updated twice."""

        def updated(self, step):
            if self.step is not None:
                raise IndexError("pop from empty list")
            return Broken(step)

    class Own(Algorithm1):
        def start(self, goal):
            if member == "start":
                raise IndexError("pop from empty list")
            return Broken() if member == "updated" else super().start(goal)

        def decide(self, belief, reachable):
            if member == "decide":
                raise IndexError("pop from empty list")
            return super().decide(belief, reachable)

    station, goal, R_goal = away_cell(mesh)
    result = orient(station, goal, Oracle(station, R_goal), Own())
    assert (len(result.steps), result.moves, result.status) == (1, int(member == "updated"), "strategy_failed")
    assert "IndexError: pop from empty list" in result.reason


def test_numbers_in_words():
    assert (degrees(np.radians(12.346), 2), degrees(float("nan"))) == ("12.35 deg", "- deg")
