"""Goals of several views, rendered: as a robot takes them that rotates the object away from the goal pose and back."""

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging.goal import Goal, GoalView
from reorient.world.pairs import FEWEST_RETURNS, Pair
from reorient.world.rendering import Renderer, World
from reorient.world.sensing import Sensor, sense

APART_RAD = float(np.radians(60))  # of each further view from the primary one, where they do not show all sides
ALL_ROUND = 6
"""Views that show an object from all sides, those of a cube."""


def rotations_away(rng: Generator, views: int) -> Float[np.ndarray, "k 3 3"]:
    """The rotations from the goal pose to the poses of the further views.

    Six views are those of a cube's faces; fewer are 60 degrees from the primary one, evenly spaced around it, from a
    random side on. Raises ReorientError for more than six.
    """
    if not 1 <= views <= ALL_ROUND:
        raise ReorientError(f"{views} goal views: expected 1 to {ALL_ROUND}")
    first_rad = rng.uniform(0, 2 * np.pi)
    if views == ALL_ROUND:
        angles_rad, count = np.array([1, 1, 1, 1, 2]) * np.pi / 2, 4
    else:
        angles_rad, count = np.full(views - 1, APART_RAD), max(views - 1, 1)
    around_rad = first_rad + 2 * np.pi * np.arange(len(angles_rad)) / count
    axes = np.stack([np.cos(around_rad), np.sin(around_rad), np.zeros_like(around_rad)], axis=1)
    return so3.exp(angles_rad[:, None] * axes)


def sample_goal(
    rng: Generator, renderer: Renderer, world: World, sensor: Sensor, pair: Pair, views: int, slip_rad: float = 0.0
) -> Goal:
    """The goal of a pair with further views; a side that shows fewer than 100 returns is left out.

    ``slip_rad``: each view's true rotation differs from the stated one by an angle up to this, about any axis. No
    translation is stated. Raises ReorientError for more than six views.
    """
    found = []
    for R_view_goal in rotations_away(rng, views):
        R_slip = so3.matrix_from_quat(so3.sample_bounded(rng, 1, 0.0, slip_rad))[0] if slip_rad > 0 else np.eye(3)
        R_camera_object = R_slip @ R_view_goal @ pair.R_goal_current @ pair.R_camera_object
        try:
            image = sense(rng, renderer, world.camera, R_camera_object, pair.placement, sensor, world.quantum_m)
        except ReorientError:  # a sheet seen edge on
            continue
        if np.count_nonzero(image.depth_m) >= FEWEST_RETURNS:
            found.append(GoalView(image, R_view_goal.T))
    return Goal(pair.goal, tuple(found))
