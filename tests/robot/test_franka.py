"""The Franka driver on franky-control, against franky-sim on MuJoCo's dynamics."""

import franka_controller
import motions
import numpy as np
import pytest
from peer import Peer, running

from reorient import se3
from reorient.errors import StationError
from reorient.stations.arms.franka import FrankaArm
from reorient.stations.arms.supervised import apart


@pytest.fixture
def controller():
    with running(franka_controller.main) as peer:
        yield peer


def connect(controller: Peer, **settings) -> FrankaArm:
    return FrankaArm(address=controller.address, realtime=False, **(motions.FAST | settings))


def hand(controller: Peer) -> np.ndarray:
    return controller.ask("truth")[0]


def test_a_motion_ends_where_the_simulator_says(controller):
    """The hand's motion in MuJoCo is the commanded one, and pose() measures it."""
    arm = connect(controller)
    for rotvec_rad, t_m in (
        ((0, 0, 0.5), (0.02, 0, 0)),
        ((0.3, -0.2, 0.1), (0, 0.02, -0.02)),
        ((0, -0.4, 0), (0,) * 3),
    ):
        T_start, T_hand = arm.pose(), hand(controller)
        goal = motions.moved(T_start, rotvec_rad, t_m)
        reached = arm.move_to(goal)
        assert motions.close(reached, goal, 1e-3, 0.3)
        # the hand is fixed to the tool
        T_hand_tool = se3.inverse(T_hand) @ T_start
        assert motions.close(hand(controller) @ T_hand_tool, goal, 2e-3, 0.3)
        assert motions.close(hand(controller) @ T_hand_tool, arm.pose(), 1e-3, 0.05)


def test_the_pose_is_that_of_the_tool_in_the_base(controller):
    """Metres, base axes: the tool point lies 103.4 mm before the hand of MuJoCo, with the same axes."""
    T_hand_tool = se3.transform(np.eye(3), np.array([0, 0, 0.1034]))
    assert motions.close(connect(controller).pose(), hand(controller) @ T_hand_tool, 1e-4, 0.01)


def test_a_pose_beyond_the_joints_or_the_reach_is_not_reachable(controller):
    """The reachable ones are reached; the last joint ends at 3.02 rad, and stands at 0.785."""
    arm = connect(controller)
    T = arm.pose()
    within, beyond = motions.moved(T, (0, 0, -2.1)), motions.moved(T, (0, 0, -2.4))
    assert (arm.reachable(within), arm.reachable(beyond)) == (True, False)
    assert not arm.reachable(motions.moved(T, (0, 0, 0), (0.6, 0, 0)))
    assert motions.close(arm.move_to(within), within, 1e-3, 0.3)


def test_the_speed_limit_holds(controller):
    arm = connect(controller, speed_deg_s=15.0)
    start = arm.pose()
    path = arm.path(start, motions.moved(start, (0, 0, 0.25)))
    assert np.degrees(0.25) / 15 < path.duration_s < 3 * np.degrees(0.25) / 15
    seen = []
    arm_pose = arm.pose
    arm.pose = lambda: seen.append(controller.ask("truth")) or arm_pose()
    arm.move_to(path.T_end)
    speeds_deg_s = [
        apart(T, T_later)[1] / (t_later - t) for (T, t), (T_later, t_later) in zip(seen, seen[10:], strict=False)
    ]
    assert 10 < max(speeds_deg_s) < 15 * 1.1


def test_ctrl_c_stops_the_arm(controller):
    arm = connect(controller, speed_deg_s=20.0)
    motions.stops_on_ctrl_c(arm, lambda: hand(controller))


def test_a_reflex_of_the_controller(controller):
    arm = connect(controller, speed_deg_s=20.0)
    motions.ends_a_move_by(
        arm,
        lambda: hand(controller),
        lambda: controller.ask("reflex"),
        r"the controller of .* stopped the arm: .*[Rr]eflex",
    )
    motions.refuses_to_move_again(arm, lambda: hand(controller))


def test_a_controller_that_dies_in_a_move(controller):
    arm = connect(controller, speed_deg_s=20.0)
    motions.once_moving(lambda: hand(controller), controller.kill)
    with pytest.raises(StationError, match="connection to the Franka at .* lost") as error:
        arm.move_to(motions.moved(arm.pose(), (0, 0, 0.8)))
    assert "\n" not in str(error.value)
    with pytest.raises(StationError, match="not moved again after: connection"):
        arm.move_to(np.eye(4))


def test_a_second_client_is_refused(controller):
    arm = connect(controller)
    with pytest.raises(StationError, match="no other client"):
        connect(controller, timeout_s=1.0)
    assert arm.pose()[3, 3] == 1


def test_no_controller():
    with pytest.raises(StationError, match="expected a Franka controller at 127.0.0.9 with FCI active"):
        FrankaArm(address="127.0.0.9", realtime=False, timeout_s=3.0)
