"""What every arm driver must do, whatever the vendor: used by the tests of each."""

import os
import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from reorient import se3, so3
from reorient.errors import StationError
from reorient.stations.arms.supervised import SupervisedArm, apart

FAST = {"speed_m_s": 0.3, "speed_deg_s": 60.0, "acceleration_m_s2": 2.0, "acceleration_deg_s2": 300.0} | {
    "silent_s": 1.5,  # a busy machine may pause a peer
    "timeout_s": 20.0,
}

MOVES = (
    ((0, 0, 0.5), (0.02, 0, 0)),
    ((0.3, -0.2, 0.1), (0, 0.02, -0.02)),
    ((0, -0.4, 0), (0, 0, 0)),
    ((0, 0, 0), (0, 0, 0)),
)
"""Rotation vectors in radians and shifts in metres, base axes; the last is no move."""


def moved(T: np.ndarray, rotvec_rad: tuple[float, ...], t_m: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """The pose T, rotated about the base's axes and shifted along them."""
    return se3.transform(so3.exp(np.array(rotvec_rad, float)) @ T[:3, :3], T[:3, 3] + t_m)


def close(T_a: np.ndarray, T_b: np.ndarray, distance_m: float = 1e-3, angle_deg: float = 0.1) -> bool:
    """Whether two poses are no farther apart."""
    found_m, found_deg = apart(T_a, T_b)
    return found_m <= distance_m and found_deg <= angle_deg


def refuses_to_move_again(arm: SupervisedArm, still: Callable[[], np.ndarray]) -> None:
    """After an error nothing is commanded: the device's own pose stays."""
    time.sleep(0.7)  # until the arm has braked
    T = still()
    with pytest.raises(StationError, match="not moved again after") as error:
        arm.move_to(moved(T, (0.0, 0.0, 0.3)))
    assert "\n" not in str(error.value)
    time.sleep(0.3)
    assert close(still(), T, 1e-3, 0.5)


def once_moving(still: Callable[[], np.ndarray], act: Callable[[], object], angle_deg: float = 2.0) -> None:
    """Act as soon as the device has rotated so far, whatever the speed of this machine."""
    start = still()

    def wait() -> None:
        while apart(still(), start)[1] < angle_deg:
            time.sleep(0.02)
        act()

    threading.Thread(target=wait, daemon=True).start()


def reaches_its_poses(
    arm: SupervisedArm, still: Callable[[], np.ndarray], distance_m: float = 1e-3, angle_deg: float = 0.1
) -> None:
    """Each move ends at its pose, by the driver's answer and by the device's own pose."""
    for rotvec_rad, t_m in MOVES:
        goal = moved(arm.pose(), rotvec_rad, t_m)
        assert close(arm.move_to(goal), goal, distance_m, angle_deg)
        assert close(still(), goal, distance_m, angle_deg)


def ends_a_move_by(
    arm: SupervisedArm, still: Callable[[], np.ndarray], act: Callable[[], object], message: str
) -> None:
    """What happens in the middle of a move ends it with an error."""
    once_moving(still, act)
    with pytest.raises(StationError, match=message):
        arm.move_to(moved(arm.pose(), (0.0, 0.0, 0.8)))


def stops_on_ctrl_c(arm: SupervisedArm, still: Callable[[], np.ndarray]) -> None:
    """Ctrl-C in the middle of a move: the arm stops on the way, and is not moved again."""
    start, goal = still(), moved(arm.pose(), (0.0, 0.0, 0.8))
    once_moving(still, lambda: os.kill(os.getpid(), signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        arm.move_to(goal)
    time.sleep(0.7)
    T = still()
    done_deg, left_deg = apart(start, T)[1], apart(T, goal)[1]
    assert done_deg > 0.5
    assert left_deg > 5
    refuses_to_move_again(arm, still)
