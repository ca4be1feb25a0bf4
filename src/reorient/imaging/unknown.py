"""Pixels beside an isolated object that may hide or miss a part of it."""

import numpy as np
from scipy import ndimage

from reorient.imaging.connected import clusters
from reorient.imaging.depth_image import DepthImage
from reorient.imaging.masks import Mask, longer_side, window

_NEARER_M = 0.005  # a removed return this much in front of the object's nearest one may hide it,
_STEP_M, _STEP_PX = 0.008, 4  # if it belongs to a surface with such a step in depth within this distance of the object,
_FEWEST = 6  # at this many pixels. A table in front of the object has no step
_BESIDE_PX = 2  # pixels without return within this distance of the object are next to it
_SQUARE = np.ones((3, 3), bool)


def unknown_beside(
    image: DepthImage, mask: Mask, candidates: Mask, doubtful: Mask | None = None, inside: Mask | None = None
) -> Mask:
    """The unknown pixels of a frame of which ``mask`` shows the object.

    ``candidates``: returns of which the mask is a part; others of them next to the object are unknown (flying pixels).
    ``doubtful``: removed returns that may belong to the object; they are unknown where they are connected to it.
    ``inside``: the pixels of the object by the user's own mask; without return they are unknown. Connected pixels
    without return that touch the object are unknown unless they reach the end of the frame and are more than the
    object: background out of range. Where a frame has unknown pixels and others without depth, the unknown ones stay.
    """
    empty = ~image.valid & ~image.unknown
    lost = image.unknown if empty.any() and image.unknown.any() else np.zeros_like(mask)
    beside = ndimage.binary_dilation(mask, _SQUARE, _BESIDE_PX) & ~mask
    unknown = lost | (candidates & beside) | _lost_beside(~image.valid, mask, beside) | _before(image, mask)
    if doubtful is not None:
        unknown |= ndimage.binary_propagation(doubtful & beside, _SQUARE, mask=doubtful)
    if inside is not None:
        unknown |= inside & ~image.valid
    return np.asarray(unknown)


def _lost_beside(missing: Mask, mask: Mask, beside: Mask) -> Mask:
    """The components of pixels without return that touch the object, without background out of range."""
    labels, count = ndimage.label(missing, _SQUARE)
    touches = np.zeros(count + 1, bool)
    touches[np.unique(labels[beside])] = True
    ends = np.zeros(count + 1, bool)
    ends[np.unique(np.concatenate([labels[[0, -1]].ravel(), labels[:, [0, -1]].ravel()]))] = True
    background = ends & (np.bincount(labels.ravel(), minlength=count + 1) > np.count_nonzero(mask))
    touches &= ~background
    touches[0] = False
    return np.asarray(touches[labels])


def _before(image: DepthImage, mask: Mask) -> Mask:
    """The removed returns in front of the object, such as of fingers, by the object's nearest return in the image.

    Only within the object's size around it.
    """
    before = np.zeros_like(mask)
    near = window(mask, longer_side(window(mask)))
    distances_px, nearest = ndimage.distance_transform_edt(~mask[near], return_indices=True)
    depth_m = image.depth_m[near]
    nearer_m = depth_m[tuple(nearest)] - depth_m
    before[near] = (depth_m > 0) & ~mask[near] & (nearer_m > _NEARER_M)
    if not before.any():
        return before
    step_m = _STEP_M + 2 * distances_px * depth_m / image.camera.fx
    labels = clusters(image, before)
    step = before[near] & (distances_px <= _STEP_PX) & (nearer_m > step_m)
    steps = np.bincount(labels[near][step], minlength=int(labels.max()) + 1)
    return np.asarray(before & (steps >= _FEWEST)[labels])
