"""Clusters of returns that are connected in the image and in space, and those that belong to one object."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage, sparse
from scipy.spatial import cKDTree

from reorient.imaging.depth_image import DepthImage
from reorient.imaging.masks import Mask

Labels = Int[np.ndarray, "height width"]

_STEP_M = 0.012  # neighbours with a larger step in depth are in different clusters
_FEWEST = 8  # returns of a cluster; fewer are stray ones
_SPECK = 0.03  # of the largest cluster: smaller ones are stray returns, unless
_CLOSE = 0.13  # their gap, relative to the object's size, is below this: leaves, parts seen through holes. On 50 frames
# of household tuning objects on a table 79 of 95 such clusters belonged to the object, and 2 of 493 others
_NEAR = 0.25  # a cluster belongs to the object if its gap, relative to the object's size, is below this,
_BRIDGED = 0.6  # or below this, with no farther returns within the gap: a finger or a shadow cuts the object
_STEP = 0.4  # or below this, where they are neighbours in the image and the nearer one hides what connects them
_HIDDEN = 0.7  # share of the pixels within the gap that must hide it
_SIMILAR = 1 / 3  # of the object's returns: a cluster with at least this many may be meant as well


@dataclass(frozen=True, eq=False)
class ObjectClusters:
    """The largest cluster with those that belong to it."""

    mask: Mask
    other: Mask | None
    """Another cluster of similar size, that does not belong to it; None: there is none."""


def clusters(image: DepthImage, part: Mask) -> Labels:
    """Labels from 1 of the connected parts of a mask; a step in depth between neighbours separates. 0: not in it."""
    indices = np.full(part.shape, -1)
    indices[part] = np.arange(np.count_nonzero(part))
    first, second = [], []
    for here, there in _neighbours(part.shape):
        joined = part[here] & part[there] & (np.abs(image.depth_m[here] - image.depth_m[there]) < _STEP_M)
        first.append(indices[here][joined])
        second.append(indices[there][joined])
    pair = np.concatenate(first), np.concatenate(second)
    count = np.count_nonzero(part)
    graph = sparse.coo_matrix((np.ones(len(pair[0]), np.int8), pair), (count, count))
    labels = np.zeros(part.shape, np.int32)
    labels[part] = sparse.csgraph.connected_components(graph, directed=False)[1] + 1
    return labels


def object_clusters(image: DepthImage, part: Mask, trusted: bool = False) -> ObjectClusters:
    """The largest cluster of a part of a frame, and those that belong to it. ``part`` is not empty.

    A cluster belongs to the object if it is near it in space, or if only nearer returns and pixels without return are
    between them. Stray returns are dropped. ``trusted``: the part is the user's own mask, so that other clusters
    belong to the object, too, unless they are farther away than its size.
    """
    labels = clusters(image, part)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    own = joined = [int(np.argmax(sizes))]
    least = max(_FEWEST, _SPECK * sizes.max())
    rest = [i for i in np.argsort(-sizes) if i != own[0] and sizes[i] >= least]
    while joined and rest:  # a part may be near another part only
        mask = np.isin(labels, own)
        gap = _Gap(image, mask)
        joined = [i for i in rest if gap.is_small(labels == i)]
        own = own + joined
        rest = [i for i in rest if i not in joined]
    mask = _with_specks(image, np.isin(labels, own), labels, (sizes >= _FEWEST) & (sizes < least))
    if trusted and rest:
        gap = _Gap(image, mask)
        others = [i for i in rest if gap.distances(labels == i).min() < 1]
        return ObjectClusters(mask | np.isin(labels, others), None)
    similar = [i for i in rest if sizes[i] >= _SIMILAR * np.count_nonzero(mask)]
    return ObjectClusters(mask, labels == similar[0] if similar else None)


def _with_specks(image: DepthImage, mask: Mask, labels: Labels, is_speck: Bool[np.ndarray, " labels"]) -> Mask:
    """The object with the small clusters that are close to it."""
    specks, numbers = is_speck[labels], np.flatnonzero(is_speck)
    if not numbers.size:
        return mask
    gap = _Gap(image, mask)
    close = np.zeros(len(is_speck), bool)
    close[numbers] = ndimage.minimum(gap.distances(specks), labels[specks], numbers) < _CLOSE
    return np.asarray(mask | close[labels])


def size_m(points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """The extents of points along their principal axes, largest first, metres, without the outermost 1%."""
    centred = points_m - points_m.mean(axis=0)
    axes = np.linalg.svd(centred.T @ centred)[0]
    low, high = np.quantile(centred @ axes, [0.005, 0.995], axis=0)
    return np.sort(high - low)[::-1]


class _Gap:
    """Between an object and other clusters."""

    def __init__(self, image: DepthImage, mask: Mask) -> None:
        self._image = image
        self._pixels = np.argwhere(mask)
        self._beside = ndimage.binary_dilation(mask, np.ones((3, 3)), 2)
        points_m = _points(image, mask)
        self._tree = cKDTree(points_m)
        self._size_m = float(size_m(points_m)[0])
        self._pitch_m = float(np.median(points_m[:, 2])) / image.camera.fx

    def distances(self, cluster: Mask) -> Float[np.ndarray, " n"]:
        """Of each return of a cluster from the object, relative to the object's size."""
        return np.asarray(self._tree.query(_points(self._image, cluster))[0] / self._size_m)

    def is_small(self, cluster: Mask) -> bool:
        """Whether a cluster belongs to the object."""
        distances_m, nearest = self._tree.query(_points(self._image, cluster))
        closest = int(np.argmin(distances_m))
        gap_m = float(distances_m[closest])
        if gap_m < max(_NEAR * self._size_m, 3 * self._pitch_m):
            return True
        if gap_m < _STEP * self._size_m and (self._beside & cluster).any():
            return True
        ends = np.argwhere(cluster)[closest], self._pixels[nearest[closest]]
        return gap_m < _BRIDGED * self._size_m and self._is_bridged(*ends)

    def _is_bridged(self, start: Int[np.ndarray, "2"], end: Int[np.ndarray, "2"]) -> bool:
        """Whether most of the pixels between two returns are nearer than both, or without return."""
        count = int(np.abs(end - start).max()) + 1
        rows, columns = np.rint(np.linspace(start, end, count)).astype(int)[1:-1].T
        between_m = self._image.depth_m[rows, columns]
        limit_m = np.linspace(self._image.depth_m[tuple(start)], self._image.depth_m[tuple(end)], count)[1:-1]
        return bool(np.count_nonzero(between_m < limit_m) > _HIDDEN * len(between_m))


def _points(image: DepthImage, mask: Mask) -> Float[np.ndarray, "n 3"]:
    return np.asarray(image.camera.rays()[mask] * image.depth_m[mask][:, None])


def _neighbours(shape: tuple[int, ...]) -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Views of an image and of the image shifted by a pixel, in the four directions of eight-connectivity."""
    height, width = shape
    up, down = slice(0, height - 1), slice(1, height)
    left, right = slice(0, width - 1), slice(1, width)
    everything = slice(0, height), slice(0, width)
    return [
        ((everything[0], left), (everything[0], right)),
        ((up, everything[1]), (down, everything[1])),
        ((up, left), (down, right)),
        ((up, right), (down, left)),
    ]
