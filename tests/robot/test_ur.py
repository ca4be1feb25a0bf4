"""The driver of Universal Robots: ur-rtde and URScript against a simulated controller."""

import time

import motions
import numpy as np
import pytest
import ur_controller
from peer import Peer, running

from reorient.errors import StationError
from reorient.stations.arms.ur import UrArm


@pytest.fixture
def controller():
    with running(ur_controller.main) as peer:
        yield peer


def connect(controller: Peer, **settings) -> UrArm:
    return UrArm(address=controller.address, **(motions.FAST | settings))


def truth(controller: Peer) -> np.ndarray:
    return controller.ask("truth")


def told_to_stop(controller: Peer) -> bool:
    time.sleep(0.1)
    return "stopl" in controller.ask("programs")[-1]


def test_a_motion_ends_where_the_controller_is(controller):
    motions.reaches_its_poses(connect(controller), lambda: truth(controller), 1e-5, 1e-3)


def test_the_pose_is_metres_and_a_rotation_vector(controller):
    """p[0.1, 0.2, 0.3, 0, pi/2, 0]: the tool's x axis along -z of the base."""
    controller.ask("set", "T", np.array([[0, 0, 1, 0.1], [0, 1, 0, 0.2], [-1, 0, 0, 0.3], [0, 0, 0, 1.0]]))
    T = connect(controller).pose()
    assert np.allclose(T[:3, 3], [0.1, 0.2, 0.3], atol=1e-9)
    assert np.allclose(T[:3, 0], [0, 0, -1], atol=1e-9)


def test_a_program_is_one_movel_within_the_limits(controller):
    arm = connect(controller, speed_deg_s=30.0)
    arm.move_to(motions.moved(arm.pose(), (0, 0, 0.5)))
    (program,) = controller.ask("programs")
    move = ur_controller.MOVEL.search(program)
    assert program == f"def reorient():\n  {move[0]}\nend\n"
    assert float(move[4]) == pytest.approx(1.875 * np.degrees(0.5) / 30, abs=1e-3)


@pytest.mark.parametrize(
    ("bit", "message"), [(2, "stopped: protective stop"), (4, "safeguard stop"), (6, "emergency stop"), (9, "fault")]
)
def test_a_stop_of_the_controller_in_a_move(controller, bit, message):
    arm = connect(controller, speed_deg_s=20.0)
    motions.ends_a_move_by(arm, lambda: truth(controller), lambda: controller.ask("safety", bit), message)
    motions.refuses_to_move_again(arm, lambda: truth(controller))
    controller.ask("set", "safety_bits", 1)  # released by the operator: still nothing is commanded
    motions.refuses_to_move_again(arm, lambda: truth(controller))
    assert sum("movel" in program for program in controller.ask("programs")) == 1


def test_a_pause_at_the_pendant(controller):
    arm = connect(controller, speed_deg_s=20.0)
    motions.ends_a_move_by(
        arm, lambda: truth(controller), lambda: controller.ask("set", "runtime_state", 4), "paused at the pendant"
    )
    assert told_to_stop(controller)


def test_ctrl_c_stops_the_arm(controller):
    arm = connect(controller, speed_deg_s=20.0)
    motions.stops_on_ctrl_c(arm, lambda: truth(controller))
    assert told_to_stop(controller)


def test_a_move_that_is_not_finished_in_time_is_stopped(controller):
    arm = connect(controller, timeout_s=0.5)
    controller.ask("set", "speed", 0.1)
    with pytest.raises(StationError, match=r"move not finished in .* deg to go"):
        arm.move_to(motions.moved(arm.pose(), (0, 0, 0.5)))
    assert told_to_stop(controller)
    motions.refuses_to_move_again(arm, lambda: truth(controller))


def test_a_controller_that_dies_in_a_move(controller):
    arm = connect(controller, speed_deg_s=20.0)
    motions.ends_a_move_by(
        arm, lambda: truth(controller), controller.kill, "connection to the controller at 127.0.0.1 lost"
    )
    assert "stopping failed, too" in arm.failure


def test_a_network_that_goes_silent_in_a_move(controller):
    """The state stops, the script port still answers: the driver stops the arm."""
    arm = connect(controller, speed_deg_s=20.0)
    motions.ends_a_move_by(
        arm,
        lambda: truth(controller),
        lambda: controller.ask("silent"),
        "connection to the controller at 127.0.0.1 lost: no state",
    )
    assert told_to_stop(controller)
    motions.refuses_to_move_again(arm, lambda: truth(controller))


def test_another_program_on_the_controller(controller):
    arm = connect(controller)
    goal = motions.moved(arm.pose(), (0, 0, 0.5))
    controller.ask("set", "runtime_state", 2)
    with pytest.raises(StationError, match="another program runs"):
        arm.move_to(goal)
    assert not any("movel" in program for program in controller.ask("programs"))


def test_another_client_that_takes_over_in_a_move(controller):
    arm, other = connect(controller, speed_deg_s=20.0), connect(controller)
    elsewhere = motions.moved(arm.pose(), (0, 0, -0.3))
    motions.ends_a_move_by(
        arm,
        lambda: truth(controller),
        lambda: other._send("stopl(1)") or other.move_to(elsewhere),
        r"pose not reached: at rest .* another program|another program runs",
    )


def test_a_pose_that_jumps(controller):
    arm = connect(controller, speed_deg_s=20.0)
    elsewhere = motions.moved(truth(controller), (0, 0, 0), (0.2, 0, 0))
    motions.once_moving(
        lambda: truth(controller), lambda: (controller.ask("set", "path", None), controller.ask("set", "T", elsewhere))
    )
    with pytest.raises(StationError, match="the measured pose jumped by"):
        arm.move_to(motions.moved(arm.pose(), (0, 0, 0.8)))
    motions.refuses_to_move_again(arm, lambda: truth(controller))


def test_a_robot_that_does_not_accept_programs(controller):
    controller.ask("set", "remote", False)
    arm = connect(controller, timeout_s=0.5)
    with pytest.raises(StationError, match="did not start the move: expected remote control"):
        arm.move_to(motions.moved(arm.pose(), (0, 0, 0.5)))


def test_a_robot_without_power(controller):
    controller.ask("set", "robot_mode", 3)
    with pytest.raises(StationError, match="mode 3: expected 7"):
        connect(controller)


def test_no_controller():
    with pytest.raises(StationError, match=r"no connection to 127.0.0.1:30004 .*expected a controller"):
        UrArm(address="127.0.0.1")
