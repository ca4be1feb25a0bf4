"""One thing at a time made worse: under what conditions a pair is seen.

World `benchmark`; unless it is what is varied: 1 mm of depth noise, the paper's rectangle and dropouts, 0 to 30
degrees, exact intrinsics, 128 pixels. All levels of a sweep show the same objects in the same orientations.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.world.pairs import Pair, sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised, sense

WORLD = "benchmark"


@dataclass(frozen=True)
class Condition:
    """Sensing conditions of a pair."""

    noise_mm: float = 1.0
    dropout: float = 0.01
    """Share of the pixels without return."""
    occluded: float | None = None
    """Share of the start's returns behind a straight band; None: the paper's rectangle."""
    focal_error: float = 0.0
    """Relative error of the stated focal length, up or down."""
    size_px: int = 128
    """Of the image; the field of view stays."""
    low_deg: float = 0.0
    high_deg: float = 30.0


@dataclass(frozen=True)
class Sweep:
    """One varied parameter with its conditions."""

    axis: str
    level: str
    """A level in words, by the fields of its condition."""
    conditions: Mapping[float, Condition]
    """By what is drawn along the axis."""

    def words(self, level: float) -> str:
        """A level in words."""
        return self.level.format(self.conditions[level])


RANGES_DEG = ((0, 10), (10, 20), (20, 30), (30, 45), (45, 60), (60, 90))
SWEEPS: Mapping[str, Sweep] = {
    "noise": Sweep(
        "depth noise, mm",
        "{0.noise_mm:g} mm of noise",
        {x: Condition(noise_mm=x) for x in (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)},
    ),
    "dropouts": Sweep(
        "pixels without return, %",
        "{0.dropout:.0%} without return",
        {x: Condition(dropout=x / 100) for x in (1.0, 5.0, 10.0, 25.0, 50.0)},
    ),
    "occlusion": Sweep(
        "part of the start occluded, %",
        "{0.occluded:.0%} occluded",
        {x: Condition(occluded=x / 100) for x in (0.0, 10.0, 20.0, 35.0, 50.0)},
    ),
    "intrinsics": Sweep(
        "focal length wrong by, %",
        "focal length {0.focal_error:.0%} wrong",
        {x: Condition(focal_error=x / 100) for x in (0.0, 1.0, 2.0, 3.0, 5.0)},
    ),
    "image size": Sweep(
        "pixels", "{0.size_px} pixels", {float(x): Condition(size_px=x) for x in (32, 48, 64, 96, 128, 256)}
    ),
    "angle": Sweep(
        "angle between start and goal, degrees",
        "{0.low_deg:g} to {0.high_deg:g} degrees",
        {(low + high) / 2: Condition(low_deg=low, high_deg=high) for low, high in RANGES_DEG},
    ),
}


def see(renderer: Renderer, condition: Condition, rng: np.random.Generator) -> Pair:
    """A pair under a condition; the same ``rng`` shows the same orientations whatever the condition."""
    world = load_world(WORLD)
    pair = sample_pair(rng, renderer, world, randomised(), *np.radians([condition.low_deg, condition.high_deg]))
    camera = world.camera.resized(condition.size_px, condition.size_px)
    sensor = replace(
        randomised(0.001),  # without noise, too, it loses returns as a real camera does
        noise_m=condition.noise_mm / 1000,
        dropout=condition.dropout,
        rectangle=condition.occluded is None,
    )
    poses = (pair.R_camera_object, pair.R_goal_current @ pair.R_camera_object)
    current, goal = (
        _sense(rng, renderer, camera, pose, pair.placement, sensor, world.quantum_m, pose is poses[0]) for pose in poses
    )
    if condition.occluded:
        current = _behind_band(current, condition.occluded, rng)
    wrong = 1 + condition.focal_error * rng.choice([-1, 1])
    stated = replace(camera, fx=camera.fx * wrong, fy=camera.fy * wrong)
    return replace(pair, current=replace(current, camera=stated), goal=replace(goal, camera=stated))


def _sense(*what: Any) -> DepthImage:
    """An image with something in it: the rectangle may hide all of a thin object in a small image."""
    for _ in range(100):
        with suppress(ReorientError):
            return sense(*what)
    raise ReorientError("nothing of an object is seen in a hundred images: expected a larger image")


def _behind_band(image: DepthImage, occluded: float, rng: np.random.Generator) -> DepthImage:
    """Without this share of the returns: those in a straight band of any direction and place."""
    rows, columns = np.nonzero(image.valid)
    direction = rng.uniform(0, np.pi)
    across = np.cos(direction) * rows + np.sin(direction) * columns
    first = rng.uniform(0, 1 - occluded)
    low, high = np.quantile(across, [first, first + occluded])
    behind = (across >= low) & (across <= high)
    depth_m = image.depth_m.copy()
    depth_m[rows[behind], columns[behind]] = 0
    return replace(image, depth_m=depth_m)
