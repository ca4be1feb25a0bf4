"""Universal Robots: state by RTDE (ur-rtde), motion as URScript text."""

import socket
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import StationError
from reorient.extras import import_extra
from reorient.se3 import Transform
from reorient.stations.arms.supervised import POLL_S, StraightPath, SupervisedArm, connected, one_line

_STATE = ["timestamp", "actual_TCP_pose", "robot_mode", "safety_status_bits", "robot_status_bits", "runtime_state"]
_RTDE_PORT = 30004
_RUNNING_MODE = 7  # of robot_mode: powered on, brakes released
_SAFETY_STOPS = {  # of safety_status_bits
    **{2: "protective stop", 3: "recovery mode", 4: "safeguard stop", 8: "safety violation", 9: "safety fault"},
    **{5: "emergency stop", 6: "emergency stop", 7: "emergency stop", 10: "stop due to safety"},
}
_STOPPED, _PLAYING = 1, 2  # of runtime_state
_STOP_M_S2 = 1.0


@dataclass(kw_only=True, eq=False)
class UrArm(SupervisedArm):
    """An arm of Universal Robots (CB3, e-Series). Tool and base are the TCP and the base frame of the controller.

    Each move is a program of one ``movel`` with a fixed duration, which the controller completes by itself: it also
    ends where this program is killed. The robot must be in remote control (e-Series), and no other program may run.
    """

    address: str
    """Host name or IP address of the controller."""
    script_port: int = 30002
    """Port that accepts URScript: 30001, 30002 or 30003."""

    def __post_init__(self) -> None:
        """Raises StationError where the controller cannot be reached, or is not ready to move."""
        super().__post_init__()
        receive = import_extra("rtde_receive").RTDEReceiveInterface
        self._check_port(_RTDE_PORT)  # the vendor's constructor would wait longer, and could not be interrupted
        self._rtde: Any = connected(
            lambda: receive(self.address, -1.0, _STATE),
            self.timeout_s,
            f"a controller of Universal Robots at {self.address}, with RTDE enabled",
        )
        self.pose()

    def pose(self) -> Transform:
        """The measured pose of the TCP, T_base_tool. Raises StationError as the class describes."""
        self._await_state()
        self._check_safety()
        x_m, rotvec_rad = np.split(np.array(self._rtde.getActualTCPPose(), float), 2)
        return se3.transform(so3.exp(rotvec_rad), x_m)

    def stop(self) -> None:
        """Stop the arm: a program of one ``stopl`` replaces the one that runs."""
        self._send(f"stopl({_STOP_M_S2})")

    def close(self) -> None:
        """Disconnect."""
        self._rtde.disconnect()

    def _begin(self, path: StraightPath) -> None:
        if (state := self._rtde.getRuntimeState()) != _STOPPED:
            raise StationError(
                f"another program runs on the controller at {self.address} (runtime state {state}): expected none"
            )
        pose = [*path.T_end[:3, 3], *so3.log(path.T_end[:3, :3])]
        numbers = ", ".join(f"{x:.6f}" for x in pose)
        # t has priority over a and v: the duration is planned here, for rotations too, which a and v do not limit
        self._send(f"movel(p[{numbers}], a={self.acceleration_m_s2:g}, v={self.speed_m_s:g}, t={path.duration_s:.3f})")
        deadline_s = time.monotonic() + self.timeout_s
        while self._rtde.getRuntimeState() != _PLAYING:
            self._await_state()
            if time.monotonic() > deadline_s:
                raise StationError(
                    f"the controller at {self.address} did not start the move: expected remote control "
                    "(e-Series: Local/Remote at the top right of the pendant)"
                )
            time.sleep(POLL_S)

    def _executing(self) -> bool:
        self._check_safety()  # such a stop pauses the program, too
        state = self._rtde.getRuntimeState()
        if state not in (0, _STOPPED, _PLAYING):  # 0: about to stop
            raise StationError(f"the program was paused at the pendant of {self.address} (runtime state {state})")
        return bool(state != _STOPPED)

    def _await_state(self) -> None:
        """Wait for the next state of the controller, at most 8 ms. Raises StationError where none comes."""
        stamp, deadline_s = self._rtde.getTimestamp(), time.monotonic() + self.silent_s
        while self._rtde.getTimestamp() == stamp:
            if not self._rtde.isConnected() or time.monotonic() > deadline_s:
                raise StationError(
                    f"connection to the controller at {self.address} lost: no state for {self.silent_s:g} s"
                )
            time.sleep(0.002)

    def _check_safety(self) -> None:
        bits = self._rtde.getSafetyStatusBits()
        stops = dict.fromkeys(name for bit, name in _SAFETY_STOPS.items() if bits >> bit & 1)
        if stops:
            raise StationError(
                f"the controller at {self.address} is stopped: {', '.join(stops)}; expected the operator to release it"
            )
        if (mode := self._rtde.getRobotMode()) != _RUNNING_MODE:
            raise StationError(
                f"the robot at {self.address} is in mode {mode}: expected {_RUNNING_MODE}, powered on with the brakes "
                "released"
            )

    def _check_port(self, port: int) -> None:
        try:
            socket.create_connection((self.address, port), self.timeout_s).close()
        except OSError as error:
            raise StationError(
                f"no connection to {self.address}:{port} ({error}): expected a controller of Universal Robots"
            ) from error

    def _send(self, line: str) -> None:
        """Run one line as a program, in place of any other."""
        program = f"def reorient():\n  {line}\nend\n"
        try:
            with socket.create_connection((self.address, self.script_port), self.timeout_s) as connection:
                connection.sendall(program.encode())
                connection.shutdown(socket.SHUT_WR)
                connection.recv(4096)  # the controller's state: it has accepted the connection
        except OSError as error:
            raise StationError(f"connection to {self.address}:{self.script_port} lost: {one_line(error)}") from error
