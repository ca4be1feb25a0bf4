"""The calibration of a robot with a fixed camera: the camera's pose and the held object's place; its file.

As JSON: ``{"T_base_camera": [4 rows], "p_tool_object_m": [x, y, z], ...}``, metres.
"""

import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError, check_range, reason_of
from reorient.imaging.depth_image import MILLIMETRES_ABOVE
from reorient.runs.files import replacing
from reorient.se3 import Transform


@dataclass(frozen=True, eq=False)
class RobotCalibration:
    """The camera's pose in the robot's base axes, and the object's place in the tool's.

    Raises ReorientError where the pose is no rigid transform and where a length is no finite number of metres.
    """

    T_base_camera: Transform
    """From camera axes (x right, y down, z forward) to base axes, metres."""
    p_tool_object_m: Float[np.ndarray, "3"]
    """The centre of the held object in tool axes: the point that rotations leave in its place."""
    residual_deg: float | None = None
    """RMS angle between the rotations of the object by the arm and by the camera; None where not measured here."""
    rotation_se_deg: float | None = None
    """Standard error of the camera's rotation."""
    pivot_se_m: float | None = None
    """Standard error of the rotation centre in camera axes."""
    motions: int = 0
    """Number of motions that it was computed from."""
    motions_tried: int = 0
    """Number of motions that were estimated, those that do not agree included."""

    def __post_init__(self) -> None:
        T, p_m = np.asarray(self.T_base_camera, float), np.asarray(self.p_tool_object_m, float)
        if T.shape != (4, 4) or not so3.is_rotation(T[:3, :3], 1e-3) or not np.allclose(T[3], [0, 0, 0, 1]):
            raise ReorientError("T_base_camera is no rigid transform: expected 4 x 4, a rotation and metres")
        for name, vector_m in (("T_base_camera", T[:3, 3]), ("p_tool_object_m", p_m)):
            if vector_m.shape != (3,) or not np.all(np.isfinite(vector_m)):
                raise ReorientError(f"{name}: expected three finite metres, not {vector_m.tolist()}")
            if np.linalg.norm(vector_m) > MILLIMETRES_ABOVE:
                raise ReorientError(
                    f"{name}: {np.linalg.norm(vector_m):.0f} m looks like millimetres, expected metres (times 0.001)"
                )
        check_range(self, "residual_deg", "rotation_se_deg", "pivot_se_m")
        u, _, vt = np.linalg.svd(T[:3, :3])
        object.__setattr__(self, "T_base_camera", se3.transform(u @ vt, T[:3, 3]))
        object.__setattr__(self, "p_tool_object_m", p_m)

    def pivot_m(self, T_base_tool: Transform) -> Float[np.ndarray, "3"]:
        """The rotation centre in camera axes, for a pose of the tool."""
        return se3.apply(se3.inverse(self.T_base_camera) @ T_base_tool, self.p_tool_object_m)


def read_robot_calibration(path: str | Path) -> RobotCalibration:
    """Read a file of ``write_robot_calibration``. Raises ReorientError, naming the missing or invalid entry."""
    path = Path(path)
    if not os.path.isfile(path):
        raise ReorientError(f"no calibration file {str(path)!r}: expected that of `reorient calibrate`")
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig", errors="replace"))
        known = {field.name for field in fields(RobotCalibration)}
        arrays = {name: np.array(data[name], float) for name in ("T_base_camera", "p_tool_object_m")}
        return RobotCalibration(**{name: value for name, value in data.items() if name in known} | arrays)
    except Exception as error:
        raise ReorientError(
            f"broken calibration file {str(path)!r} ({reason_of(error)}): expected T_base_camera (4 x 4) and "
            "p_tool_object_m"
        ) from error


def write_robot_calibration(path: str | Path, calibration: RobotCalibration) -> None:
    """Write a calibration as JSON."""
    data = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in asdict(calibration).items()
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
