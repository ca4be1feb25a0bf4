"""Poses of the cell's cameras in the robot's base frame: a depth camera and, optionally, a colour camera.

As JSON, pixel centres at +0.5, ``color`` optional:
``{"depth": {"camera": {"width": 1032, ...}, "T_world_camera": [4 rows]}, "color": {...}}``.
"""

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import ReorientError, reason_of
from reorient.imaging import Camera
from reorient.imaging.documents import parse_json
from reorient.imaging.intrinsics import camera_from
from reorient.runs.files import replacing
from reorient.se3 import Transform


@dataclass(frozen=True, eq=False)
class MountedCamera:
    """A camera and its pose. Raises ReorientError if the pose is no rigid transform."""

    camera: Camera
    T_world_camera: Transform
    """From camera axes (x right, y down, z forward) to world axes, metres."""

    def __post_init__(self) -> None:
        T = np.asarray(self.T_world_camera)
        if T.shape != (4, 4) or not so3.is_rotation(T[:3, :3]) or not np.allclose(T[3], [0, 0, 0, 1]):
            raise ReorientError("T_world_camera is no rigid transform: expected 4 x 4, a rotation and metres")

    @property
    def T_camera_world(self) -> Transform:
        """From world axes to camera axes."""
        return se3.inverse(self.T_world_camera)


@dataclass(frozen=True, eq=False)
class Calibration:
    """The calibrated cameras of a cell."""

    depth: MountedCamera
    color: MountedCamera | None = None


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration file. Raises ReorientError, naming the missing or invalid entry."""
    path = Path(path)
    if not os.path.isfile(path):
        raise ReorientError(f"no calibration file {str(path)!r}: expected JSON with 'depth' and perhaps 'color'")
    try:
        data = parse_json(path.read_text(encoding="utf-8-sig", errors="replace"))
        color = data.get("color")
        return Calibration(_mounted(data, "depth"), None if color is None else _mounted(data, "color"))
    except json.JSONDecodeError as error:
        raise ReorientError(f"calibration file {str(path)!r} is not JSON ({reason_of(error)})") from error
    except Exception as error:
        raise ReorientError(
            f"broken calibration file {str(path)!r} ({reason_of(error)}): expected for 'depth', and perhaps 'color', "
            "a camera (width, height, fx, fy, cx, cy) and T_world_camera (4 x 4)"
        ) from error


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration file, in the format of ``read_calibration``."""
    cameras = {"depth": calibration.depth, "color": calibration.color}
    data = {
        name: {"camera": asdict(mounted.camera), "T_world_camera": mounted.T_world_camera.tolist()}
        for name, mounted in cameras.items()
        if mounted is not None
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def _mounted(data: dict[str, Any], name: str) -> MountedCamera:
    return MountedCamera(camera_from(data[name]["camera"], name), np.array(data[name]["T_world_camera"], float))
