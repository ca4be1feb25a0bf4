"""Rotations: quaternions (wxyz) and matrices, conversions, sampling, grids.

**The direction, stated once.** ``R_a_b`` takes coordinates in b to coordinates in a, so names cancel:
``R_a_c = R_a_b @ R_b_c``. The rotation between two orientations of an object is the one applied on the left,
in camera axes (paper, "Problem Formulation")::

    R_goal = R_goal_current @ R_current          R_goal_current = R_goal @ R_current.T

Quaternions are unit vectors ``(q_r, q_i, q_j, q_k)`` (paper, "Background"), named ``quat_wxyz``; q and -q are the
same rotation. Angles are radians. Batch dimensions lead, and broadcast.
"""

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from reorient.errors import ReorientError

Quaternions = Float[np.ndarray, "*#batch 4"]
Matrices = Float[np.ndarray, "*#batch 3 3"]
Vectors = Float[np.ndarray, "*#batch 3"]
Scalars = Float[np.ndarray, "*#batch"]


# --- quaternions (paper, "Background") ------------------------------------------------------------------------------


def normalize(quat_wxyz: Quaternions) -> Quaternions:
    """Divide by the norm. Raises ReorientError where the norm is zero or not finite."""
    norm = np.linalg.norm(quat_wxyz, axis=-1, keepdims=True)
    if not np.all(np.isfinite(norm) & (norm > 0)):
        raise ReorientError("a quaternion has zero or non-finite norm: expected four finite numbers, not all zero")
    return np.asarray(quat_wxyz / norm)


def canonical(quat_wxyz: Quaternions) -> Quaternions:
    """Of q and -q, the one with q_r >= 0 (paper, "Double Coverage")."""
    return np.where(quat_wxyz[..., :1] < 0, -quat_wxyz, quat_wxyz)


def conjugate(quat_wxyz: Quaternions) -> Quaternions:
    """The inverse of a unit quaternion: imaginary part negated."""
    return np.asarray(quat_wxyz * np.array([1.0, -1.0, -1.0, -1.0]))


def multiply(quat0_wxyz: Quaternions, quat1_wxyz: Quaternions) -> Quaternions:
    """Hamilton product q0 q1, which is the rotation R0 @ R1: first q1, then q0."""
    w0, v0 = quat0_wxyz[..., :1], quat0_wxyz[..., 1:]
    w1, v1 = quat1_wxyz[..., :1], quat1_wxyz[..., 1:]
    w = w0 * w1 - np.sum(v0 * v1, axis=-1, keepdims=True)
    return np.concatenate([w, w0 * v1 + w1 * v0 + np.cross(v0, v1)], axis=-1)


def difference(quat0_wxyz: Quaternions, quat1_wxyz: Quaternions) -> Quaternions:
    """q0 q1^-1, the rotation that takes q1 to q0 by left multiplication (paper, "Rotation difference")."""
    return multiply(quat0_wxyz, conjugate(quat1_wxyz))


def angle_between(quat0_wxyz: Quaternions, quat1_wxyz: Quaternions) -> Scalars:
    """Angle in [0, pi] of the rotation between two unit quaternions, 2 arccos|<q0, q1>| (paper, "Angle difference").

    Computed as 4 arctan(|q0 - q1| / |q0 + q1|), which is equal and accurate near zero.
    """
    minus = np.linalg.norm(quat0_wxyz - quat1_wxyz, axis=-1)
    plus = np.linalg.norm(quat0_wxyz + quat1_wxyz, axis=-1)
    return np.asarray(4 * np.arctan2(np.minimum(minus, plus), np.maximum(minus, plus)))


def quat_angle(quat_wxyz: Quaternions) -> Scalars:
    """Angle in [0, pi] of the rotation, 2 arccos|q_r| (paper, "Angle of rotation", the shorter way round)."""
    return np.asarray(2 * np.arctan2(np.linalg.norm(quat_wxyz[..., 1:], axis=-1), np.abs(quat_wxyz[..., 0])))


def quat_axis(quat_wxyz: Quaternions) -> Vectors:
    """Unit axis of the rotation by ``quat_angle`` (paper, "Axis of rotation"); the x axis for the identity."""
    v = canonical(quat_wxyz)[..., 1:]
    norm = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(norm > 0, v / np.where(norm > 0, norm, 1.0), np.array([1.0, 0.0, 0.0]))


def slerp(quat0_wxyz: Quaternions, quat1_wxyz: Quaternions, t: float) -> Quaternions:
    """Spherical linear interpolation from q0 (t = 0) to q1 (t = 1), along the shorter arc.

    The paper's formula with theta = arccos<q0, q1>, the angle between the *quaternions*. The paper defines theta as the
    angle between the two rotations, which is twice as large and does not end at q1.
    """
    dot = np.sum(quat0_wxyz * quat1_wxyz, axis=-1, keepdims=True)
    end = np.where(dot < 0, -quat1_wxyz, quat1_wxyz)
    theta = np.asarray(angle_between(quat0_wxyz, end))[..., None] / 2
    tiny = theta < 1e-8
    sin = np.where(tiny, 1.0, np.sin(theta))
    w0 = np.where(tiny, 1 - t, np.sin((1 - t) * theta) / sin)
    w1 = np.where(tiny, t, np.sin(t * theta) / sin)
    return normalize(w0 * quat0_wxyz + w1 * end)


# --- matrices -------------------------------------------------------------------------------------------------------


def matrix_from_quat(quat_wxyz: Quaternions) -> Matrices:
    """Rotation matrices of unit quaternions."""
    flat = np.reshape(quat_wxyz, (-1, 4))[:, [1, 2, 3, 0]]
    return np.asarray(Rotation.from_quat(flat).as_matrix().reshape(*quat_wxyz.shape[:-1], 3, 3))


def quat_from_matrix(R: Matrices) -> Quaternions:
    """Unit quaternions with w >= 0 of rotation matrices."""
    flat = Rotation.from_matrix(np.reshape(R, (-1, 3, 3))).as_quat()[:, [3, 0, 1, 2]]
    return canonical(flat).reshape(*R.shape[:-2], 4)


def exp(rotvec_rad: Vectors) -> Matrices:
    """Rotation matrices of rotation vectors (axis times angle), exact at zero."""
    flat = Rotation.from_rotvec(np.reshape(rotvec_rad, (-1, 3))).as_matrix()
    return np.asarray(flat.reshape(*rotvec_rad.shape, 3))


def log(R: Matrices) -> Vectors:
    """Rotation vectors, of length at most pi, of rotation matrices. Stable at 0 and pi (through the quaternion)."""
    return np.asarray(Rotation.from_matrix(np.reshape(R, (-1, 3, 3))).as_rotvec().reshape(R.shape[:-1]))


def angle(R: Matrices) -> Scalars:
    """Angle in [0, pi] of rotation matrices."""
    return np.asarray(np.linalg.norm(log(R), axis=-1))


def angle_difference(R0: Matrices, R1: Matrices) -> Scalars:
    """Angle in [0, pi] of the rotation between R1 and R0."""
    return angle(R0 @ np.swapaxes(R1, -1, -2))


def twist_angle(R: Float[np.ndarray, "3 3"], axis: Float[np.ndarray, "3"]) -> float:
    """The angle in [-pi, pi] by which R rotates about a unit axis (swing-twist decomposition): the rotation by it,
    undone after R, leaves the smallest angle. 0 where all leave pi."""
    w, *v = quat_from_matrix(R)
    return 2 * float(np.arctan2(np.dot(axis, v), w))


def angle_but_about(R: Matrices, axis: Float[np.ndarray, "3"] | None) -> Scalars:
    """The angle that the best rotation about a unit axis leaves of each R: that by which R tilts the axis. Without an
    axis the angle of R."""
    return angle(R) if axis is None else np.asarray(np.arccos(np.clip(R @ axis @ axis, -1, 1)))


def mean(R: Float[np.ndarray, "n 3 3"], weights: Float[np.ndarray, " n"] | None = None) -> Float[np.ndarray, "3 3"]:
    """The (weighted) chordal mean of rotations."""
    return np.asarray(Rotation.from_matrix(R).mean(weights).as_matrix())


def is_rotation(R: np.ndarray, tolerance: float = 1e-5) -> bool:
    """Whether an array is one (3, 3) rotation matrix, its entries within the tolerance."""
    return (
        R.shape == (3, 3)
        and bool(np.all(np.isfinite(R)))
        and bool(np.allclose(R @ R.T, np.eye(3), atol=tolerance))
        and float(np.linalg.det(R)) > 0
    )


# --- sampling and grids ---------------------------------------------------------------------------------------------


def sample_uniform(rng: Generator, n: int) -> Float[np.ndarray, "{n} 3 3"]:
    """n rotations uniform on SO(3)."""
    return matrix_from_quat(normalize(rng.standard_normal((n, 4))))


def sample_axes(rng: Generator, n: int) -> Float[np.ndarray, "{n} 3"]:
    """n unit vectors uniform on the sphere."""
    v = rng.standard_normal((n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def sample_bounded(rng: Generator, n: int, low_rad: float, high_rad: float) -> Float[np.ndarray, "{n} 4"]:
    """n unit quaternions, the axis uniform on the sphere and the angle uniform in [low, high].

    For [0, pi/6] they have the four properties of the paper's "Dataset Generation": unit norm, positive real part, real
    part the largest, real part at least cos(pi/12). Raises ReorientError unless 0 <= low <= high <= pi.
    """
    if not 0 <= low_rad <= high_rad <= np.pi + 1e-12:
        raise ReorientError(f"angle range [{low_rad}, {high_rad}] rad: expected 0 <= low <= high <= pi")
    half = rng.uniform(low_rad, high_rad, n)[:, None] / 2
    return canonical(np.concatenate([np.cos(half), np.sin(half) * sample_axes(rng, n)], axis=-1))


def grid(n: int) -> Float[np.ndarray, "{n} 3 3"]:
    """n rotations spaced evenly over SO(3): super-Fibonacci spirals (Alexa, CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(n) + 0.5
    r, R = np.sqrt(s / n), np.sqrt(1.0 - s / n)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quat_wxyz = np.stack([R * np.cos(beta), r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta)], axis=-1)
    return matrix_from_quat(quat_wxyz)


# --- sets of rotations ----------------------------------------------------------------------------------------------


def non_maximum_suppression(
    R: Float[np.ndarray, "k 3 3"], score: Float[np.ndarray, " k"], radius_rad: float, most: int | None = None
) -> Int[np.ndarray, " n"]:
    """Indices of the rotations of the highest score, best first, that are farther apart than ``radius_rad``.

    ``most``: at most so many; None: all. Of rotations within the radius of each other the one of higher score is kept,
    of equal scores the first.
    """
    order = np.argsort(-score, kind="stable")
    flat = R.reshape(-1, 9)[order].astype(np.float32)
    near = np.float32(1 + 2 * np.cos(radius_rad))  # of the trace
    free = np.ones(len(order), bool)
    chosen: list[int] = []
    while len(chosen) < (len(order) if most is None else most) and free.any():
        first = int(np.argmax(free))
        chosen.append(first)
        free &= flat @ flat[first] < near
        free[first] = False
    return np.asarray(order[chosen])
