"""The ROS 2 arm driver on real middleware: a peer node follows the commanded poses."""

import motions
import numpy as np
import pytest
import ros2_controller
from peer import Peer, running

from reorient import se3, so3
from reorient.errors import StationError
from reorient.stations.arms.ros2 import Ros2Arm


@pytest.fixture
def controller(ros_domain):
    with running(ros2_controller.main, ros_domain) as peer:
        yield peer


@pytest.fixture
def connect(controller):
    arms = []

    def make(**settings) -> Ros2Arm:
        arms.append(Ros2Arm(pose_topic="current_pose", command_topic="target_frame", **(motions.FAST | settings)))
        return arms[-1]

    yield make
    for arm in arms:
        arm.close()


def truth(controller: Peer) -> np.ndarray:
    position_m, quat_xyzw = controller.ask("truth")
    return se3.transform(so3.matrix_from_quat(np.roll(quat_xyzw, 1)), position_m)


def test_a_motion_ends_where_the_controller_is(controller, connect):
    motions.reaches_its_poses(connect(), lambda: truth(controller))


def test_poses_are_metres_and_xyzw_in_the_frame_of_the_reported_pose(controller, connect):
    """A quarter turn about y: the tool's x axis along -z of the base."""
    half = np.sqrt(0.5)
    controller.ask("set", "pos", np.array([0.1, 0.2, 0.3]))
    controller.ask("set", "quat", np.array([0.0, half, 0.0, half]))
    arm = connect()
    T = arm.pose()
    assert np.allclose(T[:3, 3], [0.1, 0.2, 0.3])
    assert np.allclose(T[:3, 0], [0, 0, -1], atol=1e-9)
    arm.move_to(motions.moved(T, (0, 0, 0), (0, 0, 0.05)))
    _, (frame, position_m, quat_xyzw) = controller.ask("commands")
    assert frame == "base_link"
    assert np.allclose(position_m, [0.1, 0.2, 0.35])
    assert np.allclose(np.abs(quat_xyzw), [0, half, 0, half], atol=1e-9)


def test_nothing_is_published_at_rest(controller, connect):
    arm = connect()
    arm.move_to(motions.moved(arm.pose(), (0, 0, 0.2)))
    count, _ = controller.ask("commands")
    arm.pose()
    motions.time.sleep(0.3)
    assert controller.ask("commands")[0] == count


@pytest.mark.parametrize(
    ("acts", "message"),
    [
        ([("set", "publishing", False)], "no pose on current_pose within 1.5 s"),
        ([("deaf",)], "nobody listens on target_frame"),
        ([("other_publisher",)], "1 other programs publish on target_frame"),
        ([("set", "following", False), ("set", "pos", np.array([0.8, 0, 0.4]))], "the measured pose jumped by"),
    ],
)
def test_an_error_in_a_move(controller, connect, acts, message):
    arm = connect(speed_deg_s=20.0)
    motions.ends_a_move_by(arm, lambda: truth(controller), lambda: [controller.ask(*each) for each in acts], message)
    motions.refuses_to_move_again(arm, lambda: truth(controller))


def test_ctrl_c_stops_the_arm(controller, connect):
    arm = connect(speed_deg_s=20.0)
    motions.stops_on_ctrl_c(arm, lambda: truth(controller))


def test_a_blocked_arm_does_not_reach_its_pose(controller, connect):
    arm = connect(speed_deg_s=40.0)
    motions.ends_a_move_by(
        arm,
        lambda: truth(controller),
        lambda: controller.ask("set", "following", False),
        r"pose not reached: at rest .* deg from it",
    )


def test_a_controller_that_dies_in_a_move(controller, connect):
    arm = connect(speed_deg_s=20.0)
    motions.ends_a_move_by(arm, lambda: truth(controller), controller.kill, "no pose on current_pose")


def test_no_controller(ros_domain):
    with pytest.raises(StationError, match="no pose on nowhere"):
        Ros2Arm(pose_topic="nowhere", command_topic="target_frame", timeout_s=0.5)
