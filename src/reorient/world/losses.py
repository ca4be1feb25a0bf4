"""Frames of an object in a gripper: what isolating it from a real depth camera's frame leaves of it.

A loss is a mask for each of two images of a pair. Its pixels are without return; they are *known* to be lost (unknown
pixels of the depth image), or they are not, as in recordings that store 0 for both. The fingers and dark patches are
part of the object's motion: they hide other parts of the image in either pose, and the same parts of the surface.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy.random import Generator
from scipy import ndimage

from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.world.gripper import Gripper, grip
from reorient.world.in_hand import InHand, Range
from reorient.world.rendering import Placement, Renderer

Masks = Bool[np.ndarray, "2 h w"]


@dataclass(frozen=True)
class Scene:
    """One object in two poses before a camera, and its images."""

    renderer: Renderer
    placement: Placement
    R_camera_object: Float[np.ndarray, "2 3 3"]
    """Of the current and of the goal image."""
    images: tuple[DepthImage, DepthImage]
    seen: Masks
    """The pixels that show the object, whether they have a return or not."""

    @classmethod
    def of(
        cls,
        renderer: Renderer,
        placement: Placement,
        poses: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]],
        images: tuple[DepthImage, DepthImage],
    ) -> "Scene":
        """The scene of two images of the same camera; ``poses``: R_camera_object of each."""
        depth_m = [renderer.depth(images[0].camera, R, placement) for R in poses]
        return cls(renderer, placement, np.stack(poses), images, np.stack(depth_m) > 0)

    @property
    def pixel(self) -> float:
        """Pixels of this camera for one of an image 128 pixels wide."""
        return self.images[0].camera.width / 128

    def object_points(self, k: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """The returns of image k as points, in camera axes and in the object's axes about its origin, metres."""
        points_m = self.images[k].points()
        return points_m, (points_m - self.placement.center_m) @ self.R_camera_object[k]

    def share(self, masks: Masks) -> Float[np.ndarray, "2"]:
        """Share of the returns of each image that the masks remove."""
        valid = np.stack([image.valid for image in self.images])
        return np.asarray((valid & masks).sum(axis=(1, 2)) / valid.sum(axis=(1, 2)))

    def without(self, masks: Mapping[str, Masks], known: frozenset[str]) -> tuple[DepthImage, DepthImage]:
        """The images without the masked returns; the masks named in ``known`` become unknown.

        Raises ReorientError if an image has no return left.
        """
        nothing = np.zeros_like(self.seen)
        lost = np.logical_or.reduce([nothing, *masks.values()])
        unknown = np.logical_or.reduce([nothing, *(mask for name, mask in masks.items() if name in known)])
        current, goal = (
            replace(image, depth_m=np.where(lost[k], 0, image.depth_m), unknown=image.unknown | unknown[k])
            for k, image in enumerate(self.images)
        )
        return current, goal


Loss = Callable[[Generator, Scene, Gripper, InHand], Masks]


def with_losses(rng: Generator, scene: Scene, numbers: InHand) -> tuple[DepthImage, DepthImage]:
    """The images of a scene with the losses of the preset.

    Raises ReorientError if none of 20 draws leaves enough of the object.
    """
    for _ in range(20):
        gripper = grip(rng, scene.renderer, scene.placement, scene.R_camera_object, numbers.hand)
        chosen = {name: loss for name, loss in LOSSES.items() if rng.random() < getattr(numbers, name, 1.0)}
        masks = {name: loss(rng, scene, gripper, numbers) for name, loss in chosen.items()}
        if scene.share(np.logical_or.reduce(list(masks.values()))).max() <= 1 - numbers.least_kept:
            break
    else:
        raise ReorientError("a gripper hides too much of an object: expected a larger surface beside it")
    quantum_m = _log_uniform(rng, numbers.quantum_m)
    images = [quantised(image, quantum_m) for image in scene.without(masks, _known(rng, numbers))]
    if rng.random() < numbers.stray:
        counts = rng.integers(*numbers.stray_count, 2, endpoint=True)
        images = [with_stray_returns(rng, image, count) for image, count in zip(images, counts, strict=True)]
    return images[0], images[1]


def _known(rng: Generator, numbers: InHand) -> frozenset[str]:
    """The losses that the depth image marks as unknown."""
    kind = rng.random()
    share = 1.0 if kind < numbers.all_known else 0.0 if kind < numbers.all_known + numbers.none_known else 0.5
    return frozenset(name for name in LOSSES if rng.random() < share)


def quantised(image: DepthImage, quantum_m: float) -> DepthImage:
    """Depth in whole steps, as of a 16-bit image."""
    steps = np.rint(image.depth_m / quantum_m)
    return replace(image, depth_m=steps * np.float32(quantum_m))


def with_stray_returns(rng: Generator, image: DepthImage, count: int, depth_m: Range = InHand.stray_m) -> DepthImage:
    """Single returns at random pixels of the background, at any depth, uniform in its logarithm."""
    free = np.flatnonzero(~image.valid)
    out, unknown = image.depth_m.copy(), image.unknown.copy()
    for pixel in rng.choice(free, min(count, len(free)), replace=False):
        out.reshape(-1)[pixel] = _log_uniform(rng, depth_m)
        unknown.reshape(-1)[pixel] = False
    return replace(image, depth_m=out, unknown=unknown)


def _log_uniform(rng: Generator, limits: Range) -> float:
    return float(np.exp(rng.uniform(np.log(limits[0]), np.log(limits[1]))))


def _no_return(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """What the sensor itself has lost."""
    lost: Masks = scene.seen & ~np.stack([image.valid for image in scene.images])
    return lost


def _gripper(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """The gripper where it is before the object or beside it, and a margin. Behind the object it is not seen."""
    margin_px = rng.uniform(*numbers.margin_px) * scene.pixel
    masks = []
    for image, R in zip(scene.images, scene.R_camera_object, strict=True):
        depth_m = gripper.depth(image.camera, R, scene.placement)
        shown = (depth_m > 0) & (~image.valid | (depth_m < image.depth_m))
        masks.append(ndimage.distance_transform_edt(~shown) <= margin_px if shown.any() else shown)
    return np.stack(masks)


def _shadow(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """Surface that a projector beside the camera does not reach, and the shadow of the silhouette beside it."""
    side = rng.choice([-1, 1])
    projector_m = np.array([side * rng.uniform(*numbers.baseline_m), 0.0, 0.0])
    half = max(round(rng.uniform(*numbers.shadow_px) * scene.pixel / 2), 1)
    masks = []
    for k, image in enumerate(scene.images):
        points_m, _ = scene.object_points(k)
        where = projector_m, scene.R_camera_object[k], scene.placement
        lost = np.zeros_like(image.valid)
        lost[image.valid] = scene.renderer.shadowed(points_m, *where) | gripper.shadows(points_m, *where)
        shown = scene.seen[k].astype(np.uint8)
        spread = ndimage.maximum_filter1d(shown, 2 * half + 1, axis=1, origin=-side * half)  # away from the projector
        masks.append(lost | (spread.astype(bool) & ~scene.seen[k]))
    return np.stack(masks)


def _patches(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """Balls about points of the surface, with an irregular rim: the same part of the object in both images."""
    radius_m = scene.placement.scale_m * float(np.linalg.norm(scene.renderer.mesh.vertices, axis=1).max())
    points_m = [scene.object_points(k)[1] for k in (0, 1)]
    masks = np.zeros_like(scene.seen)
    for _ in range(rng.integers(*numbers.patch_count, endpoint=True)):
        center_m = rng.choice(points_m[rng.integers(2)])
        size_m = rng.uniform(*numbers.patch_radius) * radius_m
        for k, image in enumerate(scene.images):
            rim = _smooth(rng, image.valid.shape, 2 * scene.pixel)[image.valid]
            masks[k, image.valid] |= np.linalg.norm(points_m[k] - center_m, axis=1) < size_m * (1 + 0.15 * rim)
    return masks


def _holes(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """Irregular holes, other ones in each image."""
    masks = np.zeros_like(scene.seen)
    for mask, seen in zip(masks, scene.seen, strict=True):
        noise = _smooth(rng, seen.shape, rng.uniform(*numbers.hole_px) * scene.pixel)
        mask[seen] = noise[seen] < np.quantile(noise[seen], rng.uniform(*numbers.hole_share))
    return masks


def _edges(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """A rim of the object whose width varies from 0 to its most."""
    masks = []
    for seen in scene.seen:
        width = (
            rng.uniform(*numbers.edge_px)
            * scene.pixel
            * np.clip(0.5 + 0.5 * _smooth(rng, seen.shape, 1.5 * scene.pixel), 0, 1)
        )
        masks.append(seen & (ndimage.distance_transform_edt(seen) <= width))
    return np.stack(masks)


def _box(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """All beyond one line in the image, which cuts the chosen share of the object in the first image."""
    mask = _beyond(scene.seen[0], rng.uniform(0, 2 * np.pi), rng.uniform(*numbers.cut_share))
    return np.stack([mask, mask])


def _frame(rng: Generator, scene: Scene, gripper: Gripper, numbers: InHand) -> Masks:
    """All beyond one side of the frame, in one of the images."""
    masks, k = np.zeros_like(scene.seen), rng.integers(2)
    masks[k] = _beyond(scene.seen[k], rng.integers(4) * np.pi / 2, rng.uniform(*numbers.cut_share))
    return masks


def _beyond(seen: Bool[np.ndarray, "h w"], direction_rad: float, share: float) -> Bool[np.ndarray, "h w"]:
    """The pixels beyond the line across a direction that has a share of the object's pixels beyond it."""
    h, w = seen.shape
    along = np.arange(w) * np.cos(direction_rad) + np.arange(h)[:, None] * np.sin(direction_rad)
    beyond: Bool[np.ndarray, "h w"] = along > np.quantile(along[seen], 1 - share)
    return beyond


def _smooth(rng: Generator, shape: tuple[int, ...], scale_px: float) -> Float[np.ndarray, "h w"]:
    """Noise of mean 0 and standard deviation 1 that is smooth over a scale."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), scale_px, mode="wrap")
    return np.asarray((noise - noise.mean()) / noise.std())


LOSSES: dict[str, Loss] = {
    "no_return": _no_return,
    "gripper": _gripper,
    "shadow": _shadow,
    "patches": _patches,
    "holes": _holes,
    "edges": _edges,
    "box": _box,
    "frame": _frame,
}
"""By name; a field of ``InHand`` of this name is the share of pairs that have it, the others are in every pair."""
