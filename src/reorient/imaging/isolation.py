"""Isolating an object: a mask, a box, a range of depth."""

from dataclasses import replace
from operator import index

import numpy as np
from jaxtyping import Shaped

from reorient.errors import ReorientError
from reorient.imaging.depth_image import DepthImage

ISOLATED_BELOW = 0.6  # an object alone leaves at least this much of the frame empty


def require_isolated(image: DepthImage) -> DepthImage:
    """The image itself. Raises ReorientError for a whole scene: returns on over 60% of it, and on most of its border,
    which a tight crop of an object leaves empty."""
    share = float(np.mean(image.valid))
    border = np.concatenate([image.valid[[0, -1]].ravel(), image.valid[:, [0, -1]].ravel()])
    if share > ISOLATED_BELOW and float(np.mean(border)) > 0.5:
        raise ReorientError(
            f"isolate the object: returns fill {share:.0%} of the image, expected at most {ISOLATED_BELOW:.0%}; "
            "give a mask, a box or a near/far range (--mask, --box, --near, --far)"
        )
    return image


def isolate(
    image: DepthImage,
    mask: Shaped[np.ndarray, "height width"] | None = None,
    box_px: tuple[int, int, int, int] | None = None,
    near_m: float | None = None,
    far_m: float | None = None,
) -> DepthImage:
    """Only the returns inside the mask, the box (left, top, width, height) and the depth range; the size stays.

    Raises ReorientError for a mask of another size, a box that is none, where nothing is left, and where what is left
    is still a scene.
    """
    keep = image.valid.copy()
    if mask is not None:
        mask = np.asarray(mask) != 0
        if mask.shape != keep.shape:
            raise ReorientError(f"mask of shape {mask.shape}: expected {keep.shape} as its depth image")
        if not mask.any():
            raise ReorientError("the mask is empty: expected non-zero pixels on the object")
        keep &= mask
    if box_px is not None:
        try:
            left, top, width, height = (index(x) for x in box_px)
        except (TypeError, ValueError) as error:
            raise ReorientError(f"box {box_px}: expected left, top, width, height in whole pixels") from error
        if width < 1 or height < 1:
            raise ReorientError(f"box of {width} x {height} px: expected left, top, width, height with a size above 0")
        inside = np.zeros_like(keep)
        inside[max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)] = True
        keep &= inside
    if near_m is not None:
        keep &= image.depth_m >= near_m
    if far_m is not None:
        keep &= image.depth_m <= far_m
    if not keep.any():
        raise ReorientError(
            "nothing is left of the image: expected returns inside the mask, the box and the depth range"
        )
    return require_isolated(replace(image, depth_m=np.where(keep, image.depth_m, np.float32(0))))
