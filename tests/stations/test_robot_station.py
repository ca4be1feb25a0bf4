"""RobotStation and the checks around a camera and an arm."""

import time
from dataclasses import replace

import numpy as np
import pytest
from cells import AT_ONCE, drivers, small_cell, true_calibration

from reorient import Limits, load_estimator, load_strategy, orient, se3, so3
from reorient.controller.station import Station
from reorient.errors import ReorientError, StationError
from reorient.imaging import Isolation
from reorient.stations.guarded import FreshFrames, GuardedArm, RobotLimits, about
from reorient.stations.robot import RobotStation
from reorient.stations.simulated import SimulatedArm, SimulatedCamera

STEP = so3.exp(np.array([0.2, -0.5, 0.9]))


@pytest.fixture
def cell():
    return small_cell()


@pytest.fixture
def station(cell):
    return RobotStation(*drivers(cell), true_calibration(cell))


# --- rotations ------------------------------------------------------------------------------------------------------


def test_the_object_rotates_in_camera_axes_and_stays_in_its_place(cell, station):
    before = cell.T_camera_object
    executed = station.rotate(STEP)
    after = cell.T_camera_object
    np.testing.assert_allclose(after[:3, :3], STEP @ before[:3, :3], atol=1e-9)
    np.testing.assert_allclose(after[:3, 3], before[:3, 3], atol=1e-9)
    np.testing.assert_allclose(executed, STEP, atol=1e-9)
    assert isinstance(station, Station)


def test_each_of_two_moves_after_a_frame_reports_its_own_motion(cell, station):
    """The loop makes a large rotation in parts, without frames between them."""
    station.capture()
    for step in (STEP, STEP.T @ STEP.T, STEP):
        np.testing.assert_allclose(station.rotate(step), step, atol=1e-9)
    np.testing.assert_allclose(station.move(MOVE), MOVE, atol=1e-9)
    np.testing.assert_allclose(station.move(MOVE), MOVE, atol=1e-9)


MOVE = se3.transform(so3.exp(np.array([0.05, -0.1, 0.2])), np.array([0.03, -0.02, 0.04]))


def test_the_object_moves_in_camera_axes(cell, station):
    before = cell.T_camera_object
    executed = station.move(MOVE)
    np.testing.assert_allclose(cell.T_camera_object, MOVE @ before, atol=1e-9)
    np.testing.assert_allclose(executed, MOVE, atol=1e-9)
    np.testing.assert_allclose(station.pivot_m, (MOVE @ before)[:3, 3], atol=1e-9)


@pytest.mark.parametrize(
    ("T_step", "expected"),
    [
        (np.eye(3), "rigid"),
        (se3.transform(np.eye(3), np.array([5.0, 0.0, 0.0])), "out of reach"),
        (se3.transform(so3.exp(np.array([1.0, 0.0, 0.0])), np.zeros(3)), "rotate"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_a_wrong_move_is_refused_without_motion(cell, station, T_step, expected):
    before = cell.T_camera_object
    with pytest.raises(StationError, match=expected):
        station.move(T_step)
    np.testing.assert_array_equal(cell.T_camera_object, before)


def test_the_pivot_is_the_object_seen_by_the_camera(cell, station):
    np.testing.assert_allclose(station.pivot_m, cell.T_camera_object[:3, 3], atol=1e-9)


def test_a_large_rotation_is_made_in_parts_that_keep_the_object_in_its_place(cell, station):
    places = []
    arm = station.arm._arm
    move_to = arm.move_to
    arm.move_to = lambda T: (move_to(T), places.append(cell.T_camera_object[:3, 3]))[0]
    station.rotate(so3.exp(np.array([0.0, 2.0, 0.0])))
    assert len(places) == 4  # 115 degrees in steps of at most 30
    np.testing.assert_allclose(places, np.tile(station.pivot_m, (4, 1)), atol=1e-9)


def test_what_the_arm_did_is_reported_not_what_was_commanded(cell):
    class Lazy(SimulatedArm):
        def move_to(self, T):
            R = so3.exp(np.radians(1.5) * np.array([0, 0, 1.0]))  # within the tolerance
            return super().move_to(se3.transform(R @ T[:3, :3], T[:3, 3]))

    station = RobotStation(SimulatedCamera(cell), GuardedArm(Lazy(cell), AT_ONCE), true_calibration(cell))
    before = cell.T_camera_object[:3, :3]
    executed = station.rotate(so3.exp(np.array([0.1, 0.0, 0.0])))
    np.testing.assert_allclose(executed @ before, cell.T_camera_object[:3, :3], atol=1e-9)


def test_a_loop_converges(cell):
    station = RobotStation(*drivers(cell), true_calibration(cell))
    goal = station.capture()
    start = cell.T_camera_object[:3, :3]
    station.rotate(so3.exp(np.array([0.0, 0.3, 0.2])))
    result = orient(station, goal, load_estimator("gicp"), load_strategy("direct"), limits=Limits(wait_s=0))
    assert result.converged
    assert np.degrees(so3.angle_difference(cell.T_camera_object[:3, :3], start)) < 1


def test_the_sphere_of_an_isolation_follows_the_object(cell):
    far_off = Isolation(around_m=(0.0, 0.0, 3.0), radius_m=0.2)
    station = RobotStation(*drivers(cell), true_calibration(cell), far_off)
    assert station.capture().valid.any()


# --- limits ---------------------------------------------------------------------------------------------------------


def test_a_move_out_of_the_box_is_refused_before_any_motion(cell):
    calibration = true_calibration(cell)
    tool = cell.T_base_tool[:3, 3]
    box = replace(AT_ONCE, box_low_m=tuple(tool - 0.01), box_high_m=tuple(tool + 0.01))
    arm = SimulatedArm(cell)
    calibration = replace(calibration, p_tool_object_m=np.array([0.0, 0.0, 0.05]))
    station = RobotStation(SimulatedCamera(cell), arm, calibration, limits=box)
    assert not station.reachable(STEP)
    with pytest.raises(StationError, match="workspace box"):
        station.rotate(STEP)
    assert arm.moves == 0


def test_a_pose_on_the_way_counts(cell, station):
    half_turn = so3.exp(np.array([0.0, np.pi, 0.0]))
    middle = station._poses(half_turn, station.arm.pose())[2]
    station.arm._arm.reachable = lambda T: not np.allclose(T, middle)
    assert not station.reachable(half_turn)
    with pytest.raises(StationError, match="on the way the tool would be at"):
        station.rotate(half_turn)
    assert station.arm._arm.moves == 0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"box_low_m": (0.5, 0, 0), "box_high_m": (0.4, 1, 1)}, "expected low below high"),
        ({"box_low_m": (500.0, 0, 0)}, "box_low_m"),
        ({"max_step_deg": 0.0}, "max_step_deg"),
        ({"settle_s": -1.0}, "settle_s"),
    ],
)
def test_limits_that_allow_nothing_are_refused(values, message):
    with pytest.raises(ReorientError, match=message):
        RobotLimits(**values)


# --- failures of the arm --------------------------------------------------------------------------------------------


class Failing(SimulatedArm):
    """An arm with one failure, and a count of what it was told afterwards."""

    def __init__(self, cell, failure):
        super().__init__(cell)
        self.failure, self.stops = failure, 0

    def move_to(self, T):
        if isinstance(self.failure, BaseException):
            self.moves += 1
            raise self.failure
        super().move_to(T)
        if self.failure == "short":
            self._commanded = about(so3.exp(np.radians(4) * np.array([1.0, 0, 0])), T[:3, 3]) @ T
        return T if self.failure == "lies" else self.pose()

    def stop(self):
        self.stops += 1


@pytest.mark.parametrize(
    ("failure", "message"),
    [
        (ConnectionError("gone"), "the move failed: ConnectionError: gone"),
        (StationError("protective stop"), "the move failed: protective stop"),
        ("short", "4.0 deg off the commanded pose"),
    ],
)
def test_a_failed_move_stops_the_arm_and_nothing_is_commanded_after_it(cell, failure, message):
    arm = Failing(cell, failure)
    station = RobotStation(SimulatedCamera(cell), arm, true_calibration(cell), limits=AT_ONCE)
    with pytest.raises(StationError, match=message):
        station.rotate(so3.exp(np.array([0.1, 0, 0])))
    assert (arm.moves, arm.stops) == (1, 1)
    for act in (station.capture, lambda: station.rotate(np.eye(3))):
        with pytest.raises(StationError, match="stopped"):
            act()
    assert arm.moves == 1


def test_a_loop_with_a_failed_move_ends_with_its_record(cell):
    arm = Failing(cell, None)
    station = RobotStation(SimulatedCamera(cell), arm, true_calibration(cell), limits=AT_ONCE)
    goal = station.capture()
    station.rotate(so3.exp(np.array([0.0, 0.4, 0.0])))
    arm.failure = TimeoutError("no answer")
    result = orient(station, goal, load_estimator("gicp"), limits=Limits(wait_s=0))
    assert result.status == "station_failed"
    assert len(result.steps) == 1
    assert (arm.moves, arm.stops) == (2, 1)


def test_ctrl_c_in_a_move_stops_the_arm(cell):
    arm = Failing(cell, KeyboardInterrupt())
    station = RobotStation(SimulatedCamera(cell), arm, true_calibration(cell), limits=AT_ONCE)
    with pytest.raises(KeyboardInterrupt):
        station.rotate(STEP)
    assert arm.stops == 1
    assert station.arm.halted


def test_a_second_client_that_moves_the_arm_is_noticed(cell):
    camera, arm = drivers(cell)
    station = RobotStation(camera, arm, true_calibration(cell))
    small = so3.exp(np.array([0.1, 0, 0]))
    station.rotate(small)
    SimulatedArm.move_to(arm._arm, about(STEP, arm.pose()[:3, 3]) @ arm.pose())
    with pytest.raises(StationError, match="is another program moving the arm"):
        station.rotate(small)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), "no pose"),
        (2 * np.eye(4), "no pose"),
        (se3.transform(np.eye(3), np.array([450.0, 0, 300])), "looks like millimetres"),
        (se3.transform(np.eye(3), np.array([np.nan, 0, 0])), "not finite"),
        (None, "no pose"),
    ],
)
def test_a_pose_that_is_none_is_refused(cell, pose, message):
    arm = SimulatedArm(cell)
    arm.pose = lambda: pose
    with pytest.raises(StationError, match=message):
        GuardedArm(arm).pose()


# --- frames ---------------------------------------------------------------------------------------------------------


class Queue:
    """A camera whose frames are old: ``lag`` of them wait in a queue. Stamps are on a clock of its own."""

    def __init__(self, cell, lag, clock=True):
        self.camera, self.lag, self.waiting = SimulatedCamera(cell), lag, []
        if clock:
            self.clock_s = self.camera.clock_s

    def capture(self):
        self.waiting.append(self.camera.capture())
        return self.waiting.pop(0) if len(self.waiting) > self.lag else self.waiting[0]


def test_frames_from_before_the_move_are_skipped(cell):
    frames = FreshFrames(Queue(cell, 2))
    for _ in range(3):
        frames.whole()
    moved_s = time.monotonic()
    frames.moved()
    assert frames.whole().stamp_s >= moved_s


def test_a_camera_that_repeats_old_frames_is_refused(cell):
    frames = FreshFrames(Queue(cell, 100))
    frames.whole()
    frames.moved()
    with pytest.raises(StationError, match="stale frames"):
        frames.whole()


def test_without_a_clock_the_delay_of_a_frame_is_measured(cell):
    """A frame that arrives late, but newer than the last one, may still be from before the end of the move."""

    class Late:
        delay_s = 0.0

        def capture(self):
            image = cell.frame()
            return replace(image, stamp_s=time.monotonic() - 5000 - self.delay_s)

    camera = Late()
    frames = FreshFrames(camera)
    frames.whole()
    time.sleep(0.02)
    frames.moved()
    assert frames.whole().stamp_s is not None
    camera.delay_s = 1.0
    frames.moved()
    with pytest.raises(StationError, match="stale frames"):
        frames.whole()


def test_a_camera_that_fails_is_named(cell):
    class Broken:
        def capture(self):
            raise OSError("USB is gone")

    with pytest.raises(StationError, match="the camera failed to capture: OSError: USB is gone"):
        FreshFrames(Broken()).whole()
