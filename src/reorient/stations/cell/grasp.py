"""Grasps of a mesh by a parallel gripper: between the fingertips, clear of the palm."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float
from numpy.random import Generator

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.se3 import Transform
from reorient.world.meshes import bounding_radius, scale_to_radius

FINGER_M = 0.010  # half width of a finger, clearance included
DEPTH_M = (-0.03, 0.012)  # free space between fingers and palm, along the approach from the tool centre
_HOLD_M = 0.008  # largest distance of the held part from the tool centre, along the approach
_TRIES = 400
_SMALLER = 0.9


@dataclass(frozen=True, eq=False)
class Grasp:
    """An object between the fingers."""

    mesh: trimesh.Trimesh
    """Scaled to the gripper and centred, metres."""
    T_tcp_object: Transform
    fingers_m: float
    """Opening of each finger from closed."""


def find_grasp(
    mesh: trimesh.Trimesh, rng: Generator, stroke_m: float, radius_m: float = 0.065, smallest_m: float = 0.03
) -> Grasp:
    """A random grasp of an object scaled to a bounding radius of ``radius_m``, or less if it is too thick.

    The orientation is uniform on SO(3). The object does not reach into the palm, and the held part is at most two
    strokes thick. Raises ReorientError if there is no grasp down to ``smallest_m``.
    """
    while radius_m >= smallest_m:
        scaled = scale_to_radius(mesh, radius_m)
        points, _ = trimesh.sample.sample_surface(scaled, 4000, seed=int(rng.integers(2**31)))
        for _ in range(_TRIES):
            R = so3.sample_uniform(rng, 1)[0]
            held = _held_at(np.asarray(points) @ R.T, rng, stroke_m)
            if held is not None:
                t_m, fingers_m = held
                return Grasp(scaled, se3.transform(R, t_m), fingers_m)
        radius_m *= _SMALLER
    raise ReorientError(
        f"no grasp of an object of {1000 * bounding_radius(scaled):.0f} mm radius: expected some part at most "
        f"{2000 * stroke_m:.0f} mm thick"
    )


def _held_at(
    points: Float[np.ndarray, "n 3"], rng: Generator, stroke_m: float
) -> tuple[Float[np.ndarray, "3"], float] | None:
    """The translation that moves a part of the rotated object between the fingertips, and their opening; or None."""
    x, y, z = points.T
    back = z.min()  # the object's end towards the palm
    depth_m = rng.uniform(0.6, 1.0) * DEPTH_M[0]
    tip = back - depth_m  # of the fingertips along the approach
    column = points[(np.abs(z - tip) < _HOLD_M)]
    if not len(column):
        return None
    across = column[rng.integers(len(column)), 0]
    between = np.abs(x - across) <= FINGER_M
    band = between & (z - tip <= DEPTH_M[1])
    core = between & (np.abs(z - tip) <= _HOLD_M)
    if not core.any():
        return None
    low, high = y[band].min(), y[band].max()
    if high - low > 2 * stroke_m - 0.001:
        return None
    return np.array([-across, -(low + high) / 2, -tip]), float((high - low) / 2)
