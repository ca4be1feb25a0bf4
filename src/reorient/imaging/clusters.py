"""Clusters of returns in space: the object's own, and stray returns far from it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from reorient.imaging.depth_image import DepthImage

CELL = 0.25  # of the clustering, relative to the box around the middle 80% of the returns; returns in adjacent cells
# belong together. A finger in front of an object does not part it
LEAST = 0.1  # of all returns: a smaller cluster apart from the largest one is stray
_REACH = 40  # cells around the middle of the returns; what lies farther is one cell. Not tuned


def without_strays(image: DepthImage) -> DepthImage:
    """The image without small clusters of returns far from the largest one; their pixels become unknown."""
    points_m = image.points()
    cluster = clusters(points_m)
    sizes = np.bincount(cluster)
    if len(sizes) == 1:
        return image
    kept = (sizes >= LEAST * len(points_m)) | (sizes == sizes.max())
    unknown = image.unknown.copy()
    unknown[image.valid] = ~kept[cluster]
    return replace(image, unknown=unknown)


def clusters(points_m: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """The number of each point's cluster, from 0: the connected components of the occupied cells of a grid."""
    low, middle, high = np.percentile(points_m, [10, 50, 90], axis=0)
    size_m = max(float(np.linalg.norm(high - low)), 1e-6)
    cell = np.clip(np.rint((points_m - middle) / (CELL * size_m)), -_REACH, _REACH).astype(int)
    cell -= cell.min(axis=0)
    occupied = np.zeros(cell.max(axis=0) + 1, bool)
    occupied[tuple(cell.T)] = True
    labels, _ = ndimage.label(occupied, np.ones((3, 3, 3)))
    return np.asarray(labels[tuple(cell.T)] - 1)
