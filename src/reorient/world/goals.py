"""Goals of several views, rendered: as a robot takes them that rotates the object away from the goal pose and back."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import DepthImage, Goal, GoalView
from reorient.world.losses import Scene, with_losses
from reorient.world.pairs import FEWEST_RETURNS, Pair
from reorient.world.rendering import Renderer, World
from reorient.world.sensing import Sensor, sense

APART_RAD = float(np.radians(60))  # of each further view from the primary one, where they do not show all sides
EARLIER_RAD = (float(np.radians(20)), float(np.radians(120)))  # from an earlier capture to now
ALL_ROUND = 6
"""Views that show an object from all sides, those of a cube."""


def rotations_away(rng: Generator, views: int) -> Float[np.ndarray, "k 3 3"]:
    """The rotations from the goal pose to the poses of the further views.

    Six views are those of a cube's faces; fewer are 60 degrees from the primary one, evenly spaced around it, from a
    random side on. Raises ReorientError for more than six.
    """
    if not 1 <= views <= ALL_ROUND:
        raise ReorientError(f"{views} goal views: expected 1 to {ALL_ROUND}")
    if views == 1:
        return np.empty((0, 3, 3))
    first_rad = rng.uniform(0, 2 * np.pi)
    if views == ALL_ROUND:
        angles_rad, count = np.array([1, 1, 1, 1, 2]) * np.pi / 2, 4
    else:
        angles_rad, count = np.full(views - 1, APART_RAD), views - 1
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
        with suppress(ReorientError):  # a sheet seen edge on
            image = _sensed(rng, renderer, world, sensor, pair, R_camera_object)
            found.append(GoalView(image, R_view_goal.T))
    return Goal(pair.goal, tuple(found))


def with_goal_of(rng: Generator, other: Renderer, world: World, sensor: Sensor, pair: Pair) -> Pair | None:
    """A pair whose goal is of another object in the same pose; None where that shows fewer than 100 returns."""
    with suppress(ReorientError):
        R_camera_object = pair.R_goal_current @ pair.R_camera_object
        return replace(pair, goal=_sensed(rng, other, world, sensor, pair, R_camera_object))
    return None


def sample_history(
    rng: Generator, renderer: Renderer, world: World, sensor: Sensor, pair: Pair, count: int
) -> list[tuple[DepthImage, Float[np.ndarray, "3 3"]]]:
    """Earlier captures of the object of a pair, each with R_now_then, of 20 to 120 degrees; one that shows fewer than
    100 returns is left out."""
    found = []
    for _ in range(count):
        R = so3.matrix_from_quat(so3.sample_bounded(rng, 1, *EARLIER_RAD))[0]
        with suppress(ReorientError):
            image = _sensed(rng, renderer, world, sensor, pair, R.T @ pair.R_camera_object, occluded=True)
            found.append((image, R))
    return found


def _sensed(
    rng: Generator,
    renderer: Renderer,
    world: World,
    sensor: Sensor,
    pair: Pair,
    R_camera_object: Float[np.ndarray, "3 3"],
    occluded: bool = False,
) -> DepthImage:
    """The object of a pair in another pose, in the gripper where the world has one. Raises ReorientError for fewer than
    100 returns."""
    image = sense(
        rng,
        renderer,
        world.camera,
        R_camera_object,
        pair.placement,
        sensor,
        world.quantum_m,
        occluded and not world.in_hand,
    )
    if world.in_hand:
        scene = Scene.of(renderer, pair.placement, (pair.R_camera_object, R_camera_object), (pair.current, image))
        image = with_losses(rng, scene, world.in_hand)[1]
    if np.count_nonzero(image.depth_m) < FEWEST_RETURNS:
        raise ReorientError("the object shows too little from this side: expected at least 100 returns")
    return image
