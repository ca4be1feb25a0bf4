"""ABB robots by Externally Guided Motion (abb-robot-client)."""

from dataclasses import dataclass
from threading import Event, Thread
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import StationError
from reorient.extras import import_extra
from reorient.se3 import Transform
from reorient.stations.arms.streamed import StreamedArm


@dataclass(kw_only=True, eq=False)
class AbbArm(StreamedArm):
    """An ABB arm that runs EGM in pose mode; docs/drivers.md has the RAPID program.

    The tool is that of ``EGMActPose``, the base its work object (``wobj0``: the base of the world). The controller
    sends its state by UDP and follows the poses of the answers, which a thread of this driver sends: those of the path
    in a move, else the one at which the arm shall stay. EGM ends by itself where this program ends.
    """

    port: int = 6510
    """UDP port at which the controller's messages arrive: that of its transmission protocol ``UDPUC``."""

    def __post_init__(self) -> None:
        """Raises StationError where another program has the port, or no controller sends messages."""
        super().__post_init__()
        egm = import_extra("abb_robot_client.egm").EGM
        try:
            self._egm: Any = egm(port=self.port)
        except OSError as error:
            raise StationError(
                f"cannot open UDP port {self.port} ({error.strerror}): expected no other program that controls the arm"
            ) from error
        self._hold: Transform | None = None
        """The pose that was answered last."""
        self._closed = Event()
        self._thread = Thread(target=self._answer, daemon=True)
        self._thread.start()
        self._await_controller()

    def close(self) -> None:
        """Send no more answers, and free the port."""
        self._closed.set()
        self._thread.join()
        self._egm.close()

    def _silence(self) -> str:
        return (
            f"no message at UDP port {self.port} within {self.silent_s:g} s, expected a controller that runs "
            "EGMRunPose and sends to this computer"
        )

    def _check(self, message: Any) -> None:
        if not (message.motors_on and message.rapid_running):
            raise StationError(
                f"the controller stopped the arm: motors {'on' if message.motors_on else 'off'}, RAPID "
                f"{'running' if message.rapid_running else 'stopped'}"
            )
        if not _is_guided(message):
            raise StationError("the controller is not guided by EGM: expected a RAPID program in EGMRunPose")

    def _answer(self) -> None:
        """Read the controller's messages, and answer each with the pose to go to."""
        while not self._closed.is_set():
            arrived, message = self._egm.receive_from_robot(0.1)
            while arrived and (newer := self._egm.receive_from_robot(0))[0]:
                message = newer[1]
            if arrived and message.cartesian is not None:
                self._egm.send_to_robot_cart(*to_egm(self._next(message)))

    def _next(self, message: Any) -> Transform:
        """Keep the controller's state; the pose to answer: of the path, else the last one, at which the arm stays."""
        T = from_egm(*message.cartesian)
        with self._lock:
            if self._hold is None or self._is_silent() or not _is_guided(message):
                self._hold, self._path = T, None  # it starts anew: an old pose would make it jump
            self._received(T, message)
            due = self._due()
            self._hold = self._hold if due is None else due
            return self._hold


def _is_guided(message: Any) -> bool:
    state = message.robot_message.mciState
    return bool(state.state == state.MCI_RUNNING)


def from_egm(position_mm: np.ndarray, quat_wxyz: np.ndarray) -> Transform:
    """A pose in metres from EGM's millimetres and quaternion wxyz."""
    return se3.transform(so3.matrix_from_quat(so3.normalize(np.asarray(quat_wxyz, float))), 0.001 * position_mm)


def to_egm(T: Transform) -> tuple[np.ndarray, np.ndarray]:
    """EGM's millimetres and quaternion wxyz of a pose in metres."""
    return 1000 * T[:3, 3], so3.quat_from_matrix(T[:3, :3])
