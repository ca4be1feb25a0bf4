"""Calibration with the held object: the arm rotates it by known rotations, an estimator measures them in the images."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.estimators import load_estimator
from reorient.estimators.base import Estimator, as_estimate
from reorient.imaging import DepthImage
from reorient.perception.hand_eye import LEAST_SPREAD_RAD, HandEye, Motion, axis_spread_rad, solve_hand_eye
from reorient.perception.robot_calibration import RobotCalibration
from reorient.se3 import Transform
from reorient.stations.drivers import ArmDriver, CameraDriver, check_drivers
from reorient.stations.guarded import FreshFrames, GuardedArm, Isolate, RobotLimits

ANGLE_RAD = float(np.radians(35))  # of each rotation from the start pose
LARGEST_RAD = float(np.radians(75))  # between two images whose motion is estimated
SMALLEST_RAD = float(np.radians(12))  # a smaller rotation tells little about its axis
_SHARES = (1.0, 0.7, 0.45)  # of the angle, where a pose is not reachable
_FEWEST_IMAGES = 5
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
_STILL = 0.35  # share of the arm's angle, below which the object did not rotate with the tool
_AGREEING = 0.5  # least share of the motions that must agree; 20 symmetric objects: 13 above it, all right by 0.4 deg
_LARGEST_SE_RAD = float(np.radians(1.5))  # largest standard error of a result. Not tuned


@dataclass(frozen=True, eq=False)
class View:
    """One image of the held object, and the arm's pose."""

    T_base_tool: Transform
    image: DepthImage


def calibrate(
    camera: CameraDriver,
    arm: ArmDriver,
    isolate: Isolate | None = None,
    estimator: Estimator | None = None,
    tool_point_m: Float[np.ndarray, "3"] | None = None,
    limits: RobotLimits | None = None,
) -> RobotCalibration:
    """The camera's pose and the object's place, from rotations of the object that the gripper holds.

    The arm makes up to 8 rotations of 35 degrees about ``tool_point_m`` (tool axes; None: the tool's origin), from its
    present pose and back, at once and without a question, within ``limits`` (None: the defaults, without a workspace
    box); the camera is fixed. ``isolate``: takes the whole frame to the object. ``estimator`` None: the default.

    Raises StationError where a device fails, and ReorientError for a driver that lacks a method or is a class, where
    the arm cannot rotate about two axes, where the object does not rotate with the tool, and where its rotation cannot
    be estimated (symmetry).
    """
    check_drivers(camera, arm)
    arm = arm if isinstance(arm, GuardedArm) else GuardedArm(arm, limits)
    tool_point_m = np.zeros(3) if tool_point_m is None else np.asarray(tool_point_m, float)
    views = observe(FreshFrames(camera, isolate), arm, tool_point_m)
    return calibration_from(views, estimator or load_estimator())


def observe(frames: FreshFrames, arm: GuardedArm, tool_point_m: Float[np.ndarray, "3"]) -> list[View]:
    """Images of the object in its present pose and rotated from it; the arm ends where it began.

    All poses on the way are checked before the first move.
    """
    start = arm.pose()
    center_m = se3.apply(start, tool_point_m)
    ways: list[list[Transform]] = []
    for axis in _CORNERS:
        before = ways[-1][-1] if ways else start
        way = _way(arm, before, start, center_m, axis)
        if way is not None and all(map(arm.reachable, _back(arm, way[-1], start, center_m))):
            ways.append(way)
    if len(ways) < _FEWEST_IMAGES - 1:
        raise ReorientError(
            f"only {len(ways)} of {len(_CORNERS)} rotations of the tool are reachable from here: expected at least "
            f"{_FEWEST_IMAGES - 1}; start from a pose with more room, or widen the workspace box"
        )
    views = [View(start, frames.capture())]
    for way in ways:
        reached = _moved(arm, way)
        frames.moved()
        views.append(View(reached, frames.capture()))
    _moved(arm, _back(arm, ways[-1][-1], start, center_m))
    return views


def _way(
    arm: GuardedArm,
    before: Transform,
    start: Transform,
    center_m: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
) -> list[Transform] | None:
    """The poses to the start pose rotated about the axis, as far as is reachable; None where not far enough."""
    for share in _SHARES:
        R = so3.exp(axis * (share * ANGLE_RAD)) @ start[:3, :3]
        way = list(arm.rotations(R @ before[:3, :3].T, center_m, before))
        if all(map(arm.reachable, way)):
            return way
    return None


def _back(arm: GuardedArm, last: Transform, start: Transform, center_m: Float[np.ndarray, "3"]) -> list[Transform]:
    return list(arm.rotations(start[:3, :3] @ last[:3, :3].T, center_m, last))


def _moved(arm: GuardedArm, way: Sequence[Transform]) -> Transform:
    """Move through poses; the measured pose at the end."""
    for pose in way:
        reached = arm.move_to(pose)
    return reached


def calibration_from(views: Sequence[View], estimator: Estimator) -> RobotCalibration:
    """The calibration from images and poses. Raises ReorientError as ``calibrate`` does."""
    motions = motions_between(views, estimator)
    refuse_still(motions)
    solved = _solved(motions)
    T_camera_base = se3.inverse(solved.T_base_camera)
    residual_rad = solved.residual_rad[solved.agree]
    return RobotCalibration(
        solved.T_base_camera,
        object_place_m(views, T_camera_base),
        residual_deg=float(np.degrees(np.sqrt(np.mean(residual_rad**2)))),
        rotation_se_deg=float(np.degrees(solved.rotation_se_rad)),
        pivot_se_m=solved.point_se_m,
        motions=int(solved.agree.sum()),
        motions_tried=len(motions),
    )


def motions_between(views: Sequence[View], estimator: Estimator) -> list[Motion]:
    """The motions between all pairs of images that are far enough and not too far from each other."""
    motions = []
    for i, j in combinations(range(len(views)), 2):
        T = views[j].T_base_tool @ se3.inverse(views[i].T_base_tool)
        if SMALLEST_RAD <= float(so3.angle(T[:3, :3])) <= LARGEST_RAD:
            motions.append(motion_between(views, i, j, estimator))
    return motions


def motion_between(views: Sequence[View], i: int, j: int, estimator: Estimator) -> Motion:
    """The motion from one image to another, by the arm and by the estimator."""
    before, after = views[i], views[j]
    estimate = as_estimate(estimator.estimate(before.image, after.image), before.image, after.image)
    point_m = np.median(before.image.points(), axis=0)
    return Motion(
        after.T_base_tool @ se3.inverse(before.T_base_tool),
        np.asarray(estimate.R_goal_current, float),
        point_m,
        se3.apply(estimate.T_goal_current, point_m),
        estimate.covariance_rad2,
        (i, j),
    )


def refuse_still(motions: Sequence[Motion]) -> None:
    """Raise ReorientError where the arm's motions are degenerate, and where the object did not rotate with the tool."""
    if not motions:
        raise ReorientError("no rotation of the tool was made: expected rotations about two axes at least")
    commanded = np.array([float(so3.angle(motion.T_after_before[:3, :3])) for motion in motions])
    seen = np.array([float(so3.angle(motion.R_after_before)) for motion in motions])
    if np.median(seen / commanded) < _STILL:
        raise ReorientError(
            f"the tool rotated by {np.degrees(np.median(commanded)):.0f} deg and the visible object by "
            f"{np.degrees(np.median(seen)):.1f} deg (medians): nothing held, the isolation keeps something else, or "
            "the object is symmetric; expected a held object without symmetry in view"
        )


def _solved(motions: Sequence[Motion]) -> HandEye:
    """The solution. Raises ReorientError where the object's rotations cannot be estimated."""
    try:
        solved = solve_hand_eye(motions)
        share = float(solved.agree.mean())
        reason = f"{share:.0%} of the estimated rotations agree with those of the arm"
    except ReorientError as error:
        if axis_spread_rad(motions) < LEAST_SPREAD_RAD:
            raise
        solved, share, reason = None, 0.0, str(error)
    if solved is None or share < _AGREEING:
        raise ReorientError(
            f"the rotation of this object cannot be estimated ({reason}): the object is probably symmetric, calibrate "
            "with a second object without symmetry; or the isolation keeps more than the object"
        )
    if solved.rotation_se_rad > _LARGEST_SE_RAD:
        raise ReorientError(
            f"the standard error of the camera's rotation is {np.degrees(solved.rotation_se_rad):.1f} deg, expected at "
            f"most {np.degrees(_LARGEST_SE_RAD):.0f}: calibrate with a second object that has more shape, or with more "
            "room to rotate"
        )
    return solved


def object_place_m(views: Sequence[View], T_camera_base: Transform) -> Float[np.ndarray, "3"]:
    """The centre of the object in tool axes: of the box around its returns in all images, without the outermost 1%."""
    points = []
    for view in views:
        T_tool_camera = se3.inverse(T_camera_base @ view.T_base_tool)
        points.append(se3.apply(T_tool_camera, view.image.points()))
    return np.asarray(np.percentile(np.concatenate(points), (1, 99), axis=0).mean(axis=0))
