"""Check of a robot cell: small known motions, compared with those that the camera sees, and mistakes named in words."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares, minimize_scalar

from reorient import se3, so3
from reorient.errors import ReorientError, StationError
from reorient.estimators import load_estimator
from reorient.estimators.base import Estimator, check_pair
from reorient.imaging import DepthImage
from reorient.perception.hand_eye import Motion, whitening
from reorient.perception.robot_calibration import RobotCalibration
from reorient.stations.calibrating import View, motion_between
from reorient.stations.drivers import ArmDriver, CameraDriver
from reorient.stations.guarded import FreshFrames, GuardedArm, Isolate, about
from reorient.stations.mistakes import AXES, Cell, Mistake, mistakes, predicted

ANGLE_RAD = float(np.radians(5))
SHIFT_M = 0.04  # of the translations
_ROTATION_RAD = float(np.radians(0.5))  # deviation of a rotation of a right cell, beyond the estimate's own, per axis
_POSITION_M = 0.0006  # deviation of a displacement of a right cell, per axis: 25 objects with 1 mm noise
_PLACE_M = 0.04  # deviation of the object's place from the calibrated one
_MOST = 6.0  # standard deviations that a residual counts at most
_RIGHT_BELOW = 1.2  # mean squared residual, in deviations, of a right cell
_TRIMMED = 0.8  # share of the residuals, the smallest, by which a cell is right: some estimates are wrong
_EXPLAINED_BELOW = 0.6  # mean squared residual of a mistake that explains the images, over that of the stated cell
_LARGEST_FLANGE_M = 0.08  # distance from the calibrated place: right cells have up to 73 mm, a flange 100 mm and more
_LEAST_STRETCH = 0.04  # of wrong intrinsics: right cells have up to 0.012 (30 tuning objects)
_POOR_DEG, _POOR_M = 2.5, 0.002  # errors (medians) that no mistake explains, of objects whose rotations are hard to see
_BETTER = "check with another object too"
_MOVED_DEG, _MOVED_M = 45.0, 0.3  # a camera that moved farther would not see the object
_LARGEST_TOOL_M = 1.5  # no tool holds an object farther from its origin


@dataclass(frozen=True)
class Check:
    """The result of a check."""

    mistake: str
    """The kind of the mistake; empty where there is none."""
    message: str
    """The result as a sentence."""
    rotation_deg: float | None = None
    """RMS angle between the rotations of the object by the arm and by the camera; None where not measured."""
    position_m: float | None = None
    """RMS distance between the displacements by the arm and by the camera; None where not measured."""

    @property
    def passed(self) -> bool:
        """Whether the cell is right."""
        return not self.mistake


def check(
    camera: CameraDriver,
    arm: ArmDriver,
    calibration: RobotCalibration,
    isolate: Isolate | None = None,
    estimator: Estimator | None = None,
) -> Check:
    """Move the held object by 5 degrees about three axes, either way, and by 4 cm along them, and compare.

    The arm ends in its present pose. ``isolate`` must not depend on the calibration. ``estimator`` None: ``fast``, as
    the motions are small. Raises ReorientError where the arm
    can make no such motions.
    """
    arm = arm if isinstance(arm, GuardedArm) else GuardedArm(arm, p_tool_object_m=calibration.p_tool_object_m)
    if np.linalg.norm(calibration.p_tool_object_m) > _LARGEST_TOOL_M:
        return Check("mm for m", f"mm for m: p_tool_object_m {calibration.p_tool_object_m} m; expected metres")
    frames = FreshFrames(camera, isolate)
    try:
        views = observe(frames, arm, calibration)
    except StationError as error:
        return Check(_kind_of(error), str(error))
    except _Empty as error:
        return Check("nothing held", f"nothing held, or out of view: {error}")
    if all(np.array_equal(view.image.depth_m, views[0].image.depth_m) for view in views[1:]):
        return Check("stale frames", "stale frames: all frames are identical; the camera repeats one frame")
    return diagnose(views, calibration, estimator or load_estimator("fast"))


class _Empty(ReorientError):
    """The isolation leaves no object."""


def _kind_of(error: StationError) -> str:
    text = str(error)
    kinds = {"stale": "stale frames", "millimetres": "mm for m"}
    return next((kind for word, kind in kinds.items() if word in text), "station failed")


def observe(frames: FreshFrames, arm: GuardedArm, calibration: RobotCalibration) -> list[View]:
    """Images at the start, after rotations about the camera's axes, and after translations along them."""
    start = arm.pose()
    R_base_camera = calibration.T_base_camera[:3, :3]
    center_m = se3.apply(start, calibration.p_tool_object_m)
    rotations = [
        about(so3.exp(sign * ANGLE_RAD * R_base_camera[:, k]), center_m) @ start for k in range(3) for sign in (1, -1)
    ]
    shifts = [
        se3.transform(np.eye(3), sign * SHIFT_M * R_base_camera[:, k]) @ start for k in range(3) for sign in (1, -1)
    ]
    reachable = [pose for pose in rotations if arm.reachable(pose)]
    if len(reachable) < len(rotations) - 1:
        raise ReorientError(
            "rotations of 5 deg are not reachable from here: expected a start pose inside the workspace box with room"
        )
    for one, other in zip(shifts[::2], shifts[1::2], strict=True):
        reachable += [pose for pose in (one, other) if arm.reachable(pose)][:1]
    views = [View(start, _isolated(frames))]
    for pose in reachable:
        reached = arm.move_to(pose)
        frames.moved()
        views.append(View(reached, _isolated(frames)))
    arm.move_to(start)
    return views


def _isolated(frames: FreshFrames) -> DepthImage:
    try:
        image = frames.capture()
        check_pair(image, image)
    except StationError:
        raise
    except ReorientError as error:
        raise _Empty(str(error)) from error
    return image


def diagnose(views: Sequence[View], calibration: RobotCalibration, estimator: Estimator) -> Check:
    """Which cell explains the images: the stated one, or one without a known mistake."""
    pairs = [(0, j) for j in range(1, len(views))] + [(j, j + 1) for j in range(1, len(views) - 1)]
    motions = [motion_between(views, i, j, estimator) for i, j in pairs]
    evidence = _Evidence.of(motions, calibration.p_tool_object_m, _center_m(views[0]))
    stated = Cell(calibration.T_base_camera, tuple(view.T_base_tool for view in views), np.eye(3))
    errors = evidence.errors(stated)
    terms = np.sort(evidence.terms(stated))
    if np.mean(terms[: int(_TRIMMED * len(terms))] ** 2) < _RIGHT_BELOW:
        return _small_mistake(evidence, stated)
    tried = [*mistakes(stated), _intrinsics(evidence, stated), _moved(evidence, stated)]
    costs = [evidence.cost(each.cell) + each.penalty for each in tried]
    best = tried[int(np.argmin(costs))]
    if min(costs) > _EXPLAINED_BELOW * costs[0] or not best.name:
        rotation_deg, position_m = evidence.errors(stated, np.median)  # some estimates may be wrong by any angle
        if rotation_deg < _POOR_DEG and position_m < _POOR_M:
            return Check("", f"no mistake found, with a poor estimate of this object's rotations: {_BETTER}", *errors)
        best = Mistake(
            "unknown",
            f"the object does not move as the arm states (rotations {rotation_deg:.1f} deg and displacements "
            f"{1000 * position_m:.1f} mm off, medians), and no known mistake explains it; {_BETTER}",
            stated,
        )
    return Check(best.name, best.message, *errors)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """The motions by the camera, and the object's place."""

    images: tuple[tuple[int, int], ...]
    """Of each motion."""
    R: Float[np.ndarray, "n 3 3"]
    """Each motion's rotation."""
    white: Float[np.ndarray, "n 3 3"]
    """From its residual to one of unit variance."""
    before_m: Float[np.ndarray, "n 3"]
    """A point before each motion."""
    after_m: Float[np.ndarray, "n 3"]
    """The same after it."""
    p_tool_object_m: Float[np.ndarray, "3"]
    """The calibrated place of the object, tool axes."""
    center_m: Float[np.ndarray, "3"]
    """The place of the object in the first image, camera axes."""

    @classmethod
    def of(
        cls, motions: Sequence[Motion], p_tool_object_m: Float[np.ndarray, "3"], center_m: Float[np.ndarray, "3"]
    ) -> "_Evidence":
        """That of motions."""
        return cls(
            tuple(motion.images for motion in motions),
            np.stack([motion.R_after_before for motion in motions]),
            np.stack([whitening(motion.covariance_rad2, _ROTATION_RAD) for motion in motions]),
            np.stack([motion.before_m for motion in motions]),
            np.stack([motion.after_m for motion in motions]),
            p_tool_object_m,
            center_m,
        )

    def residuals(self, cell: Cell) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Rotation (rad) and displacement (m) by the camera beyond the predicted ones."""
        R, after_m = predicted(cell, self.images, self.before_m)
        return so3.log(self.R @ np.swapaxes(R, 1, 2)), self.after_m - after_m

    def place_m(self, cell: Cell) -> Float[np.ndarray, "3"]:
        """The object's place beyond the calibrated one, measured camera coordinates."""
        T_camera_tool = se3.inverse(cell.T_base_camera) @ cell.poses[0]
        return np.asarray(self.center_m - cell.stretch @ se3.apply(T_camera_tool, self.p_tool_object_m))

    def terms(self, cell: Cell) -> Float[np.ndarray, " m"]:
        """The residuals, in standard deviations per axis."""
        rotation, displacement = self.residuals(cell)
        terms = (np.einsum("nij,nj->ni", self.white, rotation), displacement / _POSITION_M)
        return np.asarray(np.concatenate([np.linalg.norm(each, axis=1) for each in terms]) / np.sqrt(3))

    def cost(self, cell: Cell) -> float:
        """Mean squared residual in standard deviations, each bounded, with that of the object's place."""
        place = min(float(np.linalg.norm(self.place_m(cell))) / _PLACE_M, _MOST)
        return float(np.mean(np.minimum(self.terms(cell), _MOST) ** 2) + max(place - 2, 0) ** 2 / 4)

    def errors(self, cell: Cell, average: Callable[[Any], Any] = np.mean) -> tuple[float, float]:
        """RMS of the residuals, or the root of another average of their squares: degrees and metres."""
        rotation_rad, position_m = (float(np.sqrt(average(np.sum(x**2, axis=1)))) for x in self.residuals(cell))
        return float(np.degrees(rotation_rad)), position_m


def _center_m(view: View) -> Float[np.ndarray, "3"]:
    """The centre of the object from one image: that of its box, as deep as wide."""
    low, high = np.percentile(view.image.points(), (1, 99), axis=0)
    radius_m = float(np.linalg.norm((high - low)[:2])) / 2
    center = (low + high) / 2
    center[2] = low[2] + min(radius_m, 0.1)
    return np.asarray(center)


def _small_mistake(evidence: _Evidence, stated: Cell) -> Check:
    """The verdict on a cell whose rotations are right: whether the translations are, and the object's place."""
    errors = evidence.errors(stated)
    stretched = _intrinsics(evidence, stated)
    if stretched.name and evidence.cost(stretched.cell) < _EXPLAINED_BELOW * evidence.cost(stated):
        return Check(stretched.name, stretched.message, *errors)
    away_m = stated.poses[0][:3, :3].T @ stated.T_base_camera[:3, :3] @ evidence.place_m(stated)
    distance_m = float(np.linalg.norm(away_m))
    if distance_m < _LARGEST_FLANGE_M:
        return Check("", "axes, signs, angles and pivot are right", *errors)
    x, y, z = 1000 * away_m
    return Check(
        "flange for tool",
        f"the object is {1000 * distance_m:.0f} mm from its calibrated place in tool axes ({x:.0f}, {y:.0f}, {z:.0f} "
        "mm): does the arm report its flange instead of its tool? Or calibrate again for this grasp",
        *errors,
    )


def _intrinsics(evidence: _Evidence, stated: Cell) -> Mistake:
    """Wrong focal lengths, by the factor that explains the motions best."""

    def cell(factor: float) -> Cell:
        return replace(stated, stretch=np.diag([1 / factor, 1 / factor, 1.0]))

    tried = np.linspace(0.7, 1.4, 36)
    start = tried[int(np.argmin([evidence.cost(cell(factor)) for factor in tried]))]
    found = minimize_scalar(lambda x: evidence.cost(cell(x)), bounds=(start - 0.03, start + 0.03), method="bounded")
    factor = float(found.x)
    if abs(factor - 1) < _LEAST_STRETCH:
        return Mistake("", "", stated)
    message = f"wrong intrinsics: the focal lengths are {abs(factor - 1):.0%} too {'large' if factor > 1 else 'small'}"
    return Mistake("wrong intrinsics", f"{message}; expected those of this stream and resolution", cell(factor), 0.2)


def _moved(evidence: _Evidence, stated: Cell) -> Mistake:
    """Another camera pose, the one that explains the motions and the object's place best."""
    start = stated.T_base_camera
    center_m = se3.apply(start, evidence.center_m)

    def cell(x: Float[np.ndarray, "6"]) -> Cell:
        T = se3.transform(np.eye(3), x[3:]) @ about(so3.exp(x[:3]), center_m) @ start
        return replace(stated, T_base_camera=T)

    def residuals(x: Float[np.ndarray, "6"]) -> Float[np.ndarray, " m"]:
        rotation, displacement = evidence.residuals(cell(x))
        place = evidence.place_m(cell(x)) / (2 * _PLACE_M)
        return np.concatenate([rotation.ravel() / _ROTATION_RAD, displacement.ravel() / _POSITION_M, place])

    x = least_squares(residuals, np.zeros(6), loss="soft_l1", max_nfev=20).x
    moved = cell(x)
    angle_deg = float(np.degrees(np.linalg.norm(x[:3])))
    shift_m = float(np.linalg.norm(se3.apply(moved.T_base_camera, np.zeros(3)) - start[:3, 3]))
    rotvec = np.degrees(so3.log(start[:3, :3].T @ moved.T_base_camera[:3, :3]))
    axis = AXES[int(np.argmax(np.abs(rotvec)))]
    message = (
        f"the camera moved since its calibration, by {angle_deg:.0f} deg (mostly about its {axis} axis) and "
        f"{1000 * shift_m:.0f} mm: calibrate again"
    )
    likely = angle_deg < _MOVED_DEG and shift_m < _MOVED_M
    return Mistake("camera moved", message, moved, 0.5 if likely else 3.0)
