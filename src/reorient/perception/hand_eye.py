"""Hand-eye calibration from rotations of a held object: A X = X B, with the camera fixed and X = T_base_camera.

A is a motion of the tool in base axes, by the arm; B the same motion in camera axes, by an estimator. Rotations that do
not share their axis determine X (Park and Martin, IEEE Transactions on Robotics and Automation 10(5), 1994). Wrong
estimates are outliers: a consensus over pairs of motions finds the others, and least squares with a robust loss weight
these by their covariance. Standard errors by the jackknife over images, as motions that share an image are correlated.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.se3 import Transform

CONSENSUS_RAD = float(np.radians(3))  # residual of a motion that agrees; estimates that agree have less than 1.5 deg
FEWEST = 4  # motions that agree; three parameters, and one to spare
FLOOR_RAD = float(np.radians(0.15))  # added to the deviation of an estimate: systematic errors of the depth
POSITION_M = 0.001  # deviation of the estimated displacement of a point of the object
_PARALLEL = float(np.sin(np.radians(15)))  # two axes this near to each other determine no rotation
LEAST_SPREAD_RAD = float(np.radians(8))  # RMS of the rotation vectors along their second principal direction


@dataclass(frozen=True, eq=False)
class Motion:
    """One motion of the held object, as the arm and as the estimator measured it."""

    T_after_before: Transform
    """By the arm: T_base_tool after, times the inverse of that before; base axes, metres."""
    R_after_before: Float[np.ndarray, "3 3"]
    """By the estimator, camera axes."""
    before_m: Float[np.ndarray, "3"]
    """A point of the object before the motion, camera axes."""
    after_m: Float[np.ndarray, "3"]
    """The same point after it, by the estimator, camera axes."""
    covariance_rad2: Float[np.ndarray, "3 3"] | None = None
    """Of the estimated rotation, camera axes; None if unknown."""
    images: tuple[int, int] = (0, 1)
    """The numbers of the images before and after."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """The solution of A X = X B."""

    T_base_camera: Transform
    agree: Bool[np.ndarray, " n"]
    """The motions that agree with it."""
    residual_rad: Float[np.ndarray, " n"]
    """Of each motion."""
    rotation_se_rad: float
    """Standard error of the rotation: RMS angle."""
    point_se_m: float
    """Standard error of the object's place in base axes: RMS distance."""


def solve_hand_eye(motions: Sequence[Motion]) -> HandEye:
    """T_base_camera from motions. Raises ReorientError where their axes are too similar, and where too few agree."""
    if (spread_rad := axis_spread_rad(motions)) < LEAST_SPREAD_RAD:
        raise ReorientError(
            f"degenerate motions: the rotations differ from one axis by {np.degrees(spread_rad):.0f} deg (RMS), "
            "expected rotations about two axes at least; give the arm room to rotate (limits, start pose)"
        )
    R = _consensus(motions)
    agree = _residuals_rad(motions, R) < CONSENSUS_RAD
    chosen = [motion for motion, agrees in zip(motions, agree, strict=True) if agrees]
    if len(chosen) < FEWEST or axis_spread_rad(chosen) < LEAST_SPREAD_RAD:
        raise ReorientError(
            f"only {len(chosen)} of {len(motions)} estimated motions agree with those of the arm: expected at least "
            f"{FEWEST} about different axes"
        )
    T = _refined(chosen, se3.transform(R, _translation_m(chosen, R)))
    rotation_se_rad, point_se_m = _jackknife(chosen, T)
    return HandEye(T, agree, _residuals_rad(motions, T[:3, :3]), rotation_se_rad, point_se_m)


def axis_spread_rad(motions: Sequence[Motion]) -> float:
    """RMS of the arm's rotation vectors along their second principal direction: 0 where all share an axis."""
    if not motions:
        return 0.0
    w = so3.log(np.stack([motion.T_after_before[:3, :3] for motion in motions]))
    return float(np.sqrt(max(np.linalg.eigvalsh(w.T @ w / len(w))[1], 0.0)))


def _residuals_rad(motions: Sequence[Motion], R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " n"]:
    """Angle between each estimated rotation and that of the arm in camera axes."""
    A = np.stack([motion.T_after_before[:3, :3] for motion in motions])
    B = np.stack([motion.R_after_before for motion in motions])
    return so3.angle_difference(R.T @ A @ R, B)


def _consensus(motions: Sequence[Motion]) -> Float[np.ndarray, "3 3"]:
    """Of the rotations that two motions determine, the one that most motions agree with."""
    a = so3.log(np.stack([motion.T_after_before[:3, :3] for motion in motions]))
    b = so3.log(np.stack([motion.R_after_before for motion in motions]))
    tried = [_from_two(a[[i, j]], b[[i, j]]) for i, j in combinations(range(len(a)), 2)]
    known = np.array([R for R in tried if R is not None])
    if len(known) == 0:
        raise ReorientError("degenerate motions: no two estimated rotations have different axes")
    distance_rad = np.linalg.norm(np.einsum("kij,nj->kni", known, b) - a, axis=-1)
    support = np.maximum(1 - (distance_rad / CONSENSUS_RAD) ** 2, 0).sum(axis=1)
    return np.asarray(known[np.argmax(support)])


def _from_two(a: Float[np.ndarray, "2 3"], b: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "3 3"] | None:
    """The rotation that takes two rotation vectors in camera axes to those in base axes; None for parallel ones."""
    normal_a, normal_b = np.cross(*a), np.cross(*b)
    for vectors, normal in ((a, normal_a), (b, normal_b)):
        lengths = np.linalg.norm(vectors, axis=1)
        if np.linalg.norm(normal) < max(_PARALLEL * float(lengths.prod()), 1e-4):
            return None
    unit_a, unit_b = normal_a / np.linalg.norm(normal_a), normal_b / np.linalg.norm(normal_b)
    u, _, vt = np.linalg.svd(a.T @ b + np.outer(unit_a, unit_b))
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt)


def _translation_m(motions: Sequence[Motion], R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Least squares of (R_A - 1) t = R after - R_A R before - t_A over the motions."""
    A = np.stack([motion.T_after_before for motion in motions])
    before = np.stack([R @ motion.before_m for motion in motions])
    after = np.stack([R @ motion.after_m for motion in motions])
    moved = np.einsum("nij,nj->ni", A[:, :3, :3], before) + A[:, :3, 3]
    t_m = np.linalg.lstsq((A[:, :3, :3] - np.eye(3)).reshape(-1, 3), (after - moved).ravel(), rcond=None)[0]
    return np.asarray(t_m)


def _refined(motions: Sequence[Motion], start: Transform) -> Transform:
    """Robust least squares over rotations, whitened by their covariances, and displacements."""
    A = np.stack([motion.T_after_before for motion in motions])
    B = np.stack([motion.R_after_before for motion in motions])
    before = np.stack([motion.before_m for motion in motions])
    after = np.stack([motion.after_m for motion in motions])
    white = np.stack([whitening(motion.covariance_rad2, FLOOR_RAD) for motion in motions])
    center_m = before.mean(axis=0)  # the rotation is about the object, so that it is not coupled to the translation

    def moved(x: Float[np.ndarray, "6"]) -> Transform:
        R = so3.exp(x[:3]) @ start[:3, :3]
        return se3.transform(R, start[:3, 3] + start[:3, :3] @ center_m + x[3:] - R @ center_m)

    def residuals(x: Float[np.ndarray, "6"]) -> Float[np.ndarray, " m"]:
        X = moved(x)
        in_camera = se3.inverse(X) @ A @ X
        rotation = so3.log(in_camera[:, :3, :3] @ np.swapaxes(B, 1, 2))
        place = np.einsum("nij,nj->ni", in_camera[:, :3, :3], before) + in_camera[:, :3, 3] - after
        return np.concatenate([np.einsum("nij,nj->ni", white, rotation).ravel(), place.ravel() / POSITION_M])

    return moved(least_squares(residuals, np.zeros(6), loss="soft_l1", f_scale=2.0, x_scale="jac").x)


def whitening(covariance_rad2: Float[np.ndarray, "3 3"] | None, floor_rad: float) -> Float[np.ndarray, "3 3"]:
    """From a rotation residual to one of unit variance; ``floor_rad``: deviation added to that of the estimate."""
    known = np.zeros((3, 3)) if covariance_rad2 is None else covariance_rad2
    values, vectors = np.linalg.eigh(known + floor_rad**2 * np.eye(3))
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _jackknife(motions: Sequence[Motion], T: Transform) -> tuple[float, float]:
    """Standard errors of the rotation (rad) and of the object's place (m), leaving out one image at a time."""
    numbers = sorted({number for motion in motions for number in motion.images})
    center_m = np.mean([motion.before_m for motion in motions], axis=0)
    rotations, points = [], []
    for number in numbers:
        rest = [motion for motion in motions if number not in motion.images]
        if len(rest) < FEWEST or axis_spread_rad(rest) < LEAST_SPREAD_RAD:
            return float("inf"), float("inf")
        without = _refined(rest, T)
        rotations.append(so3.log(without[:3, :3] @ T[:3, :3].T))
        points.append(se3.apply(without, center_m))
    scale = (len(numbers) - 1) / len(numbers)
    spread = [np.sqrt(scale * np.sum((np.array(x) - np.mean(x, axis=0)) ** 2)) for x in (rotations, points)]
    return float(spread[0]), float(spread[1])
