"""The ABB driver: abb-robot-client's EGM against a peer that sends and follows EGM messages."""

import socket
import time

import abb_controller
import motions
import numpy as np
import pytest
from peer import Peer, running

from reorient.errors import StationError
from reorient.stations.arms.abb import AbbArm, from_egm
from reorient.stations.arms.supervised import apart


@pytest.fixture
def controller():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with running(abb_controller.main, port) as peer:
        yield peer


@pytest.fixture
def connect(controller):
    arms = []

    def make(**settings) -> AbbArm:
        arms.append(AbbArm(port=controller.address, **(motions.FAST | settings)))
        return arms[-1]

    yield make
    for arm in arms:
        arm.close()


def truth(controller: Peer) -> np.ndarray:
    return from_egm(*controller.ask("truth"))


def test_a_motion_ends_where_the_controller_is(controller, connect):
    motions.reaches_its_poses(connect(), lambda: truth(controller))


def test_poses_are_millimetres_and_wxyz(controller, connect):
    """A quarter turn about y: the tool's x axis along -z of the base."""
    half = np.sqrt(0.5)
    controller.ask("set", "pos", np.array([100.0, 200.0, 300.0]))
    controller.ask("set", "quat", np.array([half, 0.0, half, 0.0]))
    arm = connect()
    T = arm.pose()
    assert np.allclose(T[:3, 3], [0.1, 0.2, 0.3])
    assert np.allclose(T[:3, 0], [0, 0, -1], atol=1e-9)
    arm.move_to(motions.moved(T, (0, 0, 0), (0, 0, 0.05)))
    _, position_mm, quat_wxyz = controller.ask("answers")[-1]
    assert np.allclose(position_mm, [100, 200, 350])
    assert np.allclose(np.abs(quat_wxyz), [half, 0, half, 0], atol=1e-9)


def test_the_commanded_poses_keep_the_limits(controller, connect):
    arm = connect(speed_deg_s=20.0, speed_m_s=0.05)
    arm.move_to(motions.moved(arm.pose(), (0, 0, 0.3), (0.05, 0, 0)))
    answers = [(t, from_egm(np.array(pos), np.array(quat))) for t, pos, quat in controller.ask("answers")]
    lag = 25  # answers, a tenth of a second: over one period the clock's noise would count
    steps = [
        (apart(T, T_later), t_later - t) for (t, T), (t_later, T_later) in zip(answers, answers[lag:], strict=False)
    ]
    assert 0.02 < max(distance_m / dt for (distance_m, _), dt in steps) < 0.05 * 1.15
    assert 5 < max(angle_deg / dt for (_, angle_deg), dt in steps) < 20 * 1.15


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("motors", "the controller stopped the arm: motors off"),
        ("rapid", "motors on, RAPID stopped"),
        ("guided", "not guided by EGM"),
        ("sending", "connection to the controller lost: no message at UDP port"),
    ],
)
def test_a_stop_of_the_controller_in_a_move(controller, connect, field, message):
    arm = connect(speed_deg_s=20.0)
    motions.ends_a_move_by(arm, lambda: truth(controller), lambda: controller.ask("set", field, False), message)
    controller.ask("set", field, True)  # started again by the operator: the arm stays
    motions.refuses_to_move_again(arm, lambda: truth(controller))


def test_a_robot_that_was_moved_while_egm_was_off_does_not_jump_back(controller, connect):
    connect()
    controller.ask("set", "guided", False)
    pos = controller.ask("truth")[0] + [50.0, 0, 0]
    time.sleep(0.1)
    controller.ask("set", "pos", pos)
    time.sleep(0.1)
    controller.ask("set", "guided", True)
    time.sleep(0.3)
    assert np.allclose(controller.ask("truth")[0], pos, atol=0.01)


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
    motions.ends_a_move_by(arm, lambda: truth(controller), controller.kill, "connection to the controller lost")


def test_a_second_client_is_refused(controller, connect):
    connect()
    with pytest.raises(StationError, match="expected no other program that controls the arm"):
        AbbArm(port=controller.address)


def test_no_controller():
    with pytest.raises(StationError, match="no message at UDP port 16599 within 0.5 s"):
        AbbArm(port=16599, timeout_s=0.3)
