"""From the frames of a cell to the isolated object (paper, "Controller Experiments on Physical Objects").

Colour aligned into the depth camera, points in world axes, a box around the gripper, then the gripper removed, by its
colour as in the paper or, better, by its known shape at its measured pose; the rest cropped to 128 x 128. Where the
sensor returned nothing the object's outline is filled in, as a mask beside the depth, which stays what was returned.
Nothing in here knows whether the cell is real.
"""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import trimesh
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage
from scipy.spatial import cKDTree

from reorient import se3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.imaging.splatting import splat
from reorient.perception.calibration import Calibration, MountedCamera
from reorient.perception.colour import ColourRange, ColourTable
from reorient.world.rendering import Placement, Renderer

CROP_PX, SIZE_PX = 256, 128  # the paper's window, at least, and what it is resized to
_MARGIN = 1.1  # of the window, where the object is larger than that
_SPECK = 0.01  # a connected part smaller than this share of the largest is no part of the object
_BLUR_PX = 1.0  # over which colours are smoothed
_HIDDEN_M = 0.01  # a point this much behind what the colour camera sees there is hidden from it
_GAP_M = 0.02  # missing returns this near to the object on both sides are the object's
_NEARBY_M = 0.04  # and those that have its colour, within this

Mask = Bool[np.ndarray, "height width"]


@dataclass(frozen=True, eq=False)
class ColorImage:
    """What the colour camera saw."""

    rgb: UInt8[np.ndarray, "height width 3"]
    camera: Camera


@dataclass(frozen=True, eq=False)
class Frame:
    """What a cell's cameras and encoders say at one moment. Images may be windows of their sensors."""

    depth: DepthImage
    """Of the whole scene."""
    color: ColorImage | None
    robot: trimesh.Trimesh
    """Arm and gripper in world axes: their known shapes at the measured joint positions."""
    tool_m: Float[np.ndarray, "3"]
    """Between the fingertips, world axes, by the measured joint positions."""


@runtime_checkable
class Segmentation(Protocol):
    """Tells the object from the gripper."""

    def keep(self, frame: Frame, calibration: Calibration, inside: Mask) -> Mask:
        """Which of the returns inside the box are the object's."""
        ...

    def fill(self, frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
        """Which pixels without return are the object's as well, given those that returned."""
        ...


@dataclass(frozen=True)
class ByShape:
    """Keeps what is not near the robot's known surface at its measured pose. Needs no colour."""

    margin_m: float = 0.002
    """For what is wrong with the calibration, the joints and the depth."""

    def keep(self, frame: Frame, calibration: Calibration, inside: Mask) -> Mask:
        """Returns farther than the margin from what the depth camera must see of the robot."""
        kept = inside.copy()
        surface_m = robot_points(frame, calibration.depth)
        points_m = frame.depth.camera.rays()[inside] * frame.depth.depth_m[inside][:, None]
        kept[inside] = np.isinf(cKDTree(surface_m).query(points_m, distance_upper_bound=self.margin_m)[0])
        return kept

    def fill(self, frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
        """As ``ByColour`` where the frame has colours, else gaps; never where the robot stands before the object."""
        beside_m, _ = _beside(frame, mask)
        robot_m = robot_depth(frame.robot, calibration.depth, frame.depth.camera)
        before = (robot_m > 0) & (robot_m < beside_m + self.margin_m)
        coloured = frame.color is not None and calibration.color is not None
        return (_alike(frame, calibration, mask) if coloured else _gaps(frame, mask)) & ~before


@dataclass(frozen=True)
class ByColour:
    """Drops what has the gripper's colour: the paper's HSV segmentation."""

    gripper: ColourRange

    def keep(self, frame: Frame, calibration: Calibration, inside: Mask) -> Mask:
        """Returns whose colour is not the gripper's; where none is known, as the nearest that has one."""
        rgb, known = align(frame, calibration)
        known &= inside
        if not known.any():
            raise ReorientError("the colour camera sees nothing of the box: expected calibrated cameras that overlap")
        is_object = known & ~self.gripper.contains(rgb)
        nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        return is_object[tuple(nearest)] & inside

    def fill(self, frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
        """What has the colour of the object that was found, not of what surrounds it."""
        return _alike(frame, calibration, mask)


@dataclass(frozen=True)
class Box:
    """The part of the world around the tool centre where the object can be."""

    half_m: tuple[float, float, float] = (0.14, 0.14, 0.14)
    """Half extents along the world's axes: an object of 65 mm radius may be held by its end."""

    def inside(self, frame: Frame, calibration: Calibration) -> Mask:
        """Which returns lie in it."""
        mask = frame.depth.valid
        points_m = se3.apply(calibration.depth.T_world_camera, frame.depth.points())
        mask[mask] = np.all(np.abs(points_m - frame.tool_m) <= self.half_m, axis=1)
        return mask


# --- from a frame to the object -------------------------------------------------------------------------------------


def isolate_object(
    frame: Frame, calibration: Calibration, segmentation: Segmentation, box: Box | None = None
) -> DepthImage:
    """The object alone, 128 x 128. Raises ReorientError where none of it is left."""
    mask = object_returns(frame, calibration, segmentation, box)
    return crop(replace(frame.depth, depth_m=np.where(mask, frame.depth.depth_m, np.float32(0))))


def object_mask(frame: Frame, calibration: Calibration, segmentation: Segmentation, box: Box | None = None) -> Mask:
    """All pixels that show the object, returned by the sensor or not. Raises ReorientError where none did."""
    returned = object_returns(frame, calibration, segmentation, box)
    return returned | segmentation.fill(frame, calibration, returned)


def object_returns(frame: Frame, calibration: Calibration, segmentation: Segmentation, box: Box | None = None) -> Mask:
    """The returns that are the object's. Raises ReorientError where there are none."""
    inside = (box or Box()).inside(frame, calibration)
    if not inside.any():
        raise ReorientError(
            "no returns in the box around the gripper: expected the gripper in view and the calibration of this cell"
        )
    rows, columns = _extent(inside)  # the rest of the image can wait
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
    return mask


def crop(image: DepthImage, least_px: int = CROP_PX, size_px: int = SIZE_PX) -> DepthImage:
    """A square around the returns, of the paper's size unless they need more, resized by nearest neighbour."""
    rows, columns = _extent(image.valid)
    side = max(least_px, int(_MARGIN * max(rows.stop - rows.start, columns.stop - columns.start)) + 2)
    left, top = ((line.start + line.stop - side) // 2 for line in (columns, rows))
    return image.cropped(left, top, side, side).resized(size_px, size_px)


def align(frame: Frame, calibration: Calibration) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """The colour at every return, and where it is known: in the colour camera's view, and behind nothing there."""
    if frame.color is None or calibration.color is None:
        raise ReorientError("no colour camera: expected one in the calibration and in the frame, to tell colours")
    camera = frame.color.camera
    rgb = ndimage.gaussian_filter(frame.color.rgb, (_BLUR_PX, _BLUR_PX, 0))  # dark pixels have no hue but their noise
    points_m = se3.apply(calibration.color.T_camera_world @ calibration.depth.T_world_camera, frame.depth.points())
    uv_px = camera.project(points_m)
    nearest_m = splat(uv_px, points_m[:, 2], rgb.shape[:2])
    nearest_m[nearest_m == 0] = np.inf
    columns, rows = uv_px.T
    with np.errstate(invalid="ignore"):
        seen = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    columns, rows = (np.where(seen, line, 0).astype(int) for line in (columns, rows))
    nearest_m = ndimage.minimum_filter(nearest_m, 3)  # returns may lie sparser than the colour camera's pixels
    seen &= points_m[:, 2] < nearest_m[rows, columns] + _HIDDEN_M
    aligned, known = np.zeros((*frame.depth.depth_m.shape, 3), np.uint8), frame.depth.valid
    aligned[frame.depth.valid], known[known] = rgb[rows, columns], seen
    return aligned, known


# --- the robot, known beforehand ------------------------------------------------------------------------------------


def learn_gripper_colour(empty: Frame, calibration: Calibration, box: Box | None = None) -> ColourRange:
    """The gripper's colours, from one frame of the empty gripper."""
    rgb, known = align(empty, calibration)
    return ColourRange.learned(rgb[known & (box or Box()).inside(empty, calibration)])


def robot_points(frame: Frame, mounted: MountedCamera) -> Float[np.ndarray, "n 3"]:
    """What the depth camera must see of the robot, in camera axes; nothing where the robot is out of its view."""
    depth_m = robot_depth(frame.robot, mounted, frame.depth.camera)
    return frame.depth.camera.rays()[depth_m > 0] * depth_m[depth_m > 0][:, None]


def robot_depth(robot: trimesh.Trimesh, mounted: MountedCamera, camera: Camera) -> Float[np.ndarray, "h w"]:
    """Exact depth of the robot alone, 0 elsewhere; ``camera``: the mounted one or a window of its image."""
    T = mounted.T_camera_world
    return Renderer(robot).depth(camera, T[:3, :3], Placement(1.0, se3.apply(T, robot.bounds.mean(axis=0))))


# --- where the sensor returned nothing ------------------------------------------------------------------------------


def _alike(frame: Frame, calibration: Calibration, mask: Mask) -> Mask:
    """Nearby pixels without return of the object's colour, its own and no other's; gaps where no colour is known.

    To find a pixel in the colour image it is taken to be as deep as the object beside it.
    """
    beside_m, distance_px = _beside(frame, mask)
    missing = ~frame.depth.valid & (distance_px <= _NEARBY_M * _px_per_m(frame, mask))
    supposed_m = np.where(missing, beside_m, frame.depth.depth_m)
    rgb, known = align(replace(frame, depth=replace(frame.depth, depth_m=supposed_m)), calibration)
    others = known & frame.depth.valid & ~mask
    looks = ColourTable.learned(rgb[mask & known], rgb[others]).contains(rgb)
    found = missing & np.where(known, looks, _gaps(frame, mask))
    labels, _ = ndimage.label(found | mask, np.ones((3, 3)))
    return found & np.isin(labels, np.unique(labels[mask]))


def _gaps(frame: Frame, mask: Mask) -> Mask:
    """Pixels without return that a morphological closing by a disc adds to the object."""
    reach_px = _GAP_M * _px_per_m(frame, mask)
    near = _beside(frame, mask)[1] <= reach_px
    if near.all():  # then nothing bounds the disc
        return ~frame.depth.valid
    return (ndimage.distance_transform_edt(near) > reach_px) & ~frame.depth.valid


def _beside(frame: Frame, mask: Mask) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """For each pixel the depth of the object's nearest return, and how many pixels away that is."""
    distance_px, nearest = ndimage.distance_transform_edt(~mask, return_indices=True)
    return frame.depth.depth_m[tuple(nearest)], distance_px


def _px_per_m(frame: Frame, mask: Mask) -> float:
    """How large a metre looks at the object."""
    return frame.depth.camera.fx / float(np.median(frame.depth.depth_m[mask]))


def _extent(mask: Mask) -> tuple[slice, slice]:
    """The rows and the columns that hold all of a mask."""
    rows, columns = (np.nonzero(mask.any(axis=axis))[0] for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _without_specks(mask: Mask) -> Mask:
    """Without the parts that are far smaller than the largest."""
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    if count == 0:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return (sizes >= _SPECK * sizes.max())[labels]
