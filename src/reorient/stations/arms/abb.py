"""ABB robots by Externally Guided Motion (abb-robot-client)."""

import time
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import StationError
from reorient.extras import import_extra
from reorient.se3 import Transform
from reorient.stations.arms.supervised import StraightPath, SupervisedArm


@dataclass(kw_only=True, eq=False)
class AbbArm(SupervisedArm):
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
        self._lock = Lock()
        self._state: tuple[Transform, Any, float] | None = None
        """The measured pose, the controller's message, and the time of its arrival."""
        self._hold: Transform | None = None
        self._path: StraightPath | None = None
        self._start_s = 0.0
        self._closed = Event()
        self._thread = Thread(target=self._answer, daemon=True)
        self._thread.start()
        try:
            self._await_controller()
        except BaseException:
            self.close()
            raise

    def pose(self) -> Transform:
        """The measured pose of the tool, T_base_tool. Raises StationError as the class describes."""
        with self._lock:
            state = self._state
        if state is None or time.monotonic() - state[2] > self.silent_s:
            raise StationError(f"connection to the controller lost: no message at UDP port {self.port}")
        T, message, _ = state
        if not (message.motors_on and message.rapid_running):
            raise StationError(
                f"the controller stopped the arm: motors {'on' if message.motors_on else 'off'}, RAPID "
                f"{'running' if message.rapid_running else 'stopped'}"
            )
        mci = message.robot_message.mciState
        if mci.state != mci.MCI_RUNNING:
            raise StationError("the controller is not guided by EGM: expected a RAPID program in EGMRunPose")
        return T

    def stop(self) -> None:
        """Stay at the commanded pose of this moment."""
        with self._lock:
            if self._path is not None:
                self._hold, self._path = self._path.at(time.monotonic() - self._start_s), None

    def close(self) -> None:
        """Send no more answers, and free the port."""
        self._closed.set()
        self._thread.join()
        self._egm.close()

    def _await_controller(self) -> None:
        deadline_s = time.monotonic() + self.timeout_s
        while self._state is None:
            if time.monotonic() > deadline_s:
                raise StationError(
                    f"no message at UDP port {self.port} within {self.timeout_s:g} s: expected a controller that runs "
                    "EGMRunPose and sends to this computer"
                )
            time.sleep(0.01)
        self.pose()

    def _begin(self, path: StraightPath) -> None:
        with self._lock:
            self._path, self._start_s = path, time.monotonic()

    def _executing(self) -> bool:
        with self._lock:
            if self._path is not None and time.monotonic() - self._start_s > self._path.duration_s:
                self._hold, self._path = self._path.T_end, None
            return self._path is not None

    def _answer(self) -> None:
        """Read the controller's messages, and answer each with the pose to go to."""
        while not self._closed.is_set():
            arrived, message = self._egm.receive_from_robot(0.1)
            while arrived and (newer := self._egm.receive_from_robot(0))[0]:
                message = newer[1]
            if arrived and message.cartesian is not None:
                self._egm.send_to_robot_cart(*to_egm(self._next(message)))

    def _next(self, message: Any) -> Transform:
        """Keep the controller's state; the pose to answer."""
        T, now_s = from_egm(*message.cartesian), time.monotonic()
        with self._lock:
            guided = message.robot_message.mciState.state == message.robot_message.mciState.MCI_RUNNING
            if self._state is None or now_s - self._state[2] > self.silent_s or not guided:
                self._hold, self._path = T, None  # it starts anew: an old pose would make it jump
            self._state = (T, message, now_s)
            if self._path is not None:
                return self._path.at(now_s - self._start_s)
            return T if self._hold is None else self._hold


def from_egm(position_mm: np.ndarray, quat_wxyz: np.ndarray) -> Transform:
    """A pose in metres from EGM's millimetres and quaternion wxyz."""
    return se3.transform(so3.matrix_from_quat(so3.normalize(np.asarray(quat_wxyz, float))), 0.001 * position_mm)


def to_egm(T: Transform) -> tuple[np.ndarray, np.ndarray]:
    """EGM's millimetres and quaternion wxyz of a pose in metres."""
    return 1000 * T[:3, 3], so3.quat_from_matrix(T[:3, :3])
