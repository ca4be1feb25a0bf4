"""The mean of several depth images of one pose, which has less noise and fewer lost pixels than each of them."""

from collections.abc import Sequence

import numpy as np

from reorient.errors import ReorientError
from reorient.imaging.depth_image import DepthImage

_LEAST_SHARE = 0.5  # of the images with a return at a pixel, below which it is unknown. Not tuned
_DEVIATIONS = 3.0  # of the median deviation from the median: returns farther away do not count. Not tuned
_LEAST_M = 1e-3  # below this distance from the median a return always counts. Not tuned


def mean_image(images: Sequence[DepthImage]) -> DepthImage:
    """The robust mean of images of one pose and one camera; its stamp is that of the last one.

    At each pixel, returns far from the median do not count. A pixel with a return in fewer than half of the images
    becomes unknown where it has any, or where half of them do not know it; else it is not the object. Raises
    ReorientError without images, and for images of different cameras.
    """
    if not images or any(image.camera != images[0].camera for image in images):
        raise ReorientError(f"mean of {len(images)} images: expected at least one, all of the same camera")
    depth_m = np.stack([np.where(image.valid, image.depth_m, np.nan) for image in images]).astype(float)
    seen = np.isfinite(depth_m).sum(axis=0)
    known = seen >= _LEAST_SHARE * len(images)
    chosen_m = depth_m[:, known]
    away_m = np.abs(chosen_m - np.nanmedian(chosen_m, axis=0))
    limit_m = np.maximum(_DEVIATIONS * np.nanmedian(away_m, axis=0), _LEAST_M)
    chosen_m[~(away_m <= limit_m)] = np.nan
    mean_m = np.zeros(seen.shape)
    mean_m[known] = np.nanmean(chosen_m, axis=0)
    unknown = np.mean([image.unknown for image in images], axis=0) >= _LEAST_SHARE
    return DepthImage(mean_m, images[0].camera, images[-1].stamp_s, ~known & (unknown | (seen > 0)))
