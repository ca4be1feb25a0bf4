"""Frames of a cell: depth, colour and the robot's known shape; the colour at every return.

Nothing here depends on whether the cell is real or simulated.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage

from reorient import se3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.imaging.splatting import splat
from reorient.perception.calibration import Calibration, MountedCamera
from reorient.world.rendering import Placement, Renderer

_BLUR_PX = 1.0  # standard deviation of the filter that smooths colours
_HIDDEN_M = 0.01  # a point this much behind the nearest one of its pixel is hidden from the colour camera


@dataclass(frozen=True, eq=False)
class ColorImage:
    """An image of the colour camera."""

    rgb: UInt8[np.ndarray, "height width 3"]
    """Red, green, blue in [0, 255]."""
    camera: Camera


@dataclass(frozen=True, eq=False)
class Frame:
    """Measurements of the cameras and encoders of a cell at one moment. Images may be windows of the sensors."""

    depth: DepthImage
    """Depth of the whole scene."""
    color: ColorImage | None
    """None without a colour camera."""
    robot: trimesh.Trimesh
    """Arm and gripper in world axes, metres: known shapes at the measured joint positions."""
    tool_m: Float[np.ndarray, "3"]
    """Tool centre between the fingertips, world axes, from the measured joint positions."""


def align(frame: Frame, calibration: Calibration) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """The colour at every return, and whether it is known: in the colour camera's view and not hidden from it.

    Raises ReorientError without a colour camera.
    """
    if frame.color is None or calibration.color is None:
        raise ReorientError(
            "no colour camera: expected one in the calibration and in the frame, for segmentation by colour"
        )
    camera = frame.color.camera
    rgb = ndimage.gaussian_filter(frame.color.rgb, (_BLUR_PX, _BLUR_PX, 0))  # the hue of dark pixels is noise
    points_m = se3.apply(calibration.color.T_camera_world @ calibration.depth.T_world_camera, frame.depth.points())
    uv_px = camera.project(points_m)
    nearest_m = splat(uv_px, points_m[:, 2], rgb.shape[:2])
    nearest_m[nearest_m == 0] = np.inf
    columns, rows = uv_px.T
    with np.errstate(invalid="ignore"):
        seen = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    columns, rows = (np.where(seen, line, 0).astype(int) for line in (columns, rows))
    nearest_m = ndimage.minimum_filter(nearest_m, 3)  # returns can be sparser than the pixels of the colour camera
    seen &= points_m[:, 2] < nearest_m[rows, columns] + _HIDDEN_M
    aligned, known = np.zeros((*frame.depth.depth_m.shape, 3), np.uint8), frame.depth.valid
    aligned[frame.depth.valid], known[known] = rgb[rows, columns], seen
    return aligned, known


def robot_points(frame: Frame, mounted: MountedCamera) -> Float[np.ndarray, "n 3"]:
    """The robot's surface visible to the depth camera, camera axes, metres; (0, 3) if the robot is out of view."""
    depth_m = robot_depth(frame.robot, mounted, frame.depth.camera)
    return np.asarray(frame.depth.camera.rays()[depth_m > 0] * depth_m[depth_m > 0][:, None])


def robot_depth(robot: trimesh.Trimesh, mounted: MountedCamera, camera: Camera) -> Float[np.ndarray, "h w"]:
    """Exact depth of the robot alone, metres, 0 elsewhere; ``camera``: the mounted one or a window of its image."""
    T = mounted.T_camera_world
    return Renderer(robot).depth(camera, T[:3, :3], Placement(1.0, se3.apply(T, robot.bounds.mean(axis=0))))
