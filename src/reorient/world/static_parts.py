"""Parts of an image that are neither the object nor removed from it, and that do not move with it: a table's fragment,
or a gripper that stays where it is."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy.random import Generator
from scipy import ndimage

from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.world.gripper import grip
from reorient.world.in_hand import Hand
from reorient.world.losses import Scene

FEWEST_OBJECT_PX = 100  # of the object, in each image
_DRAWS = 30


@dataclass(frozen=True)
class StaticPart:
    """Two images with the same part in both."""

    images: tuple[DepthImage, DepthImage]
    share: float
    """Of the returns, those that do not move with the object; mean of both images."""


def with_static_part(
    rng: Generator, scene: Scene, kind: str, shares: tuple[float, float], noise_m: float = 0.0
) -> StaticPart:
    """Add a static part of a kind (table, gripper) that makes a share of the returns, drawn from a range.

    ``noise_m``: standard deviation of its depth noise, drawn anew for each image. Raises ReorientError if 30 draws do
    not reach the share.
    """
    share = rng.uniform(*shares)
    for _ in range(_DRAWS):
        depth_m = _table(rng, scene) if kind == "table" else _gripper(rng, scene)
        part = _added(rng, scene, depth_m, share, noise_m)
        if part is not None and shares[0] <= part.share <= shares[1]:
            return part
    raise ReorientError(f"no {kind} makes {share:.0%} of these images: expected a smaller object, or a smaller share")


def _added(
    rng: Generator, scene: Scene, depth_m: Float[np.ndarray, "h w"], share: float, noise_m: float
) -> StaticPart | None:
    """The part cut off at a distance from the object so that it makes the share; None if too little of the object, or
    of the part, is left."""
    current = scene.images[0]
    shown = (depth_m > 0) & (~current.valid | (depth_m < current.depth_m))
    count = round(share / (1 - share) * np.count_nonzero(current.valid & ~shown))
    if not 0 < count <= np.count_nonzero(shown):
        return None
    ragged = 3 * ndimage.gaussian_filter(rng.standard_normal(shown.shape), 4) * 8
    away = ndimage.distance_transform_edt(~current.valid) + ragged
    kept = (depth_m > 0) & (away <= np.partition(away[shown], count - 1)[count - 1])
    images, shares = [], []
    for image in scene.images:
        noise = ndimage.gaussian_filter(rng.standard_normal(shown.shape), 1)
        noisy_m = depth_m + noise_m * noise / noise.std()
        front = kept & (~image.valid | (depth_m < image.depth_m))
        if np.count_nonzero(image.valid & ~front) < FEWEST_OBJECT_PX:
            return None
        images.append(replace(image, depth_m=np.where(front, noisy_m, image.depth_m)))
        shares.append(np.count_nonzero(front) / np.count_nonzero(images[-1].valid))
    return StaticPart((images[0], images[1]), float(np.mean(shares)))


def _table(rng: Generator, scene: Scene) -> Float[np.ndarray, "h w"]:
    """Depth of a plane that supports the object, seen from 20 to 70 degrees above it; the object may be cut by it."""
    elevation, heading = rng.uniform(np.radians(20), np.radians(70)), rng.uniform(-0.5, 0.5)
    across = np.array([np.sin(heading), -np.cos(heading), 0.0])  # mostly upwards in the image
    normal = np.cos(elevation) * across - np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    points_m = scene.images[0].points()
    lowest = np.quantile((points_m - scene.placement.center_m) @ normal, 0.02)
    return _plane(scene.images[0].camera, normal, scene.placement.center_m @ normal + lowest)


def _plane(camera: Camera, normal: Float[np.ndarray, "3"], offset_m: float) -> Float[np.ndarray, "h w"]:
    """Depth of the plane normal . x = offset, up to 2 m, 0 elsewhere."""
    slope = camera.rays() @ normal
    depth_m = offset_m / np.where(np.abs(slope) > 1e-6, slope, 1e-6)
    reached: Bool[np.ndarray, "h w"] = (depth_m > 0.1) & (depth_m < 2.0)
    return np.where(reached, depth_m, 0)


def _gripper(rng: Generator, scene: Scene) -> Float[np.ndarray, "h w"]:
    """Depth of a gripper that holds the object in the first pose and stays there."""
    gripper = grip(rng, scene.renderer, scene.placement, scene.R_camera_object, Hand())
    return gripper.depth(scene.images[0].camera, scene.R_camera_object[0], scene.placement)
