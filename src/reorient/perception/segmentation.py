"""From the frames of a cell to the isolated object (paper, "Controller Experiments on Physical Objects").

Points in world axes within a box around the gripper are kept; the gripper is removed, by its colour as in the paper or
by its known shape at its measured pose; the rest is cropped to 128 x 128. A mask can also contain pixels of the object
without a return; depth only contains returns. Nothing here depends on whether the cell is real or simulated.
"""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from reorient import se3
from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.imaging.masks import Mask, longer_side, window
from reorient.imaging.unknown import unknown_beside
from reorient.perception.calibration import Calibration
from reorient.perception.colour import ColourRange
from reorient.perception.filling import beside, filled_by_colour, filled_gaps
from reorient.perception.frame import Frame, align, robot_depth, robot_points

CROP_PX, SIZE_PX = 256, 128  # smallest window (the paper's), and the size it is resized to
_MARGIN = 1.1  # of a larger window, over the extent of the object
_SPECK = 0.01  # connected parts below this share of the largest are removed


@runtime_checkable
class Segmentation(Protocol):
    """Separates the object from the gripper."""

    def keep(self, frame: Frame, calibration: Calibration, inside: Mask) -> Mask:
        """The returns of the object among those inside the box."""
        ...

    def fill(self, frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
        """The pixels of the object without a return, given those with one."""
        ...


@dataclass(frozen=True)
class ByShape:
    """Removes returns near the robot's known surface at its measured pose. Needs no colour."""

    margin_m: float = 0.002
    """Tolerance for errors of the calibration, the joints and the depth."""

    def keep(self, frame: Frame, calibration: Calibration, inside: Mask) -> Mask:
        """Returns farther than the margin from the robot's visible surface."""
        kept = inside.copy()
        surface_m = robot_points(frame, calibration.depth)
        points_m = frame.depth.camera.rays()[inside] * frame.depth.depth_m[inside][:, None]
        kept[inside] = np.isinf(cKDTree(surface_m).query(points_m, distance_upper_bound=self.margin_m)[0])
        return kept

    def fill(self, frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
        """As ``ByColour`` if the frame has colours, else gaps; no pixels where the robot is in front of the object."""
        beside_m, _ = beside(frame, mask)
        robot_m = robot_depth(frame.robot, calibration.depth, frame.depth.camera)
        before = (robot_m > 0) & (robot_m < beside_m + self.margin_m)
        coloured = frame.color is not None and calibration.color is not None
        filled = filled_by_colour(frame, calibration, mask) if coloured else filled_gaps(frame, mask)
        return np.asarray(filled & ~before)


@dataclass(frozen=True)
class ByColour:
    """Removes returns of the gripper's colour: the paper's HSV segmentation."""

    gripper: ColourRange
    """Colours of the gripper."""

    def keep(self, frame: Frame, calibration: Calibration, inside: Mask) -> Mask:
        """Returns whose colour is not the gripper's; those of unknown colour are treated as the nearest known one."""
        rgb, known = align(frame, calibration)
        known &= inside
        if not known.any():
            raise ReorientError("the colour camera sees nothing of the box: expected calibrated cameras that overlap")
        is_object = known & ~self.gripper.contains(rgb)
        nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        return np.asarray(is_object[tuple(nearest)] & inside)

    def fill(self, frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
        """Pixels with a colour of the object but not of its surroundings."""
        return filled_by_colour(frame, calibration, mask)


@dataclass(frozen=True)
class Box:
    """The region around the tool centre that can contain the object."""

    half_m: tuple[float, float, float] = (0.14, 0.14, 0.14)
    """Half extents along the world axes; enough for an object of 65 mm radius held at its end."""

    def inside(self, frame: Frame, calibration: Calibration) -> Mask:
        """The returns inside the box."""
        mask = frame.depth.valid
        points_m = se3.apply(calibration.depth.T_world_camera, frame.depth.points())
        mask[mask] = np.all(np.abs(points_m - frame.tool_m) <= self.half_m, axis=1)
        return mask


# --- from a frame to the object -------------------------------------------------------------------------------------


def isolate_object(
    frame: Frame, calibration: Calibration, segmentation: Segmentation, box: Box | None = None
) -> DepthImage:
    """Depth of the object alone, 128 x 128. Raises ReorientError if no return of it is left.

    Unknown are the gripper's pixels, lost returns inside and next to the object, and what is in front of it.
    """
    inside, mask = _segmented(frame, calibration, segmentation, box)
    unknown = (inside & ~mask) | unknown_beside(frame.depth, mask, inside)
    return crop(replace(frame.depth, depth_m=np.where(mask, frame.depth.depth_m, np.float32(0)), unknown=unknown))


def object_mask(frame: Frame, calibration: Calibration, segmentation: Segmentation, box: Box | None = None) -> Mask:
    """All pixels that show the object, with or without a return. Raises ReorientError if no return of it is left."""
    returned = object_returns(frame, calibration, segmentation, box)
    return np.asarray(returned | segmentation.fill(frame, calibration, returned))


def object_returns(frame: Frame, calibration: Calibration, segmentation: Segmentation, box: Box | None = None) -> Mask:
    """The returns of the object. Raises ReorientError if there are none."""
    return _segmented(frame, calibration, segmentation, box)[1]


def _segmented(
    frame: Frame, calibration: Calibration, segmentation: Segmentation, box: Box | None
) -> tuple[Mask, Mask]:
    """The returns inside the box, and those of the object. Raises ReorientError if there are none."""
    inside = (box or Box()).inside(frame, calibration)
    if not inside.any():
        raise ReorientError(
            "no returns in the box around the gripper: expected the gripper in view and the calibration of this cell"
        )
    rows, columns = window(inside)  # only the box is segmented
    part = frame.depth.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    mask = np.zeros_like(inside)
    mask[rows, columns] = _without_specks(
        segmentation.keep(replace(frame, depth=part), calibration, inside[rows, columns])
    )
    if not mask.any():
        raise ReorientError(
            "the segmentation leaves nothing: expected an object in the gripper, and a colour range or margin that "
            "spares it"
        )
    return inside, mask


def crop(image: DepthImage, least_px: int = CROP_PX, size_px: int = SIZE_PX) -> DepthImage:
    """A square window around the returns of at least ``least_px``, resized by nearest neighbour."""
    rows, columns = window(image.valid)
    side = max(least_px, int(_MARGIN * longer_side((rows, columns))) + 2)
    left, top = ((line.start + line.stop - side) // 2 for line in (columns, rows))
    return image.cropped(left, top, side, side).resized(size_px, size_px)


def learn_gripper_colour(empty: Frame, calibration: Calibration, box: Box | None = None) -> ColourRange:
    """The gripper's colours, learned from one frame of the empty gripper."""
    rgb, known = align(empty, calibration)
    return ColourRange.learned(rgb[known & (box or Box()).inside(empty, calibration)])


def _without_specks(mask: Mask) -> Mask:
    """The mask without connected parts that are far smaller than the largest."""
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    if count == 0:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray((sizes >= _SPECK * sizes.max())[labels])
