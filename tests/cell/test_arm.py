import numpy as np
import pytest

from reorient import se3, so3
from reorient.errors import ReorientError, StationError
from reorient.stations.cell.arm import YUMI, Arm, rotated_pose

PLACE_M = np.array([0.4, 0.15, 0.22])


def reachable_pose(arm, rng):
    return arm.tcp(rng.uniform(arm.low_rad, arm.high_rad) * 0.5)


def test_the_rest_pose_points_straight_down(arm):
    """A fact of the robot: its rest pose, by forward kinematics."""
    T = arm.tcp(arm.home_rad)
    np.testing.assert_allclose(T[:3, 3], [0.4999, 0.2001, 0.1291], atol=2e-4)
    np.testing.assert_allclose(T[:3, 2], [0.0, 0.0, -1.0], atol=1e-3)
    assert not arm.collides(arm.home_rad, 0.0)


def test_joints_limits_and_speeds_are_the_robot_s(arm):
    np.testing.assert_allclose(arm.high_rad, [2.941, 0.759, 2.941, 1.396, 5.061, 2.409, 3.997])
    np.testing.assert_allclose(arm.low_rad, [-2.941, -2.505, -2.941, -2.155, -5.061, -1.536, -3.997])
    np.testing.assert_allclose(arm.speed_rad_s, [3.14] * 4 + [6.98] * 3)
    assert arm.stroke_m == 0.025


def test_inverse_kinematics_undoes_forward(arm, rng):
    solved = 0
    for _ in range(10):
        T = reachable_pose(arm, rng)
        try:
            joints_rad = arm.solve(T, arm.home_rad)
        except StationError:
            continue  # it may lie in the table
        solved += 1
        assert np.all((joints_rad >= arm.low_rad) & (joints_rad <= arm.high_rad))
        found = arm.tcp(joints_rad)
        assert np.linalg.norm(found[:3, 3] - T[:3, 3]) < 2e-4
        assert so3.angle_difference(found[:3, :3], T[:3, :3]) < 5e-4
        assert not arm.collides(joints_rad, 0.0)
    assert solved >= 4


def test_a_small_rotation_is_a_small_move(arm):
    level = se3.transform(so3.exp(np.array([0.0, np.pi / 2, 0.0])), PLACE_M)
    joints_rad = arm.solve(level, arm.home_rad)
    next_rad = arm.solve(rotated_pose(level, so3.exp(np.radians([3.0, 2.0, -4.0])), PLACE_M), joints_rad)
    assert 0 < np.abs(next_rad - joints_rad).max() < np.radians(20)


def test_out_of_reach_is_refused(arm):
    with pytest.raises(StationError, match="out of reach: no joint positions within the limits"):
        arm.solve(se3.transform(np.eye(3), np.array([2.0, 0.0, 0.3])), arm.home_rad)


def test_the_table_is_not_hit(arm):
    into = arm.tcp(arm.home_rad)
    into[2, 3] = -0.01
    with pytest.raises(StationError, match="out of reach: every way there hits"):
        arm.solve(into, arm.home_rad)


def test_the_shapes_go_with_the_joints(arm):
    def center(parts, name):
        (part,) = [p for p in parts if p.name == name]
        return (part.T_world_part @ [0.0, 0.0, 0.0, 1.0])[:3]

    apart = arm.parts(arm.home_rad, 0.02)
    gap = center(apart, "finger_left") - center(apart, "finger_right")
    closing = arm.tcp(arm.home_rad)[:3, 1]
    np.testing.assert_allclose(gap, (2 * 0.02 + 2 * 0.005) * closing, atol=1e-6)  # fingers are 1 cm thick


OTHER = """<mujoco><worldbody><body><joint name="a" axis="0 0 1" range="-3 3"/><geom type="sphere" size=".02"/>
<body pos="0 0 .3"><joint name="b" axis="0 1 0" range="-2 2"/><geom type="sphere" size=".02"/>
<body pos="0 0 .3"><joint name="c" axis="0 1 0" range="-2 2"/><geom type="box" size=".01 .01 .01"/>
<site name="tcp" pos="0 0 .1"/><body pos="0 0 .1"><joint name="f" type="slide" axis="0 1 0" range="0 .03"/>
<geom type="box" size=".005 .005 .01"/></body></body></body></body></worldbody>
<keyframe><key name="home" qpos="0 .3 .9 0"/></keyframe></mujoco>"""


def test_another_arm_can_be_given(tmp_path):
    (tmp_path / "other.xml").write_text(OTHER)
    arm = Arm(tmp_path / "other.xml")
    assert (len(arm.joints), len(arm.fingers), arm.stroke_m) == (3, 1, 0.03)
    np.testing.assert_allclose(arm.speed_rad_s, 1.0)
    np.testing.assert_allclose(
        arm.tcp(arm.home_rad)[:3, 3],
        [0.3 * np.sin(0.3) + 0.1 * np.sin(1.2), 0, 0.3 + 0.3 * np.cos(0.3) + 0.1 * np.cos(1.2)],
        atol=1e-9,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no arm file"),
        ("<mujoco>", "cannot read arm"),
        ("<mujoco><worldbody/></mujoco>", "no site 'tcp' or no keyframe 'home'"),
        (OTHER.replace('axis="0 1 0" range="-2 2"', 'type="slide" axis="0 1 0" range="-2 2"'), "at least 3 hinges"),
        (
            OTHER.replace('type="slide" axis="0 1 0" range="0 .03"', 'axis="0 1 0" range="0 .03"'),
            "slides for the fingers",
        ),
    ],
)
def test_a_bad_arm_file_is_refused_in_one_line(tmp_path, text, message):
    if text is not None:
        (tmp_path / "arm.xml").write_text(text)
    with pytest.raises(ReorientError, match=message) as caught:
        Arm(tmp_path / "arm.xml")
    assert "\n" not in str(caught.value)


def test_the_arm_is_shipped():
    assert YUMI.is_file()
