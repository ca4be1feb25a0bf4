"""Tool poses taught relative to the goal object, for where the object is now; their files.

The object moved from the goal pose to its present one by inv(T_goal_current), in camera axes. The same motion in base
axes takes every taught pose along: T_base_camera inv(T_goal_current) inv(T_base_camera) T_base_tool.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.imaging.depth_image import MILLIMETRES_ABOVE
from reorient.imaging.documents import existing
from reorient.runs.files import replacing
from reorient.se3 import Transform

COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
_EXPECTED = f"expected rows {','.join(COLUMNS)} (metres; other orders with a header), or of 4 x 4 matrices"


@dataclass(frozen=True, eq=False)
class Transferred:
    """Tool poses for the present pose of the object."""

    T_base_tool: Float[np.ndarray, "n 4 4"]
    """In the order of the taught ones; base axes, metres."""
    covariance: Float[np.ndarray, "n 6 6"] | None
    """Of the rotation vector d (rad) and the shift s (m), base axes: the true pose is exp(d) R, p + s, if the estimate
    is near the truth. It is that of the estimate alone, without the errors of calibration and arm. None if unknown."""

    @property
    def position_std_m(self) -> Float[np.ndarray, " n"] | None:
        """Root mean square distance of each position from the true one."""
        return None if self.covariance is None else np.sqrt(np.trace(self.covariance[:, 3:, 3:], axis1=1, axis2=2))

    @property
    def rotation_std_rad(self) -> Float[np.ndarray, " n"] | None:
        """Root mean square angle of each orientation to the true one."""
        return None if self.covariance is None else np.sqrt(np.trace(self.covariance[:, :3, :3], axis1=1, axis2=2))


def transfer(
    estimate: RotationEstimate, T_base_camera: Transform, T_base_tool: Sequence[Transform] | np.ndarray
) -> Transferred:
    """The tool poses that are to the object now as the taught ones were to it in the goal pose.

    ``estimate``: of the motion from the present image to the goal image. ``T_base_camera``: the fixed camera's pose.
    ``T_base_tool``: one pose (4, 4) or several (n, 4, 4), taught while the object was in the goal pose, base axes,
    metres. The result has as many. Raises ReorientError for what is no rigid transform in metres.
    """
    taught = np.asarray(T_base_tool, float)
    taught = taught[None] if taught.ndim == 2 else taught
    for name, poses in (("T_base_camera", np.asarray(T_base_camera, float)[None]), ("T_base_tool", taught)):
        _check_poses(name, poses)
    T_camera_base = se3.inverse(T_base_camera)
    T_now_goal = T_base_camera @ se3.inverse(estimate.T_goal_current) @ T_camera_base  # of the object, base axes
    if estimate.motion_covariance is None:
        return Transferred(T_now_goal @ taught, None)
    R = -(T_now_goal @ T_base_camera)[:3, :3]  # an error of the motion to the goal is the opposite one from it
    points_m = se3.apply(T_camera_base, taught[:, :3, 3])
    J = np.zeros((len(taught), 6, 6))
    J[:, :3, :3] = J[:, 3:, 3:] = R
    J[:, 3:, :3] = -R @ _cross(points_m)
    return Transferred(T_now_goal @ taught, J @ estimate.motion_covariance @ np.swapaxes(J, 1, 2))


def read_tool_poses(path: str | Path) -> Float[np.ndarray, "n 4 4"]:
    """Poses from a CSV file: a row x,y,z,qw,qx,qy,qz each (other orders with a header), or 4 x 4 matrices.

    A matrix is one row of 12 or 16 numbers, or four rows of four. Metres. Raises ReorientError for anything else.
    """
    path = existing(path, "file of tool poses")
    lines = [line.partition("#")[0].replace(",", " ").replace(";", " ").split() for line in _text(path).splitlines()]
    rows = [(number, words) for number, words in enumerate(lines, 1) if words]
    try:
        header = None
        if rows and all(word.strip('"') in COLUMNS for word in rows[0][1]):
            header = [word.strip('"') for word in rows.pop(0)[1]]
        poses = _poses(np.array([_numbers(number, words) for number, words in rows]), header)
        _check_poses("a pose", poses)
        return poses
    except ValueError as error:  # also of rows of different lengths
        reason = "rows of different lengths" if "inhomogeneous" in str(error) else str(error)
        raise ReorientError(f"tool poses {str(path)!r}: {reason}; {_EXPECTED}") from error


def write_tool_poses(path: str | Path, T_base_tool: Float[np.ndarray, "n 4 4"]) -> None:
    """Write poses as CSV with the header x,y,z,qw,qx,qy,qz; metres."""
    with replacing(path) as temporary:
        temporary.write_text(tool_poses_text(T_base_tool), encoding="utf-8")


def tool_poses_text(T_base_tool: Float[np.ndarray, "n 4 4"]) -> str:
    """The text of such a file."""
    quat_wxyz = so3.quat_from_matrix(T_base_tool[:, :3, :3])
    rows = np.concatenate([T_base_tool[:, :3, 3], quat_wxyz], axis=1)
    lines = [",".join(COLUMNS), *(",".join(f"{x:.9f}" for x in row) for row in rows)]
    return "".join(f"{line}\n" for line in lines)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8-sig", errors="replace")


def _numbers(number: int, words: Sequence[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise ValueError(f"line {number} has {' '.join(words)[:60]!r}") from error


def _poses(rows: np.ndarray, header: Sequence[str] | None) -> Float[np.ndarray, "n 4 4"]:
    if rows.ndim != 2:
        raise ValueError("no poses")
    count, width = rows.shape
    if width == len(COLUMNS) and (header is None or sorted(header) == sorted(COLUMNS)):
        if header is not None:
            rows = rows[:, [header.index(name) for name in COLUMNS]]
        if not np.allclose(np.linalg.norm(rows[:, 3:], axis=1), 1, atol=0.01):
            raise ValueError("a quaternion is not of length 1")
        R = so3.matrix_from_quat(so3.normalize(rows[:, 3:]))
        return np.stack([se3.transform(R[i], rows[i, :3]) for i in range(count)])
    if header is None and width in (12, 16):
        poses = np.tile(np.eye(4), (count, 1, 1))
        poses[:, : width // 4] = rows.reshape(count, width // 4, 4)
        return poses
    if header is None and width == 4 and count % 4 == 0:
        return rows.reshape(-1, 4, 4)
    raise ValueError(f"{count} rows of {width} numbers")


def _check_poses(name: str, poses: np.ndarray) -> None:
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not np.all(np.isfinite(poses)):
        raise ReorientError(f"{name} of shape {poses.shape}: expected finite (4, 4) transforms")
    for T in poses:
        if not so3.is_rotation(T[:3, :3], 1e-3) or not np.allclose(T[3], [0, 0, 0, 1]):
            raise ReorientError(f"{name} is no rigid transform: expected (4, 4), a rotation and metres")
        if np.linalg.norm(T[:3, 3]) > MILLIMETRES_ABOVE:
            raise ReorientError(
                f"{name} is {np.linalg.norm(T[:3, 3]):.0f} from the base: this looks like millimetres, expected metres "
                "(times 0.001)"
            )


def _cross(v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """The matrices of the cross products with v from the left."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
