"""A box in a frame, from a rectangle that is dragged over it in a 3D view."""

from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.imaging import DepthImage


def box_in_frame(
    raw: DepthImage, eye: Any, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
) -> tuple[int, int, int, int] | None:
    """The box, in pixels of the frame, around the returns that a browser shows within a rectangle; None: there are
    none. ``eye``: wxyz, position, fov and aspect of the browser's camera; ``low``, ``high``: corners, from 0 to 1."""
    R_world_eye = so3.matrix_from_quat(so3.normalize(np.asarray(eye.wxyz, float)))
    x, y, z = ((raw.points() - np.asarray(eye.position)) @ R_world_eye).T
    half = np.tan(eye.fov / 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        screen = np.stack([x / z / (half * eye.aspect), y / z / half], axis=-1) / 2 + 0.5
    inside = (z > 0) & np.all((screen >= low) & (screen <= high), axis=-1)
    if not inside.any():
        return None
    rows, columns = (each[inside] for each in np.nonzero(raw.valid))
    left, top = int(columns.min()), int(rows.min())
    return left, top, int(columns.max()) + 1 - left, int(rows.max()) + 1 - top
