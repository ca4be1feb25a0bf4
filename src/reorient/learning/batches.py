"""From stored pairs to what a network trains on: split by object, views of a virtual camera, labels in its axes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy.random import Generator
from scipy import ndimage
from torch import Tensor
from torch.utils.data import IterableDataset

from reorient import so3
from reorient.imaging.virtual_camera import (
    SIZE_PX,
    VirtualCamera,
    aim,
    join,
    network_input,
    outline,
    pivot_guess,
    rotated,
)
from reorient.learning.pair_store import Batch, PairReader

FILLS = (0.7, 0.95)  # how an augmented view is zoomed: not every outline is as tight as the true one
SHIFT = 0.1  # and aimed, in half widths
AT_ONCE = 16  # pairs prepared together: more do not fit the cache
REMAINING_RAD = 0.08  # what an answer that is nearly right leaves, standard deviation


@dataclass(frozen=True)
class Augmentation:
    """What is varied on the way from the store to the network, beside each virtual camera."""

    turned: float = 0.0
    """Share of pairs whose start is shown turned by an answer that is nearly right, as in a further round."""
    noise: float = 0.0
    """Largest standard deviation of smooth depth noise, of the width of the view."""


def prepare(
    batch: Batch, reader: PairReader, rng: Generator | None = None, augmentation: Augmentation | None = None
) -> tuple[Float[np.ndarray, "n 2 128 128"], Float[np.ndarray, "n 4"], Float[np.ndarray, "n 3 3"]]:
    """Network input, the true quaternions in virtual axes, and what poses the object's vertices at the start there.

    With ``rng`` the virtual cameras are augmented: rolled about the line of sight, aimed and zoomed a little wrong, and
    half of the pairs mirrored - which shows a mirrored object, as good as any other - and what ``augmentation`` says.
    """
    n = len(batch.quat_wxyz)
    camera = reader.camera
    outlines = join(*(outline(batch.images[:, k] > 0, camera) for k in (0, 1)))
    if rng is None:
        virtual = aim(outlines)
    else:
        half = np.ptp(outlines, axis=2).max(axis=1, keepdims=True) / 2
        shift = rng.uniform(-SHIFT, SHIFT, (n, 2)) * half
        target = np.concatenate([outlines.mean(axis=2) + shift, np.ones((n, 1))], axis=1)
        aimed = aim(outlines, target, rng.uniform(*FILLS, n))
        roll = so3.exp(rng.uniform(-np.pi, np.pi, n)[:, None] * np.array([0.0, 0.0, 1.0]))
        virtual = VirtualCamera(roll @ aimed.R_virtual_camera, aimed.tangent)
    views = virtual.view(batch.images, camera)
    R_goal_current = virtual.from_camera(so3.matrix_from_quat(batch.quat_wxyz))
    if rng is not None and augmentation is not None and augmentation.noise > 0:
        for k in (0, 1):
            _add_noise(views[:, k], rng.uniform(0, augmentation.noise, n) * 2 * virtual.tangent, rng)
    if rng is not None and augmentation is not None and augmentation.turned > 0:
        chosen = np.nonzero(rng.random(n) < augmentation.turned)[0]
        left = so3.exp(so3.sample_axes(rng, len(chosen)) * (REMAINING_RAD * rng.standard_normal((len(chosen), 1))))
        done = np.swapaxes(left, 1, 2) @ R_goal_current[chosen]
        part = VirtualCamera(virtual.R_virtual_camera[chosen], virtual.tangent[chosen])
        start, goal = views[chosen, 0], views[chosen, 1]
        start_center, goal_center = pivot_guess(start, part.tangent), pivot_guess(goal, part.tangent)
        known = rng.random(len(chosen)) < 0.5
        pivot = np.einsum("nij,nj->ni", part.R_virtual_camera, batch.pivot_m[chosen]) / reader.quantum_m
        start_center[known], goal_center[known] = pivot[known], pivot[known]
        views[chosen, 0] = rotated(start, part.tangent, done, start_center, goal_center)
        R_goal_current[chosen] = left
    images = network_input(views, virtual.tangent)
    quat_wxyz = so3.quat_from_matrix(R_goal_current)
    pose = virtual.R_virtual_camera @ so3.matrix_from_quat(batch.quat_start_wxyz)
    if rng is not None:
        mirrored = rng.random(n) < 0.5
        images[mirrored] = images[mirrored, :, :, ::-1]
        quat_wxyz[mirrored] *= np.array([1.0, 1.0, -1.0, -1.0])  # of M R M with M = diag(-1, 1, 1)
        pose[mirrored, 0] *= -1
    return images, quat_wxyz, pose


@cache
def _noise_fields() -> Float32[np.ndarray, "256 size size"]:
    """Unit noise, smooth over a pixel; drawn once, since drawing it anew costs as much as the rest of a batch."""
    white = np.random.default_rng(0).standard_normal((256, SIZE_PX, SIZE_PX)).astype(np.float32)
    smooth = ndimage.gaussian_filter(white, (0, 1, 1), mode="wrap")
    return smooth / smooth.std()


def _add_noise(view_m: Float32[np.ndarray, "n size size"], share: Float[np.ndarray, " n"], rng: Generator) -> None:
    """In place, of this standard deviation over the mean depth of each view."""
    n = len(view_m)
    count = np.maximum(np.count_nonzero(view_m, axis=(1, 2)), 1)
    scale = share * view_m.sum(axis=(1, 2)) / count * rng.choice([-1, 1], n)
    fields = _noise_fields()[rng.integers(256, size=n)]
    view_m += np.where(view_m > 0, fields * scale.astype(np.float32)[:, None, None], 0)


class Batches(IterableDataset[dict[str, Tensor]]):
    """The batches of one epoch, from any of them on: each has randomness of its own, so that a run can resume there."""

    def __init__(
        self,
        reader: PairReader,
        objects: Sequence[int],
        size: int,
        seed: tuple[int, ...],
        first: int = 0,
        rank: int = 0,
        world: int = 1,
        augmentation: Augmentation | None = None,
        limit: int | None = None,
    ) -> None:
        """``size``: pairs of one process; ``rank`` of ``world`` processes takes its part of each step's pairs.
        ``limit``: at most this many pairs."""
        super().__init__()
        self._reader, self._size, self._seed, self._first = reader, size, seed, first
        self._rank, self._world, self._augmentation = rank, world, augmentation
        self._order = reader.order(objects, np.random.default_rng(seed))[:limit]

    def __len__(self) -> int:
        """Batches of the whole epoch; an incomplete last one is left out where there are others."""
        return max(len(self._order) // (self._size * self._world), 1)

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        for k in range(self._first, len(self)):
            start = (k * self._world + self._rank) * self._size
            rng = None if self._augmentation is None else np.random.default_rng([*self._seed, k, self._rank])
            chosen = self._order[start : start + self._size]
            parts = [self._reader.read(chosen[i : i + AT_ONCE]) for i in range(0, len(chosen), AT_ONCE)]
            prepared = [prepare(part, self._reader, rng, self._augmentation) for part in parts]
            images, quat_wxyz, pose = (torch.from_numpy(np.concatenate(x)) for x in zip(*prepared, strict=True))
            yield {
                "images": images,
                "quat_wxyz": quat_wxyz.float(),
                "pose": pose.float(),
                "object_index": torch.from_numpy(np.concatenate([part.object_index for part in parts])),
            }
