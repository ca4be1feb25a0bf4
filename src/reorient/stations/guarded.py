"""Camera and arm drivers with the checks that all verbs need: limits before a move, its end after it, fresh frames."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.controller.station import captured, clock_of
from reorient.errors import ReorientError, StationError, check_range
from reorient.imaging import DepthImage
from reorient.imaging.depth_image import MILLIMETRES_ABOVE
from reorient.plugins import USER_ERRORS, in_words
from reorient.se3 import Transform
from reorient.stations.drivers import ArmDriver, CameraDriver

Isolate = Callable[[DepthImage], DepthImage]
"""Takes the whole frame to the isolated object."""
_TRIED = 6  # frames after a move until one is fresh: more than a driver's queue holds


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Limits of the arm's moves. Raises ReorientError for values out of range."""

    box_low_m: tuple[float, float, float] | None = None
    """Lowest x, y, z of the tool and of the held object, base axes."""
    box_high_m: tuple[float, float, float] | None = None
    """Highest x, y, z of the tool and of the held object, base axes."""
    max_step_deg: float = 30.0
    """Larger rotations are made in parts, so that the object stays in its place on the way."""
    settle_s: float = 0.15
    """Pause between the end of a move and the next frame."""
    position_tolerance_m: float = 0.005
    """Largest distance of the reached pose from the commanded one. Not tuned."""
    angle_tolerance_deg: float = 2.0
    """Largest angle of the reached pose from the commanded one. Not tuned."""

    def __post_init__(self) -> None:
        check_range(self, "max_step_deg", high=180, above=True)
        check_range(self, "settle_s")
        check_range(self, "position_tolerance_m", "angle_tolerance_deg", above=True)
        for name in ("box_low_m", "box_high_m"):
            check_range(self, name, low=-MILLIMETRES_ABOVE, high=MILLIMETRES_ABOVE)
        if self.box_low_m and self.box_high_m and not np.all(np.array(self.box_low_m) < np.array(self.box_high_m)):
            raise ReorientError(
                f"workspace box from {self.box_low_m} to {self.box_high_m} m: expected low below high along each axis"
            )

    def inside(self, point_m: Float[np.ndarray, "3"]) -> bool:
        """Whether a point in base axes is within the box."""
        low = -np.inf if self.box_low_m is None else np.array(self.box_low_m)
        high = np.inf if self.box_high_m is None else np.array(self.box_high_m)
        return bool(np.all((point_m >= low) & (point_m <= high)))


class GuardedArm:
    """An arm driver whose moves are checked before and after.

    A move outside the limits is refused without motion. Any other failure, a pose that is not reached, and one that
    changed between two moves stop the arm for good: each further move is refused.
    """

    def __init__(
        self, arm: ArmDriver, limits: RobotLimits | None = None, p_tool_object_m: Float[np.ndarray, "3"] | None = None
    ) -> None:
        """``p_tool_object_m``: the object's place in tool axes, which stays within the box too."""
        self.limits = limits or RobotLimits()
        self._arm = arm
        self._p_tool_object_m = np.zeros(3) if p_tool_object_m is None else p_tool_object_m
        self._last: Transform | None = None
        self.halted = ""
        """Why the arm does not move any more; empty where it does."""

    def pose(self) -> Transform:
        """The measured pose, T_base_tool. Raises StationError where the driver has none, or one that is no pose."""
        try:
            T = self._arm.pose()
        except ReorientError:
            raise
        except USER_ERRORS as error:
            raise StationError(f"the arm has no pose: {in_words(error)}") from error
        return checked_pose(T, "pose()")

    def reachable(self, T_base_tool: Transform) -> bool:
        """Whether a pose is within the box and, as far as the driver knows, within reach."""
        points_m = (T_base_tool[:3, 3], se3.apply(T_base_tool, self._p_tool_object_m))
        if not all(self.limits.inside(point_m) for point_m in points_m):
            return False
        ask = getattr(self._arm, "reachable", None)
        return ask is None or bool(ask(T_base_tool))

    def move_to(self, T_base_tool: Transform) -> Transform:
        """Move there; the measured pose at the end. Raises StationError as the class describes."""
        if self.halted:
            raise StationError(f"the arm was stopped and is not moved again: {self.halted}")
        if not self.reachable(T_base_tool):
            raise StationError(
                f"refused to move the tool to {in_metres(T_base_tool)}: outside the workspace box or out of reach"
            )
        if self._last is not None and (away := self._away(self.pose(), self._last)):
            raise self._halt(f"the pose changed by {away} since the last move: is another program moving the arm?")
        try:
            returned = checked_pose(self._arm.move_to(T_base_tool), "move_to()")
        except BaseException as error:  # Ctrl-C too: the arm must not go on
            halt = self._halt(f"the move failed: {in_words(error)}")
            if isinstance(error, USER_ERRORS):
                raise halt from error
            raise
        measured = self.pose()
        if away := self._away(measured, returned):
            raise self._halt(f"move_to() returned a pose {away} off the one that pose() measures")
        if away := self._away(measured, T_base_tool):
            raise self._halt(f"the arm ended {away} off the commanded pose")
        self._last = measured
        time.sleep(self.limits.settle_s)
        return measured

    def stop(self) -> None:
        """Stop the arm for good."""
        self._halt("stop() was called")

    def rotations(
        self, R_base: Float[np.ndarray, "3 3"], center_m: Float[np.ndarray, "3"], T: Transform
    ) -> Iterator[Transform]:
        """The poses on the way of a rotation about a point (base axes), from the pose T, in steps within the limit."""
        rotvec = so3.log(R_base)
        count = max(1, int(np.ceil(np.degrees(np.linalg.norm(rotvec)) / self.limits.max_step_deg - 1e-9)))
        for k in range(1, count + 1):
            yield about(so3.exp(rotvec * k / count), center_m) @ T

    def _away(self, one: Transform, other: Transform) -> str:
        """How far two poses are apart, in words; empty within the tolerance."""
        distance_m = float(np.linalg.norm(one[:3, 3] - other[:3, 3]))
        angle_deg = float(np.degrees(so3.angle_difference(one[:3, :3], other[:3, :3])))
        if distance_m <= self.limits.position_tolerance_m and angle_deg <= self.limits.angle_tolerance_deg:
            return ""
        return f"{1000 * distance_m:.1f} mm and {angle_deg:.1f} deg"

    def _halt(self, reason: str) -> StationError:
        """Stop the arm; the error to raise."""
        self.halted = self.halted or reason
        try:
            self._arm.stop()
        except USER_ERRORS as error:
            reason = f"{reason}; stopping it failed too ({in_words(error)})"
        return StationError(reason)


def about(R: Float[np.ndarray, "3 3"], center_m: Float[np.ndarray, "3"]) -> Transform:
    """The rotation about a point as a transform."""
    return se3.transform(R, center_m - R @ center_m)


def in_metres(T_base_tool: Transform) -> str:
    """The position of a pose, in words."""
    x, y, z = T_base_tool[:3, 3]
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m"


def checked_pose(T: object, source: str) -> Transform:
    """A pose as an array. Raises StationError where it is no rigid transform in metres."""
    try:
        pose = np.asarray(T, float)
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape != (4, 4) or not so3.is_rotation(pose[:3, :3], 1e-3) or not np.allclose(pose[3], [0, 0, 0, 1]):
        raise StationError(f"{source} of the arm returned no pose: expected T_base_tool, a rigid (4, 4) transform")
    if not np.all(np.isfinite(pose[:3, 3])):
        raise StationError(f"{source} of the arm returned a position that is not finite: expected metres")
    if np.linalg.norm(pose[:3, 3]) > MILLIMETRES_ABOVE:
        raise StationError(
            f"{source} of the arm returned a position {np.linalg.norm(pose[:3, 3]):.0f} m from the base: this looks "
            "like millimetres, expected metres (times 0.001)"
        )
    u, _, vt = np.linalg.svd(pose[:3, :3])
    return se3.transform(u @ vt, pose[:3, 3])


class FreshFrames:
    """A camera driver whose frames are isolated, and refused where they are from before the last move."""

    def __init__(self, camera: CameraDriver, isolate: Isolate | None = None) -> None:
        self._camera, self._isolate = camera, isolate
        self._ahead_s = -np.inf  # of the stamps' clock before the host's, at least
        self._last_s = -np.inf
        self._stale_before_s = -np.inf

    def whole(self) -> DepthImage:
        """The next fresh frame. Raises StationError where the camera has none, and where its frames remain stale."""
        for _ in range(_TRIED):
            image = self._raw()
            if image.stamp_s is None:
                return image
            if image.stamp_s >= self._stale_before_s:
                self._last_s = max(self._last_s, image.stamp_s)
                return image
        raise StationError(
            f"stale frames: the last one was captured {self._stale_before_s - (image.stamp_s or 0):.2f} s before the "
            "last move ended; expected a driver that returns the newest frame with the time of its capture, and has "
            "clock_s() if the clock of its stamps does not run in real time"
        )

    def capture(self) -> DepthImage:
        """The next fresh frame, isolated. Raises StationError as ``whole``, and ReorientError where nothing is left."""
        image = self.whole()
        return image if self._isolate is None else self._isolate(image)

    def moved(self) -> None:
        """The object has just been moved: frames up to now are stale."""
        clock_s = self.clock_s()
        newer_s = float(np.nextafter(self._last_s, np.inf))
        self._stale_before_s = newer_s if clock_s is None else max(clock_s, newer_s)

    def clock_s(self) -> float | None:
        """The clock of the stamps: the driver's, or else inferred from the frames with the smallest delay so far."""
        own_s = clock_of(self._camera)
        if own_s is not None:
            return own_s
        return time.monotonic() + self._ahead_s if np.isfinite(self._ahead_s) else None

    def _raw(self) -> DepthImage:
        try:
            image = captured(self._camera.capture())
        except ReorientError:
            raise
        except USER_ERRORS as error:
            raise StationError(f"the camera failed to capture: {in_words(error)}") from error
        if image.stamp_s is not None:
            self._ahead_s = max(self._ahead_s, image.stamp_s - time.monotonic())
        return image
