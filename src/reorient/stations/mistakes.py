"""The usual mistakes in a robot cell, each as a correction of what the drivers and the calibration state.

With the right correction, the motions that the arm states predict those that the camera sees.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.se3 import Transform

AXES = ("x", "y", "z")
_PER_RADIAN = float(np.degrees(1.0))


@dataclass(frozen=True, eq=False)
class Cell:
    """What is stated of a cell, or what would be true instead."""

    T_base_camera: Transform
    poses: tuple[Transform, ...]
    """T_base_tool at each image, the first one at the start."""
    stretch: Float[np.ndarray, "3 3"]
    """From true to measured camera coordinates: the identity for the right intrinsics and an image that is not
    mirrored."""


@dataclass(frozen=True, eq=False)
class Mistake:
    """One mistake, and the cell without it."""

    name: str
    """Of its kind, or empty for none."""
    message: str
    """The mistake in words, with the cure."""
    cell: Cell
    penalty: float = 0.1
    """Mean squared residual, in deviations, that its free parameters are worth. Not tuned."""


def mistakes(cell: Cell) -> Iterator[Mistake]:
    """The stated cell, and it without each known mistake that has no free parameter."""
    yield Mistake("", "", cell, penalty=0.0)
    yield from _about_axes(cell)
    yield from _about_poses(cell)
    yield from _about_the_calibration(cell)
    for k, name in ((0, "left and right"), (1, "top and bottom")):
        mirror = np.eye(3)
        mirror[k, k] = -1
        message = f"mirrored image: {name} are exchanged; do not flip the frames, or flip both axes and cx, cy"
        yield Mistake("mirrored image", message, replace(cell, stretch=mirror))


def _about_axes(cell: Cell) -> Iterator[Mistake]:
    X = cell.T_base_camera
    for P in axis_swaps():
        seen = ", ".join(f"about {_axis(P.T[:, k])} when +{AXES[k]} was commanded" for k in range(3) if P[k, k] != 1)
        words = f"the object rotated {seen} (camera axes)"
        if np.array_equal(P, np.diag([-1.0, -1, 1])):
            words += ": camera mounted upside down?"
        else:
            words += ": axes swapped in T_base_camera? Camera axes are x right, y down, z forward"
        yield Mistake("axes swapped", words, replace(cell, T_base_camera=X @ se3.transform(P, np.zeros(3))))
        words = "axes swapped between the arm's base and that of T_base_camera: expected both in one frame"
        yield Mistake("axes swapped", words, replace(cell, T_base_camera=se3.transform(P, np.zeros(3)) @ X))


def _about_poses(cell: Cell) -> Iterator[Mistake]:
    def rotated(R_of: Callable[[Transform], Float[np.ndarray, "3 3"]]) -> Cell:
        return replace(cell, poses=tuple(se3.transform(R_of(T), T[:3, 3]) for T in cell.poses))

    first = cell.poses[0][:3, :3]
    message = "wrong sign: the object rotates the other way round than the arm states (conjugate quaternion?)"
    for R_of in (
        lambda T: (T[:3, :3] @ first.T).T @ first,
        lambda T: T[:3, :3].T,
    ):
        yield Mistake("sign", message, rotated(R_of))
    for factor, words in ((_PER_RADIAN, "larger"), (1 / _PER_RADIAN, "smaller")):
        message = f"degrees for radians: the object rotates by angles 57 times {words} than the arm states"
        absolute, relative = _scaled(factor), _scaled(factor, first)
        yield Mistake("degrees for radians", message, rotated(absolute))
        yield Mistake("degrees for radians", message, rotated(relative))
    for order in ((3, 0, 1, 2), (1, 2, 3, 0)):
        message = "quaternion order: the arm's quaternion is read as {} and is {}".format(
            *(("wxyz", "xyzw") if order[0] == 3 else ("xyzw", "wxyz"))
        )
        yield Mistake("quaternion order", message, rotated(partial(_reordered, order=order)))
    for factor, words in ((1000.0, "m for mm"), (0.001, "mm for m")):
        poses = tuple(se3.transform(T[:3, :3], T[:3, 3] * factor) for T in cell.poses)
        message = f"{words}: positions of the arm are {'smaller' if factor > 1 else 'larger'} by 1000 than they state"
        yield Mistake("mm for m", message, replace(cell, poses=poses))
    late = (cell.poses[0], *cell.poses[:-1])
    message = "stale frames: each frame shows the object before its last move; expected the newest frame"
    yield Mistake("stale frames", message, replace(cell, poses=late))
    message = "the visible object does not move with the tool: nothing held, or the isolation keeps something else"
    yield Mistake("nothing held", message, replace(cell, poses=(cell.poses[0],) * len(cell.poses)))


def _about_the_calibration(cell: Cell) -> Iterator[Mistake]:
    X = cell.T_base_camera
    message = "inverse extrinsics: the calibration holds T_camera_base, expected T_base_camera (invert it)"
    yield Mistake("inverse extrinsics", message, replace(cell, T_base_camera=se3.inverse(X)))
    for order in ((3, 0, 1, 2), (1, 2, 3, 0)):
        message = "quaternion order: that of T_base_camera was read in the wrong order (wxyz, xyzw)"
        X_right = se3.transform(_reordered(X, order), X[:3, 3])
        yield Mistake("quaternion order", message, replace(cell, T_base_camera=X_right))
    for factor in (1000.0, 0.001):
        message = "mm for m: the position in T_base_camera is wrong by a factor of 1000; expected metres"
        X_right = se3.transform(X[:3, :3], X[:3, 3] * factor)
        yield Mistake("mm for m", message, replace(cell, T_base_camera=X_right))


def axis_swaps() -> list[Float[np.ndarray, "3 3"]]:
    """The 23 rotations that take axes to other axes."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        P = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(P) > 0 and not np.array_equal(P, np.eye(3)):
            found.append(P)
    return found


def predicted(
    cell: Cell, pairs: Sequence[tuple[int, int]], points_m: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3"]]:
    """The rotations, and the places of points after them, that the camera would measure between pairs of images."""
    before, after = np.array(pairs).T
    poses = np.stack(cell.poses)
    A = poses[after] @ np.linalg.inv(poses[before])
    M = se3.inverse(cell.T_base_camera) @ A @ cell.T_base_camera
    S, S_inverse = cell.stretch, np.linalg.inv(cell.stretch)
    u, _, vt = np.linalg.svd(S @ M[:, :3, :3] @ S_inverse)
    true_m = points_m @ S_inverse.T
    after_m = np.einsum("nij,nj->ni", M[:, :3, :3], true_m) + M[:, :3, 3]
    return u @ vt, after_m @ S.T


def _scaled(factor: float, first: Float[np.ndarray, "3 3"] | None = None) -> Callable[[Transform], np.ndarray]:
    """A rotation with its angle, or that of the rotation since the first pose, times a factor."""
    if first is None:
        return lambda T: so3.exp(factor * so3.log(T[:3, :3]))
    return lambda T: so3.exp(factor * so3.log(T[:3, :3] @ first.T)) @ first


def _reordered(T: Transform, order: tuple[int, ...]) -> Float[np.ndarray, "3 3"]:
    """The rotation of a quaternion whose elements were read in another order; either sign of it may have been."""
    return so3.matrix_from_quat(so3.quat_from_matrix(T[:3, :3])[list(order)])


def _axis(v: Float[np.ndarray, "3"]) -> str:
    k = int(np.argmax(np.abs(v)))
    return f"{'+' if v[k] > 0 else '-'}{AXES[k]}"
