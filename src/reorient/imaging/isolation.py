"""Isolating an object: a mask, a box, a range of depth."""

from dataclasses import replace
from operator import index

import numpy as np
from jaxtyping import Bool, Shaped

from reorient.errors import ReorientError
from reorient.imaging.depth_image import DepthImage

ISOLATED_BELOW = 0.6  # an isolated object fills at most this share of the image


def require_isolated(image: DepthImage) -> DepthImage:
    """The image itself. Raises ReorientError for a whole scene: returns on over 60% of the image and on over half of
    its border (a tight crop of an object has few returns on the border)."""
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
    """The image with only the returns inside the mask, the box (left, top, width, height) and the depth range.

    Raises ReorientError for a mask of another size, for an invalid box or depth range, if no return is left, and
    if the rest still fills the image like a whole scene.
    """
    keep = image.valid
    if mask is not None:
        keep &= _inside_mask(mask, keep.shape)
    if box_px is not None:
        keep &= _inside_box(box_px, keep.shape)
    if near_m is not None or far_m is not None:
        keep &= _inside_range(image, 0.0 if near_m is None else near_m, np.inf if far_m is None else far_m)
    if not keep.any():
        raise ReorientError(
            "nothing is left of the image: expected returns inside the mask, the box and the depth range"
        )
    return require_isolated(replace(image, depth_m=np.where(keep, image.depth_m, np.float32(0))))


def _inside_range(image: DepthImage, near_m: float, far_m: float) -> Bool[np.ndarray, "height width"]:
    if not near_m < far_m:
        raise ReorientError(f"depth range {near_m:g} to {far_m:g} m: expected near below far")
    inside = np.asarray((image.depth_m >= near_m) & (image.depth_m <= far_m))
    depths_m = image.depth_m[image.valid]
    if depths_m.size and not (inside & image.valid).any():
        between = f"between {near_m:g} and {far_m:g} m" if np.isfinite(far_m) else f"beyond {near_m:g} m"
        raise ReorientError(f"no returns {between} (depths are {depths_m.min():.2f}-{depths_m.max():.2f} m)")
    return inside


def _inside_mask(mask: Shaped[np.ndarray, "..."], shape: tuple[int, ...]) -> Bool[np.ndarray, "height width"]:
    inside = np.asarray(np.asarray(mask) != 0)
    if inside.shape != shape:
        raise ReorientError(f"mask of shape {inside.shape}: expected {shape} as its depth image")
    if not inside.any():
        raise ReorientError("the mask is empty: expected non-zero pixels on the object")
    return inside


def _inside_box(box_px: tuple[int, int, int, int], shape: tuple[int, ...]) -> Bool[np.ndarray, "height width"]:
    try:
        left, top, width, height = (index(x) for x in box_px)
    except (TypeError, ValueError) as error:
        raise ReorientError(f"box {box_px}: expected left, top, width, height in whole pixels") from error
    if width < 1 or height < 1:
        raise ReorientError(f"box of {width} x {height} px: expected left, top, width, height with a size above 0")
    inside = np.zeros(shape, bool)
    inside[max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)] = True
    return inside
