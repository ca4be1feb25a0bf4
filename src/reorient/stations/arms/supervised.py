"""What all arm drivers share: speed limits, straight paths, and the supervision of a move."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Thread
from typing import TypeVar

import numpy as np

from reorient import se3, so3
from reorient.errors import ReorientError, StationError, check_range
from reorient.se3 import Transform

POLL_S = 0.01
REST_S = 0.2
"""An arm is at rest when its pose changed by less than REST_M and REST_DEG for so long."""
REST_M, REST_DEG = 0.0003, 0.05
JUMP_M, JUMP_DEG = 0.02, 5.0
"""Between two readings a pose may change by three times the speed limit and this: more is no motion of this arm."""
MIN_DURATION_S = 0.5  # so that even the smallest move is seen in the controller's state
PEAK_SPEED, PEAK_ACCELERATION = 1.875, 5.7735  # of the profile 10 s^3 - 15 s^4 + 6 s^5, for distance and time 1


@dataclass(frozen=True, eq=False)
class StraightPath:
    """A straight line from pose to pose, rotating about a fixed axis, smooth in speed and acceleration."""

    T_start: Transform
    T_end: Transform
    duration_s: float

    def at(self, elapsed_s: float) -> Transform:
        """The pose so long after the start; before and after the path its ends."""
        s = float(np.clip(elapsed_s / self.duration_s, 0, 1))
        return self.along(s**3 * (10 - 15 * s + 6 * s**2))

    def along(self, s: float) -> Transform:
        """The pose at a share of the way, from 0 to 1."""
        R_start, R_end = self.T_start[:3, :3], self.T_end[:3, :3]
        R = R_start @ so3.exp(s * so3.log(R_start.T @ R_end))
        return se3.transform(R, (1 - s) * self.T_start[:3, 3] + s * self.T_end[:3, 3])


@dataclass(kw_only=True, eq=False)
class SupervisedArm(ABC):
    """An arm driver: its limits, and moves that are watched until the arm is at rest.

    During a move a lost connection, a stop of the controller, a pose that jumps, a move that is not finished in time
    and a pose that is not reached raise StationError; then, and on Ctrl-C, the arm is stopped, and every further move
    is refused. The driver must then be made anew, which is left to the operator.
    """

    speed_m_s: float = 0.05
    """Highest speed of the tool point. The default is a fifth of the 0.25 m/s of ISO 10218 for reduced speed."""
    speed_deg_s: float = 20.0
    """Highest angular speed of the tool. Not tuned."""
    acceleration_m_s2: float = 0.2
    """Highest acceleration of the tool point: full speed after a quarter of a second. Not tuned."""
    acceleration_deg_s2: float = 80.0
    """Highest angular acceleration of the tool. Not tuned."""
    tolerance_m: float = 0.003
    """Largest distance of the tool at rest from the commanded position. Not tuned."""
    tolerance_deg: float = 1.0
    """Largest angle of the tool at rest from the commanded orientation. Not tuned."""
    timeout_s: float = 5.0
    """A move that lasts so much longer than planned is stopped; also the longest wait for a connection."""
    silent_s: float = 0.5
    """Without a new state from the controller for so long, the connection is lost. Not tuned."""
    failure: str = field(default="", init=False)
    """Why no further move is commanded; empty where one may be."""

    def __post_init__(self) -> None:
        check_range(self, "speed_m_s", high=1.0, above=True)
        check_range(self, "speed_deg_s", high=180.0, above=True)
        check_range(self, "acceleration_m_s2", "acceleration_deg_s2", "timeout_s", "silent_s", above=True)
        check_range(self, "tolerance_m", "tolerance_deg", above=True)

    @abstractmethod
    def pose(self) -> Transform:
        """The measured pose of the tool, T_base_tool, metres.

        Raises StationError where the connection is lost, or the controller is stopped.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop the arm where it is."""

    @abstractmethod
    def _begin(self, path: StraightPath) -> None:
        """Start a motion. Raises StationError where the controller does not start it."""

    @abstractmethod
    def _executing(self) -> bool:
        """Whether the motion is going on. Raises StationError where the controller gave it up."""

    def move_to(self, T_base_tool: Transform) -> Transform:
        """Move in a straight line and wait until the arm is at rest; the measured pose there.

        Raises StationError as the class describes.
        """
        if self.failure:
            raise StationError(f"the arm is not moved again after: {self.failure}; expected a new driver")
        T_end = np.asarray(T_base_tool, float)
        if T_end.shape != (4, 4) or not np.isfinite(T_end).all() or not so3.is_rotation(T_end[:3, :3]):
            raise StationError("refused to move: expected T_base_tool, a rigid (4, 4) transform in metres")
        try:
            path = self.path(self.pose(), T_end)
            self._begin(path)
            return self._arrived(path)
        except BaseException as error:
            self._give_up(error)
            raise

    def path(self, T_start: Transform, T_end: Transform) -> StraightPath:
        """The path between two poses with the shortest duration within the limits."""
        distance_m, angle_deg = apart(T_start, T_end)
        duration_s = max(
            MIN_DURATION_S,
            PEAK_SPEED * distance_m / self.speed_m_s,
            PEAK_SPEED * angle_deg / self.speed_deg_s,
            np.sqrt(PEAK_ACCELERATION * distance_m / self.acceleration_m_s2),
            np.sqrt(PEAK_ACCELERATION * angle_deg / self.acceleration_deg_s2),
        )
        return StraightPath(T_start, T_end, float(duration_s))

    def _arrived(self, path: StraightPath) -> Transform:
        """Watch a move until the arm is at rest."""
        start_s = last_s = rest_since_s = time.monotonic()
        T_last = T_rest = path.T_start
        while self._executing() or time.monotonic() - rest_since_s < REST_S:
            time.sleep(POLL_S)
            T, now_s = self.pose(), time.monotonic()
            self._check_jump(T_last, T, now_s - last_s)
            if not np.array_equal(T, T_last):  # exactly the same pose is the same state, while a network pauses
                T_last, last_s = T, now_s
            distance_m, angle_deg = apart(T_rest, T)
            if distance_m > REST_M or angle_deg > REST_DEG:
                T_rest, rest_since_s = T, now_s
            if now_s - start_s > path.duration_s + self.timeout_s:
                raise StationError(
                    f"move not finished in {path.duration_s + self.timeout_s:.1f} s ({_away(T, path.T_end)} to go): "
                    "slowed down by the controller, or blocked?"
                )
        distance_m, angle_deg = apart(T_last, path.T_end)
        if distance_m > self.tolerance_m or angle_deg > self.tolerance_deg:
            raise StationError(
                f"pose not reached: at rest {_away(T_last, path.T_end)} from it; another program that moves the arm, "
                f"or a tolerance that is too small ({1000 * self.tolerance_m:g} mm, {self.tolerance_deg:g} deg)?"
            )
        return T_last

    def _check_jump(self, T_before: Transform, T_after: Transform, elapsed_s: float) -> None:
        distance_m, angle_deg = apart(T_before, T_after)
        if (
            distance_m > JUMP_M + 3 * self.speed_m_s * elapsed_s
            or angle_deg > JUMP_DEG + 3 * self.speed_deg_s * elapsed_s
        ):
            raise StationError(
                f"the measured pose jumped by {1000 * distance_m:.1f} mm and {angle_deg:.1f} deg within "
                f"{1000 * elapsed_s:.0f} ms: another tool frame, or another program that moves the arm?"
            )

    def _give_up(self, error: BaseException) -> None:
        """Stop the arm, and refuse all further moves."""
        self.failure = one_line(error)
        try:
            self.stop()
        except Exception as second:
            self.failure += f"; stopping failed, too ({one_line(second)}): use the emergency stop"


def apart(T_a: Transform, T_b: Transform) -> tuple[float, float]:
    """The distance in metres and the angle in degrees between two poses."""
    distance_m = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))
    return distance_m, float(np.degrees(so3.angle_difference(T_a[:3, :3], T_b[:3, :3])))


def _away(T_a: Transform, T_b: Transform) -> str:
    distance_m, angle_deg = apart(T_a, T_b)
    return f"{1000 * distance_m:.1f} mm and {angle_deg:.1f} deg"


Made = TypeVar("Made")


def connected(make: Callable[[], Made], timeout_s: float, expected: str) -> Made:
    """The result of a vendor's call that connects. Raises StationError where it fails or does not return in time.

    ``expected``: the end of the message, which says what to check.
    """
    results: list[Made | Exception] = []

    def call() -> None:
        try:
            results.append(make())
        except Exception as error:  # the vendor's own
            results.append(error)

    thread = Thread(target=call, daemon=True)
    thread.start()
    thread.join(timeout_s)
    if not results:
        raise StationError(f"no answer within {timeout_s:g} s: expected {expected}")
    result = results[0]
    if isinstance(result, ReorientError):
        raise result
    if isinstance(result, Exception):
        raise StationError(f"no connection ({one_line(result)}): expected {expected}") from result
    return result


def one_line(error: BaseException) -> str:
    """The first line of a vendor's error: some append the whole state of the robot."""
    return str(error).strip().partition("\n")[0] or type(error).__name__
