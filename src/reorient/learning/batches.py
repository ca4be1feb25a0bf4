"""From stored pairs to training batches: views of a virtual camera, labels in its axes, augmentation."""

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
    filled,
    join,
    network_input,
    outline,
    pivot_guess,
    rotated,
)
from reorient.learning.pair_reader import Batch, PairReader

FILLS = (0.7, 0.95)  # range of the share that the outline fills in an augmented view, since outlines can be too large
SHIFT = 0.1  # largest shift of the line of sight of an augmented view, over the half width of the outline
AT_ONCE = 16  # pairs prepared together; more do not fit the cache
REMAINING_RAD = 0.08  # standard deviation of the rotation that remains in a refinement round


@dataclass(frozen=True)
class Augmentation:
    """Augmentation beyond that of the virtual camera."""

    rotated: float = 0.0
    """Share of pairs whose start is rotated by an almost correct prediction, as in a refinement round."""
    noise: float = 0.0
    """Largest standard deviation of smooth depth noise, over the width of the view."""


def prepare(
    batch: Batch, reader: PairReader, rng: Generator | None = None, augmentation: Augmentation | None = None
) -> tuple[Float[np.ndarray, "n 2 128 128"], Float[np.ndarray, "n 4"], Float[np.ndarray, "n 3 3"]]:
    """Network input, the true quaternions in virtual axes, and the rotation of the object's vertices at the start.

    With ``rng`` the pairs are augmented: the virtual cameras are rolled about the line of sight and their aim and zoom
    vary, half of the pairs are mirrored (which shows the mirrored object), and ``augmentation`` is applied.
    """
    n, augmentation = len(batch.quat_wxyz), augmentation or Augmentation()
    camera = reader.camera
    outlines = join(*(outline(batch.images[:, k] > 0, camera) for k in (0, 1)))
    virtual = aim(outlines) if rng is None else _varied_camera(outlines, rng)
    views = filled(virtual.view(batch.images, camera))
    R_goal_current = virtual.from_camera(so3.matrix_from_quat(batch.quat_wxyz))
    if rng is not None and augmentation.noise > 0:
        for k in (0, 1):
            _add_noise(views[:, k], rng.uniform(0, augmentation.noise, n) * 2 * virtual.tangent, rng)
    if rng is not None and augmentation.rotated > 0:
        chosen = np.nonzero(rng.random(n) < augmentation.rotated)[0]
        part = VirtualCamera(virtual.R_virtual_camera[chosen], virtual.tangent[chosen])
        pivot = batch.pivot_m[chosen] / reader.quantum_m
        views[chosen, 0], R_goal_current[chosen] = _refinement_round(
            views[chosen], R_goal_current[chosen], part, pivot, rng
        )
    images = network_input(views, virtual.tangent)
    quat_wxyz = so3.quat_from_matrix(R_goal_current)
    R_vertices = virtual.R_virtual_camera @ so3.matrix_from_quat(batch.quat_start_wxyz)
    if rng is not None:
        mirrored = rng.random(n) < 0.5
        images[mirrored] = images[mirrored, :, :, ::-1]
        quat_wxyz[mirrored] *= np.array([1.0, 1.0, -1.0, -1.0])  # of M R M with M = diag(-1, 1, 1)
        R_vertices[mirrored, 0] *= -1
    return images, quat_wxyz, R_vertices


def _varied_camera(outlines: Float[np.ndarray, "n 2 2"], rng: Generator) -> VirtualCamera:
    """Virtual cameras of random aim, zoom and roll."""
    n = len(outlines)
    half = np.ptp(outlines, axis=2).max(axis=1, keepdims=True) / 2
    shift = rng.uniform(-SHIFT, SHIFT, (n, 2)) * half
    target = np.concatenate([outlines.mean(axis=2) + shift, np.ones((n, 1))], axis=1)
    aimed = aim(outlines, target, rng.uniform(*FILLS, n))
    roll = so3.exp(rng.uniform(-np.pi, np.pi, n)[:, None] * np.array([0.0, 0.0, 1.0]))
    return VirtualCamera(roll @ aimed.R_virtual_camera, aimed.tangent)


def _refinement_round(
    views: Float32[np.ndarray, "n 2 size size"],
    R_goal_current: Float[np.ndarray, "n 3 3"],
    virtual: VirtualCamera,
    pivot: Float[np.ndarray, "n 3"],
    rng: Generator,
) -> tuple[Float32[np.ndarray, "n size size"], Float[np.ndarray, "n 3 3"]]:
    """Starts rotated by almost correct predictions, and the rotations that remain.

    ``pivot``: nominal rotation centres, camera axes, in the unit of the views. Half of the pairs use them, the others
    use guessed ones.
    """
    n = len(views)
    remaining = so3.exp(so3.sample_axes(rng, n) * (REMAINING_RAD * rng.standard_normal((n, 1))))
    predicted = np.swapaxes(remaining, 1, 2) @ R_goal_current
    start, goal = views[:, 0], views[:, 1]
    start_center, goal_center = pivot_guess(start, virtual.tangent), pivot_guess(goal, virtual.tangent)
    known = rng.random(n) < 0.5
    center = np.einsum("nij,nj->ni", virtual.R_virtual_camera, pivot)
    start_center[known], goal_center[known] = center[known], center[known]
    return rotated(start, virtual.tangent, predicted, start_center, goal_center), remaining


@cache
def _noise_fields() -> Float32[np.ndarray, "256 size size"]:
    """Unit noise, smooth over a pixel. Drawn once, because new draws take as long as the rest of a batch."""
    white = np.random.default_rng(0).standard_normal((256, SIZE_PX, SIZE_PX)).astype(np.float32)
    smooth = ndimage.gaussian_filter(white, (0, 1, 1), mode="wrap")
    return np.asarray(smooth / smooth.std())


def _add_noise(view_m: Float32[np.ndarray, "n size size"], share: Float[np.ndarray, " n"], rng: Generator) -> None:
    """Add noise in place; ``share``: its standard deviation over the mean depth of each view."""
    n = len(view_m)
    count = np.maximum(np.count_nonzero(view_m, axis=(1, 2)), 1)
    scale = share * view_m.sum(axis=(1, 2)) / count * rng.choice([-1, 1], n)
    fields = _noise_fields()[rng.integers(256, size=n)]
    view_m += np.where(view_m > 0, fields * scale.astype(np.float32)[:, None, None], 0)


class Batches(IterableDataset[dict[str, Tensor]]):
    """The batches of one epoch, starting at any of them; each has its own random stream, so that a run can resume."""

    def __init__(
        self,
        reader: PairReader,
        objects: Sequence[int],
        size: int,
        seed: tuple[int, ...],
        first: int = 0,
        process: tuple[int, int] = (0, 1),
        augmentation: Augmentation | None = None,
        limit: int | None = None,
    ) -> None:
        """``size``: pairs of one process; ``first``: index of the first batch; ``process``: index and number of the
        processes that share each step; ``limit``: at most this many pairs."""
        super().__init__()
        self._reader, self._size, self._seed, self._first = reader, size, seed, first
        (self._rank, self._processes), self._augmentation = process, augmentation
        self._order = reader.order(objects, np.random.default_rng(seed))[:limit]

    def __len__(self) -> int:
        """Number of batches of the whole epoch, without an incomplete last one if there are others."""
        return max(len(self._order) // (self._size * self._processes), 1)

    def __iter__(self) -> Iterator[dict[str, Tensor]]:
        for k in range(self._first, len(self)):
            start = (k * self._processes + self._rank) * self._size
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
