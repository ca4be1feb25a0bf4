"""Pixels of the object without a return: found by the object's colour, or as gaps in its outline."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from reorient.imaging.masks import Mask
from reorient.perception.calibration import Calibration
from reorient.perception.colour import ColourTable
from reorient.perception.frame import Frame, align

_GAP_M = 0.02  # missing returns within this distance of the object on both sides are filled
_NEARBY_M = 0.04  # missing returns of the object's colour within this distance are filled


def filled_by_colour(frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
    """Nearby pixels without return that have a colour of the object but not of its surroundings.

    The depth of such a pixel is assumed to be that of the object's nearest return. Where no colour is known, gaps are
    filled.
    """
    beside_m, distance_px = beside(frame, mask)
    missing = ~frame.depth.valid & (distance_px <= _NEARBY_M * _px_per_m(frame, mask))
    assumed_m = np.where(missing, beside_m, frame.depth.depth_m)
    assumed = replace(frame.depth, depth_m=assumed_m, unknown=np.zeros_like(missing))
    rgb, known = align(replace(frame, depth=assumed), calibration)
    others = known & frame.depth.valid & ~mask
    own = ColourTable.learned(rgb[mask & known], rgb[others]).contains(rgb)
    found = missing & np.where(known, own, filled_gaps(frame, mask))
    labels, _ = ndimage.label(found | mask, np.ones((3, 3)))
    return np.asarray(found & np.isin(labels, np.unique(labels[mask])))


def filled_gaps(frame: Frame, mask: Mask) -> Mask:
    """Pixels without return that a morphological closing with a disc adds to the object."""
    reach_px = _GAP_M * _px_per_m(frame, mask)
    near = beside(frame, mask)[1] <= reach_px
    if near.all():  # the disc reaches beyond the image everywhere
        return np.asarray(~frame.depth.valid)
    return np.asarray((ndimage.distance_transform_edt(near) > reach_px) & ~frame.depth.valid)


def beside(frame: Frame, mask: Mask) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """For each pixel the depth of the object's nearest return, metres, and the distance to it in pixels."""
    distance_px, nearest = ndimage.distance_transform_edt(~mask, return_indices=True)
    return frame.depth.depth_m[tuple(nearest)], distance_px


def _px_per_m(frame: Frame, mask: Mask) -> float:
    """Pixels per metre at the object."""
    return frame.depth.camera.fx / float(np.median(frame.depth.depth_m[mask]))
