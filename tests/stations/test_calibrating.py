"""Calibration with the held object, and the check that names mistakes, on a simulated cell with a knowing estimator."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cells import AT_ONCE, KnowingEstimator, drivers, small_cell, true_calibration

from reorient import calibrate, load_estimator, se3, so3
from reorient.errors import ReorientError
from reorient.perception.robot_calibration import RobotCalibration, read_robot_calibration, write_robot_calibration
from reorient.stations.checking import check
from reorient.stations.drivers import check_drivers
from reorient.stations.faulty_cell import PLANTED, planted, random_calibration
from reorient.stations.guarded import GuardedArm, RobotLimits
from reorient.stations.simulated import SimulatedArm

NOISE_RAD = float(np.radians(0.3))


@pytest.fixture(scope="module")
def calibrated():
    cell = small_cell(1)
    estimator = KnowingEstimator(cell, NOISE_RAD)
    camera, arm = drivers(cell)
    start = arm.pose()
    found = calibrate(camera, arm, estimator=estimator)
    return cell, found, start, arm.pose()


def test_the_camera_is_found(calibrated):
    cell, found, start, _ = calibrated
    error_rad = so3.angle_difference(found.T_base_camera[:3, :3], cell.T_base_camera[:3, :3])
    assert np.degrees(error_rad) < 0.5
    assert 0.02 < found.rotation_se_deg < 0.6
    pivot_m = se3.apply(se3.inverse(cell.T_base_camera) @ start, found.p_tool_object_m)
    assert np.linalg.norm(found.pivot_m(start) - pivot_m) < 0.002
    assert found.motions == found.motions_tried > 20


def test_the_objects_place_in_the_tool_is_found(calibrated):
    cell, found, _, _ = calibrated
    assert np.linalg.norm(found.p_tool_object_m - cell.T_tool_object[:3, 3]) < 0.04


def test_the_arm_ends_where_it_began(calibrated):
    _, _, start, end = calibrated
    np.testing.assert_allclose(start, end, atol=1e-12)


class Blind(KnowingEstimator):
    """Sees nothing of the rotation about the object's x axis, as of a solid of revolution."""

    def motion(self, current, goal):
        T0, T1 = self.poses[current.stamp_s], self.poses[goal.stamp_s]
        a, b = T0[:3, 0], T1[:3, 0]
        axis = np.cross(a, b)
        angle = np.arctan2(np.linalg.norm(axis), a @ b)
        R = so3.exp(axis / max(np.linalg.norm(axis), 1e-12) * angle)
        return se3.transform(R, T1[:3, 3] - R @ T0[:3, 3])


class Still(KnowingEstimator):
    def motion(self, current, goal):
        return np.eye(4)


@pytest.mark.parametrize(
    ("estimator", "message"), [(Blind, "probably symmetric.* second object"), (Still, "nothing held")]
)
def test_an_object_whose_rotation_is_not_seen_is_refused(estimator, message):
    cell = small_cell(2)
    knowing = estimator(cell)
    with pytest.raises(ReorientError, match=message):
        calibrate(*drivers(cell), estimator=knowing)


def test_no_move_is_larger_than_the_limit_and_the_tool_point_stays_in_its_place():
    cell = small_cell(1)
    limits = replace(AT_ONCE, max_step_deg=20.0)
    camera, arm = drivers(cell, limits)
    poses, move_to = [arm.pose()], arm._arm.move_to
    arm._arm.move_to = lambda T: poses.append(T) or move_to(T)
    point_m = np.array([0.0, 0.01, 0.05])
    calibrate(camera, arm, estimator=KnowingEstimator(cell), tool_point_m=point_m)
    steps_deg = [np.degrees(so3.angle_difference(a[:3, :3], b[:3, :3])) for a, b in pairwise(poses)]
    assert max(steps_deg) < 20.01
    np.testing.assert_allclose([se3.apply(T, point_m) for T in poses], [se3.apply(poses[0], point_m)] * len(poses))


def test_an_arm_without_room_is_refused_before_it_moves():
    cell = small_cell(3)
    arm = GuardedArm(drivers(cell)[1]._arm, AT_ONCE)
    arm._arm.reachable = lambda T: np.allclose(T, cell.T_base_tool)
    with pytest.raises(ReorientError, match="only 0 of 8 rotations of the tool are reachable"):
        calibrate(drivers(cell)[0], arm, estimator=KnowingEstimator(cell))
    assert arm._arm.moves == 0


# --- check ----------------------------------------------------------------------------------------------------------


def checked(mistake, seed):
    cell = small_cell(seed)
    estimator = KnowingEstimator(cell, NOISE_RAD / 2)
    camera, arm, calibration = planted(mistake, cell, random_calibration(cell, cell.rng))
    return check(camera, GuardedArm(arm, AT_ONCE, calibration.p_tool_object_m), calibration, estimator=estimator)


@pytest.mark.usefixtures("unchecked")  # for speed; the test of an upside down camera is checked
@pytest.mark.parametrize("seed", range(3))
def test_a_right_cell_passes(seed):
    result = checked("", seed)
    assert result.passed, result.message


IN_THE_IMAGE = ("stale frames", "mirrored image", "wrong intrinsics")  # an estimator must see them
SEEN = [name for name in PLANTED if name not in IN_THE_IMAGE]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("mistake", SEEN)
def test_each_mistake_is_named(mistake):
    result = checked(mistake, 10)
    assert result.mistake == mistake, result.message


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("mistake", IN_THE_IMAGE)
def test_each_mistake_in_the_image_is_named(mistake):
    cell = small_cell(20)
    camera, arm, calibration = planted(mistake, cell, random_calibration(cell, cell.rng))
    guarded = GuardedArm(arm, AT_ONCE, calibration.p_tool_object_m)
    result = check(camera, guarded, calibration, estimator=load_estimator("gicp"))
    assert result.mistake == mistake, result.message


def test_an_upside_down_camera_is_named():
    cell = small_cell(5)
    calibration = true_calibration(cell)
    upside_down = se3.transform(np.diag([-1.0, -1, 1]), np.zeros(3))
    calibration = replace(calibration, T_base_camera=calibration.T_base_camera @ upside_down)
    knowing = KnowingEstimator(cell)
    result = check(*drivers(cell), calibration, estimator=knowing)
    assert "about -y when +y was commanded" in result.message
    assert "camera mounted upside down?" in result.message


# --- the file -------------------------------------------------------------------------------------------------------


def test_a_calibration_survives_its_file(tmp_path, calibrated):
    found = calibrated[1]
    write_robot_calibration(tmp_path / "c.json", found)
    read = read_robot_calibration(tmp_path / "c.json")
    np.testing.assert_allclose(read.T_base_camera, found.T_base_camera, atol=1e-12)
    np.testing.assert_array_equal(read.p_tool_object_m, found.p_tool_object_m)
    assert (read.residual_deg, read.motions) == (found.residual_deg, found.motions)


@pytest.mark.parametrize(
    ("T", "p", "message"),
    [
        (2 * np.eye(4), (0, 0, 0), "no rigid transform"),
        (se3.transform(np.eye(3), np.array([400.0, 0, 0])), (0, 0, 0), "looks like millimetres"),
        (np.eye(4), (0, np.nan, 0), "three finite metres"),
    ],
)
def test_a_calibration_that_is_none_is_refused(T, p, message):
    with pytest.raises(ReorientError, match=message):
        RobotCalibration(T, np.array(p, float))


@pytest.mark.parametrize("text", ["{}", "[1]", "x", '{"T_base_camera": 3, "p_tool_object_m": [0, 0, 0]}'])
def test_a_broken_file_is_refused(tmp_path, text):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(ReorientError, match="broken calibration file"):
        read_robot_calibration(tmp_path / "c.json")


class WithoutStop:
    def pose(self):
        pass

    def move_to(self, T_base_tool):
        pass


def test_drivers_that_lack_a_method_or_are_classes_are_refused():
    camera, arm = drivers(small_cell(1))
    check_drivers(camera, arm)
    for wrong, message in (
        ((camera, WithoutStop()), "has no stop: expected pose, move_to, stop"),
        ((camera, WithoutStop), r"arm is the class WithoutStop: expected an object, WithoutStop\(\)"),
        ((type(camera), arm), r"camera is the class SimulatedCamera: expected an object, SimulatedCamera\(\)"),
    ):
        with pytest.raises(ReorientError, match=message):
            check_drivers(*wrong)


def test_the_workspace_box_holds_for_the_calibration():
    cell = small_cell(1)
    x, y, z = cell.T_base_tool[:3, 3].tolist()
    box = RobotLimits(box_low_m=(x - 1e-3, y - 1e-3, z - 1e-3), box_high_m=(x + 1e-3, y + 1e-3, z + 1e-3))
    with pytest.raises(ReorientError, match="rotations of the tool are reachable from here"):
        calibrate(
            drivers(cell)[0],
            SimulatedArm(cell),
            estimator=KnowingEstimator(cell),
            tool_point_m=np.array([0.1, 0.0, 0.0]),
            limits=box,
        )
