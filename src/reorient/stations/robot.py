"""A station of a depth camera, a robot arm and the calibration of the two: the camera is fixed, the tool holds the
object."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.controller.station import rigid
from reorient.errors import ReorientError, StationError
from reorient.imaging import DepthImage, Isolation
from reorient.perception.robot_calibration import RobotCalibration
from reorient.se3 import Transform
from reorient.stations.drivers import ArmDriver, CameraDriver, check_drivers
from reorient.stations.guarded import FreshFrames, GuardedArm, Isolate, RobotLimits, in_metres


class RobotStation:
    """The station protocol from drivers: converts between camera and base axes, and rotates about the held object.

    A rotation is made in steps about the object's place in tool axes, so that it stays where it is; all of its poses
    are checked before the first move. The reported rotation is the measured one, from the pose at the last frame, or
    at the end of the last move after it, to the pose after the move. Frames from before the end of a move are refused.
    """

    def __init__(
        self,
        camera: CameraDriver,
        arm: ArmDriver,
        calibration: RobotCalibration,
        isolate: Isolate | None = None,
        limits: RobotLimits | None = None,
    ) -> None:
        """``isolate``: takes the whole frame to the object; the sphere of an ``Isolation`` is centred on the pivot.
        ``limits`` None: the defaults, without a workspace box.

        Raises ReorientError for a driver that lacks a method or is a class, and for a calibration of another kind.
        """
        check_drivers(camera, arm)
        if not isinstance(calibration, RobotCalibration):
            raise ReorientError(f"calibration {calibration!r}: expected the result of reorient.calibrate")
        self.arm = arm if isinstance(arm, GuardedArm) else GuardedArm(arm, limits, calibration.p_tool_object_m)
        self.calibration = calibration
        self._frames = FreshFrames(camera)
        self._isolate = isolate
        self._pose: Transform | None = None  # at the last frame, or at the end of the last move after it

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"]:
        """The rotation centre, camera axes: the object's place at the tool's present pose."""
        return self.calibration.pivot_m(self.arm.pose())

    def capture(self) -> DepthImage:
        """The next fresh frame, isolated. Raises StationError where there is none, or where the arm was stopped."""
        if self.arm.halted:
            raise StationError(f"the arm was stopped: {self.arm.halted}")
        image = self._frames.whole()
        self._pose = self.arm.pose()
        if self._isolate is None:
            return image
        return around_pivot(self._isolate, self.calibration.pivot_m(self._pose))(image)

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Rotate the object (camera axes, left); the rotation that the arm measured since the last frame or move.

        Raises StationError where R_step is no rotation, where it is not reachable, and where the arm failed.
        """
        if not so3.is_rotation(np.asarray(R_step)):
            raise StationError("refused to rotate: expected a (3, 3) rotation matrix")
        before = self.arm.pose()
        poses = self._poses(R_step, before)
        if outside := [pose for pose in poses if not self.arm.reachable(pose)]:
            raise StationError(
                f"refused to rotate: on the way the tool would be at {in_metres(outside[0])}, outside the workspace "
                "box or out of reach"
            )
        after = before
        try:
            for pose in poses:
                after = self.arm.move_to(pose)
        finally:
            self._frames.moved()
        return self._since(before, after)[:3, :3]

    def move(self, T_step: Transform) -> Transform:
        """Move the object in a straight line (camera axes, left); the motion since the last frame or move, by the arm.

        Raises StationError where T_step is no rigid transform, rotates by more than one step of ``rotate``, is not
        reachable, and where the arm failed.
        """
        T = rigid(T_step)
        limit_deg = self.arm.limits.max_step_deg
        if np.degrees(so3.angle(T[:3, :3])) > limit_deg:
            raise StationError(
                f"refused to move: expected a rotation of at most {limit_deg:g} deg, else rotate() first"
            )
        T_base_camera, before = self.calibration.T_base_camera, self.arm.pose()
        target = T_base_camera @ T @ se3.inverse(T_base_camera) @ before
        if not self.arm.reachable(target):
            raise StationError(
                f"refused to move the tool to {in_metres(target)}: outside the workspace box or out of reach"
            )
        try:
            after = self.arm.move_to(target)
        finally:
            self._frames.moved()
        return self._since(before, after)

    def _since(self, before: Transform, after: Transform) -> Transform:
        """The motion of the object (camera axes) since the last frame or move; a move from ``before`` ended."""
        T_base_camera = self.calibration.T_base_camera
        T_base = after @ se3.inverse(before if self._pose is None else self._pose)
        self._pose = after
        return np.asarray(se3.inverse(T_base_camera) @ T_base @ T_base_camera)

    def reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """Whether all poses of a rotation are within the limits and, as far as the arm's driver knows, within reach."""
        return all(map(self.arm.reachable, self._poses(R_step, self.arm.pose())))

    def _poses(self, R_step: Float[np.ndarray, "3 3"], T_base_tool: Transform) -> list[Transform]:
        R_base_camera = self.calibration.T_base_camera[:3, :3]
        R_base = R_base_camera @ R_step @ R_base_camera.T
        center_m = T_base_tool[:3, :3] @ self.calibration.p_tool_object_m + T_base_tool[:3, 3]
        return list(self.arm.rotations(R_base, center_m, T_base_tool))

    def __getattr__(self, name: str) -> Any:
        """``clock_s``, where the camera's frames have stamps: the clock of these."""
        if name == "clock_s" and self._frames.clock_s() is not None:
            return self._frames.clock_s
        raise AttributeError(name)


def around_pivot(isolate: Isolate, pivot_m: Float[np.ndarray, "3"]) -> Isolate:
    """An ``Isolation`` with a sphere, centred on the pivot; any other callable unchanged."""
    if isinstance(isolate, Isolation) and isolate.radius_m is not None:
        x, y, z = pivot_m.tolist()
        return replace(isolate, around_m=(x, y, z))
    return isolate
