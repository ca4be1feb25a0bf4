"""Pairs: one object seen twice, before and after a known rotation (paper, "Dataset Generation")."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.errors import ReorientError, check_counts, check_range
from reorient.imaging import DepthImage
from reorient.world.losses import Scene, with_losses
from reorient.world.objects import ObjectSource
from reorient.world.rendering import Placement, Renderer, World, load_world
from reorient.world.sensing import Sensor, sense


@dataclass(frozen=True)
class Pair:
    """A start image, a goal image and the true rotation between them."""

    current: DepthImage
    """I_s, the start; the image with the rectangle."""
    goal: DepthImage
    """I_g."""
    R_goal_current: Float[np.ndarray, "3 3"]
    """R_g = R_goal_current @ R_s, camera axes."""
    R_camera_object: Float[np.ndarray, "3 3"]
    """The start orientation R_s."""
    placement: Placement
    pivot_m: Float[np.ndarray, "3"]
    """The nominal rotation centre, up to 1 cm wrong along each axis."""


FEWEST_RETURNS = 100  # pairs with an image of fewer returns (a sheet seen edge on) are drawn again


def sample_pair(
    rng: Generator, renderer: Renderer, world: World, sensor: Sensor, low_rad: float, high_rad: float
) -> Pair:
    """Draw R_s uniform on SO(3), a rotation of an angle uniform in [low, high] about a uniform axis, and two images.

    In a world ``in_hand`` a gripper holds the object, and no rectangle hides it. A pair with an image of fewer than 100
    returns is drawn again. Raises ReorientError if none of 100 pairs has enough.
    """
    if world.in_hand:
        sensor = replace(sensor, rectangle=False)
    for _ in range(100):
        placement = world.place(rng, renderer.mesh)
        R_start = so3.sample_uniform(rng, 1)[0]
        R_goal_current = so3.matrix_from_quat(so3.sample_bounded(rng, 1, low_rad, high_rad))[0]
        try:
            current = sense(rng, renderer, world.camera, R_start, placement, sensor, world.quantum_m, occluded=True)
            goal = sense(rng, renderer, world.camera, R_goal_current @ R_start, placement, sensor, world.quantum_m)
            if world.in_hand:
                current, goal = with_losses(
                    rng,
                    Scene.of(renderer, placement, (R_start, R_goal_current @ R_start), (current, goal)),
                    world.in_hand,
                )
        except ReorientError:  # an image without any return, or one of which a gripper leaves too little
            continue
        if min(np.count_nonzero(image.depth_m) for image in (current, goal)) >= FEWEST_RETURNS:
            return Pair(current, goal, R_goal_current, R_start, placement, placement.nominal_pivot_m(rng))
    raise ReorientError("an object shows fewer than 100 returns from everywhere: expected a larger surface")


def view_overlap(renderer: Renderer, pair: Pair) -> float:
    """Share of the surface visible in the goal that is visible in the start as well (co-visible overlap).

    From ray casts at the mesh, without the sensor model: surface hidden by the rectangle or a shadow counts as visible.
    """
    camera, center_m = pair.goal.camera, pair.placement.center_m
    depth_m = renderer.depth(camera, pair.R_goal_current @ pair.R_camera_object, pair.placement)
    points_m = (DepthImage(depth_m, camera).points() - center_m) @ pair.R_goal_current + center_m
    hidden = renderer.shadowed(points_m, np.zeros(3), pair.R_camera_object, pair.placement)
    return 1 - float(hidden.mean())


def scene_of(renderer: Renderer, pair: Pair) -> Scene:
    """The object of a pair in its two poses, with its images."""
    poses = pair.R_camera_object, pair.R_goal_current @ pair.R_camera_object
    return Scene.of(renderer, pair.placement, poses, (pair.current, pair.goal))


def share_on_holes(pair: Pair) -> float:
    """Share of the points of either image that the true rotation takes to a pixel of the other without return, or
    beyond its frame; mean of both directions."""
    shares = []
    center_m = pair.placement.center_m
    for image, other, R in (
        (pair.current, pair.goal, pair.R_goal_current),
        (pair.goal, pair.current, pair.R_goal_current.T),
    ):
        points_m = (image.points() - center_m) @ R.T + center_m
        camera = other.camera
        column = np.floor(camera.fx * points_m[:, 0] / points_m[:, 2] + camera.cx).astype(int)
        row = np.floor(camera.fy * points_m[:, 1] / points_m[:, 2] + camera.cy).astype(int)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        shares.append(1 - np.count_nonzero(other.valid[row[inside], column[inside]]) / len(points_m))
    return float(np.mean(shares))


LARGEST_CHUNK = 64  # pairs that one read of a stored set loads at most


@dataclass(frozen=True)
class PairSet:
    """Pairs to generate."""

    objects: ObjectSource = field(default_factory=ObjectSource)
    """Objects that are drawn."""
    pairs_per_object: int = 200
    """Number of pairs of each object, each with its own start and rotation."""
    world: str = "paper"
    """Preset of camera, object size and distance: paper, benchmark or in_hand."""
    low_deg: float = 0.0
    """Smallest angle between current and goal image."""
    high_deg: float = 30.0
    """Largest angle between current and goal image."""
    noise_mm: float = 0.0
    """Standard deviation of the sensor's depth noise, besides occluded pixels and dropouts."""
    in_hand: float = 0.0
    """Share of the pairs that are of the preset in_hand, before the camera of the world."""
    seed: int = 0
    """Seed of the pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for an unknown world and for values outside their range."""
        load_world(self.world)
        check_range(self, "low_deg", high=180)
        check_range(self, "high_deg", low=self.low_deg, high=180)
        check_counts(self, "pairs_per_object")
        check_range(self, "noise_mm", "seed")
        check_range(self, "in_hand", high=1)

    @property
    def chunk(self) -> int:
        """Pairs per chunk: the largest divisor of an object's pairs up to LARGEST_CHUNK."""
        return max(n for n in range(1, LARGEST_CHUNK + 1) if self.pairs_per_object % n == 0)
