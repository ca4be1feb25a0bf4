"""Pairs: one object seen twice, before and after a known rotation (paper, "Dataset Generation")."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.depth import DepthImage
from reorient.errors import ReorientError
from reorient.rendering import Placement, Renderer, World
from reorient.sensing import Sensor, sense


@dataclass(frozen=True)
class Pair:
    """A start, a goal and the truth between them."""

    current: DepthImage
    """I_s, which bears the rectangle."""
    goal: DepthImage
    """I_g."""
    R_goal_current: Float[np.ndarray, "3 3"]
    """What turns the start into the goal: R_g = R_goal_current @ R_s."""
    R_camera_object: Float[np.ndarray, "3 3"]
    """The start orientation R_s."""
    placement: Placement
    pivot_m: Float[np.ndarray, "3"]
    """The nominal rotation centre, up to 1 cm wrong along each axis."""


FEWEST_RETURNS = 100  # views that show less (a sheet edge on) ask nothing of an estimator, and are drawn again


def sample_pair(
    rng: Generator, renderer: Renderer, world: World, sensor: Sensor, low_rad: float, high_rad: float
) -> Pair:
    """Draw R_s uniform on SO(3), a rotation of an angle uniform in [low, high] about a uniform axis, and two images.

    Drawn again where either image has fewer than 100 returns; raises ReorientError for an object that never has.
    """
    for _ in range(100):
        placement = world.place(rng, renderer.mesh)
        R_start = so3.sample_uniform(rng, 1)[0]
        R_goal_current = so3.matrix_from_quat(so3.sample_bounded(rng, 1, low_rad, high_rad))[0]
        try:
            current = sense(rng, renderer, world.camera, R_start, placement, sensor, world.quantum_m, occluded=True)
            goal = sense(rng, renderer, world.camera, R_goal_current @ R_start, placement, sensor, world.quantum_m)
        except ReorientError:  # nothing seen at all
            continue
        if min(np.count_nonzero(image.depth_m) for image in (current, goal)) >= FEWEST_RETURNS:
            return Pair(current, goal, R_goal_current, R_start, placement, placement.nominal_pivot_m(rng))
    raise ReorientError("an object shows fewer than 100 returns from everywhere: expected a larger surface")
