"""What is no isolated object: each refusal names the cure."""

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from reorient.errors import ReorientError
from reorient.imaging.connected import ObjectClusters
from reorient.imaging.depth_image import MILLIMETRES_ABOVE, NEAREST_M, DepthImage
from reorient.imaging.masks import Mask
from reorient.imaging.planes import Plane

ISOLATED_BELOW = 0.6  # an isolated object fills at most this share of the image
_HELD, _HELD_BY_NARROW = 0.4, 0.6  # share of the object that a plane may hold which continues beyond it
_AROUND = 0.6  # of the rim of a mask along which a plane continues that a mask of the object alone does not have
_CUT_SHARE, _CUT_PX = 0.05, 6  # of the outline may continue beyond the limits, or this many pixels
_STEP_M = 0.006  # in depth between neighbours, up to which a surface continues; more where it is seen at an angle
_CROSS = ndimage.generate_binary_structure(2, 1)


def require_isolated(image: DepthImage) -> DepthImage:
    """The image itself. Raises ReorientError for a whole scene: returns on over 60% of the image and on over half of
    its border (a tight crop of an object has few returns on the border); and for an object at no possible distance."""
    share = float(np.mean(image.valid))
    border = np.concatenate([image.valid[[0, -1]].ravel(), image.valid[:, [0, -1]].ravel()])
    if share > ISOLATED_BELOW and float(np.mean(border)) > 0.5:
        raise ReorientError(
            f"isolate the object: returns fill {share:.0%} of the image, expected at most {ISOLATED_BELOW:.0%}; "
            "give a mask, a box, a near/far range, or remove the table (--mask, --box, --near, --far, --remove-plane)"
        )
    returns_m = image.depth_m[image.valid]
    if returns_m.max() > MILLIMETRES_ABOVE or returns_m.min() < NEAREST_M:
        median_m = float(np.median(returns_m))
        if not NEAREST_M <= median_m <= MILLIMETRES_ABOVE:
            raise ReorientError(
                f"the object is at {median_m:.3g} m (median of {returns_m.min():.3g} to {returns_m.max():.3g} m), "
                f"expected {NEAREST_M} to {MILLIMETRES_ABOVE:g} m: choose it with --near, --far or --mask (or the "
                "depth scale is wrong)"
            )
    return image


def refuse_second_object(image: DepthImage, found: ObjectClusters) -> None:
    """Raise ReorientError where two clusters of similar size are left."""
    if found.other is not None:
        first, second = (_place(image, mask) for mask in (found.mask, found.other))
        raise ReorientError(
            f"two objects are left, {first} and {second}, with a gap between them: choose one with --box, --mask or "
            "--around X Y Z RADIUS (--allow-touching keeps both)"
        )


def refuse_continuing(image: DepthImage, mask: Mask, part: Mask, planes: Sequence[Plane], trusted: bool) -> None:
    """Raise ReorientError where the object continues beyond a part of the frame: the box, depth range and sphere; or
    where a plane that continues holds most of it.

    ``trusted``: the user's own mask is given. The foot of a low object is in the table's plane then, along a part of
    the mask's rim; a mask with much of the table has it along nearly all of the rim.
    """
    if trusted:
        planes = [plane for plane in planes if plane.rim_share > _AROUND]
    points_m = _points(image, mask)
    held = [float(np.mean(plane.holds(points_m))) * plane.is_wide for plane in planes]
    if max(held, default=0.0) > _HELD:
        _refuse_held(image, mask, max(held), "add --remove-plane")
    _refuse_cut(image, mask, part)
    held = [float(np.mean(plane.holds(points_m))) for plane in planes]
    if max(held, default=0.0) > _HELD_BY_NARROW:
        _refuse_held(image, mask, max(held), "choose the object with --box, --far or --around")


def _refuse_held(image: DepthImage, mask: Mask, share: float, cure: str) -> NoReturn:
    raise ReorientError(
        f"{share:.0%} of the remaining returns lie on a plane that continues beyond them (a table or a wall, "
        f"{_distance(image, mask)}): {cure}, or give a --mask of the object or the --background without it "
        "(--allow-touching keeps it)"
    )


def _refuse_cut(image: DepthImage, mask: Mask, part: Mask) -> None:
    pitch_m = image.depth_m / image.camera.fx
    cut = np.zeros_like(mask)
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        beyond = np.roll((image.depth_m > 0) & ~part, step, axis)
        continues = np.abs(np.roll(image.depth_m, step, axis) - image.depth_m) < _STEP_M + 2 * pitch_m
        edge = (slice(None),) * axis + (0 if step > 0 else -1,)
        beyond[edge] = False  # rolled around the frame
        cut |= mask & beyond & continues
    outline = np.count_nonzero(mask & ~ndimage.binary_erosion(mask, _CROSS, border_value=1))
    if (count := np.count_nonzero(cut)) > max(_CUT_PX, _CUT_SHARE * outline):
        raise ReorientError(
            f"the remaining returns continue beyond the box, depth range or sphere along {count} px of their outline, "
            f"{_distance(image, cut)} (a table, wall or gripper, or the object is larger): add --remove-plane, choose "
            "wider limits, or give a --mask or --background (--allow-touching keeps it)"
        )


def _points(image: DepthImage, mask: Mask) -> Float[np.ndarray, "n 3"]:
    return np.asarray(image.camera.rays()[mask] * image.depth_m[mask][:, None])


def _distance(image: DepthImage, mask: Mask) -> str:
    return f"at {np.median(image.depth_m[mask]):.2f} m"


def _place(image: DepthImage, mask: Mask) -> str:
    row, column = (round(float(np.median(line))) for line in np.nonzero(mask))
    return f"{np.count_nonzero(mask)} px around column {column}, row {row} {_distance(image, mask)}"
