"""Correction of the calibration by one frame of the empty gripper, whose shape and pose are known."""

from dataclasses import replace

import numpy as np
import small_gicp
import trimesh
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.perception.calibration import Calibration, MountedCamera
from reorient.perception.frame import ColorImage, Frame, robot_depth, robot_points
from reorient.perception.segmentation import Box

_FEWEST = 200  # returns from the gripper, or pixels of its outline, that a correction needs
_LARGEST_M = 0.012  # largest error of the depth camera's calibration that is corrected
_LARGEST_PX = 16  # largest displacement of the gripper in the colour image that is corrected
_EDGE_M = 0.02  # smallest step in depth at an outline; grazing sides have smaller steps
_BLUR_PX = 1.0  # standard deviation of the filter that detects edges


def corrected_calibration(calibration: Calibration, empty: Frame, reach_m: float = 0.2) -> Calibration:
    """The calibration corrected by aligning one frame of the empty gripper with the gripper's known shape.

    The depth camera: registration of its returns (GICP). The colour camera, if there is one: rotated so that the
    gripper's outline coincides with edges of the image. ``reach_m``: half extent of the compared box around the tool
    centre. Raises ReorientError if fewer than 200 returns are near the gripper.
    """
    inside = Box((reach_m,) * 3).inside(empty, calibration)
    seen_m = empty.depth.camera.rays()[inside] * empty.depth.depth_m[inside][:, None]
    surface_m = robot_points(empty, calibration.depth)
    distance_m = cKDTree(surface_m).query(seen_m, distance_upper_bound=_LARGEST_M)[0]
    seen_m = seen_m[np.isfinite(distance_m)]
    if len(seen_m) < _FEWEST:
        raise ReorientError(
            f"{len(seen_m)} returns where the gripper should be: expected at least {_FEWEST}, from a calibration good "
            "to about 1 cm and an empty gripper in view"
        )
    T = np.eye(4)
    for gate_m in (_LARGEST_M, _LARGEST_M / 3):
        found = small_gicp.align(
            surface_m,
            seen_m,
            T,
            registration_type="GICP",
            downsampling_resolution=0.002,
            max_correspondence_distance=gate_m,
            num_threads=1,
        )
        T = found.T_target_source
    depth = replace(calibration.depth, T_world_camera=calibration.depth.T_world_camera @ T)
    if calibration.color is None or empty.color is None:
        return replace(calibration, depth=depth)
    return Calibration(depth, _rotated_to_outline(calibration.color, empty.color, empty.robot))


def _rotated_to_outline(mounted: MountedCamera, color: ColorImage, robot: trimesh.Trimesh) -> MountedCamera:
    """The colour camera rotated, without roll, so that the robot's outline coincides with the strongest edges.

    Unchanged if fewer than 200 pixels of the outline are in view.
    """
    camera = color.camera
    rows, columns = np.nonzero(_outline(robot_depth(robot, mounted, camera)))
    if len(rows) < _FEWEST:
        return mounted
    edges = sum(ndimage.gaussian_gradient_magnitude(color.rgb[..., i].astype(float), _BLUR_PX) for i in range(3))
    padded = np.pad(edges, _LARGEST_PX)
    shifts = np.arange(2 * _LARGEST_PX + 1)
    under = [[padded[rows + down, columns + right].sum() for right in shifts] for down in shifts]
    down, right = np.unravel_index(np.argmax(ndimage.gaussian_filter(under, _BLUR_PX)), np.shape(under))
    seen_x, seen_y = (right - _LARGEST_PX) / camera.fx, (down - _LARGEST_PX) / camera.fy
    R_old_new = so3.exp(np.array([seen_y, -seen_x, 0.0]))
    return replace(mounted, T_world_camera=mounted.T_world_camera @ se3.transform(R_old_new, np.zeros(3)))


def _outline(depth_m: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The pixels next to a much farther pixel or to one without depth."""
    far_m = np.where(depth_m > 0, depth_m, np.inf)
    return np.asarray((depth_m > 0) & (ndimage.maximum_filter(far_m, 3, mode="nearest") > far_m + _EDGE_M))
