"""What an aligned pair says: warp one image's points into the other's view and compare depths. No mesh needed.

A point of one view, moved by a hypothesis into the other camera, is one of four things. It *fits* the surface seen
there; it would stand *in front* of it, where the camera saw through to something farther; it falls *outside* the
silhouette, where the camera saw nothing of the object; or it lies *behind* the surface, where it may well be hidden.
In front and outside speak against the hypothesis, behind says nothing.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from reorient.depth import DepthImage


@dataclass(frozen=True)
class Evidence:
    """Both ways together: shares of the points of both images, and residuals."""

    fit: float
    """Share of points that land on the other surface, within the tolerance."""
    in_front: float
    """Share that the other camera should have seen, but it saw something farther."""
    outside: float
    """Share that falls where the other camera saw nothing of the object."""
    behind: float
    """Share hidden behind the other surface."""
    residual_m: float
    """Root mean square depth difference of the points that fit; NaN if none does."""
    converged: bool = True
    """Whether the registration met its own stopping rule."""
    iterations: int = 0
    """Iterations of the registration that led to the answer."""

    @property
    def agreement(self) -> float:
        """One figure to rank hypotheses by: fit, less what contradicts."""
        return self.fit - self.in_front - self.outside


class View:
    """One depth image made ready to be compared with many moved point sets."""

    def __init__(self, image: DepthImage, points: int = 400) -> None:
        self.camera = image.camera
        valid = image.valid
        all_points = image.points()
        chosen = np.linspace(0, len(all_points) - 1, min(points, len(all_points))).astype(int)
        self.points_m = all_points[chosen].astype(np.float32)
        """(n, 3) returns spread evenly over the image, camera axes."""
        distance, nearest = ndimage.distance_transform_edt(~valid, return_indices=True)
        self._gap_px = distance.astype(np.float32)
        self._depth_m = image.depth_m[tuple(nearest)]  # holes take the nearest return's depth

    def compare(
        self, points_m: Float[np.ndarray, "*batch 3"], gap_px: float = 2.0
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch"]]:
        """For points in this camera's axes: their depth minus the surface's, and by how many pixels beyond ``gap_px``
        they miss it (0: they land on it; small holes count as surface)."""
        camera = self.camera
        z = np.maximum(points_m[..., 2], 1e-6)
        u = points_m[..., 0] / z * np.float32(camera.fx) + np.float32(camera.cx)
        v = points_m[..., 1] / z * np.float32(camera.fy) + np.float32(camera.cy)
        inside_u, inside_v = np.clip(u, 0, camera.width - 1), np.clip(v, 0, camera.height - 1)
        index = inside_v.astype(np.int32) * camera.width + inside_u.astype(np.int32)
        beyond = np.maximum(np.abs(u - inside_u) + np.abs(v - inside_v) - 1, 0)
        missed = np.maximum(self._gap_px.ravel()[index] + beyond - gap_px, 0)
        return points_m[..., 2] - self._depth_m.ravel()[index], missed


def agreement(
    current: View,
    goal: View,
    R_goal_current: Float[np.ndarray, "k 3 3"],
    t_goal_current_m: Float[np.ndarray, "k 3"],
    tolerance_m: float,
) -> Float[np.ndarray, " k"]:
    """Score in [-1, 1] of many hypotheses at once: share that fits, less the shares in front and outside."""
    R = R_goal_current.astype(np.float32)
    t = t_goal_current_m.astype(np.float32)
    forward = current.points_m @ np.swapaxes(R, 1, 2) + t[:, None]
    backward = (goal.points_m - t[:, None]) @ R
    score = np.zeros(len(R), np.float32)
    for view, points_m in ((goal, forward), (current, backward)):
        dz, missed = view.compare(points_m)
        on = missed == 0
        fits = on & (np.abs(dz) <= tolerance_m)
        against = ~on | (dz < -tolerance_m)
        score += (fits.mean(axis=1, dtype=np.float32) - against.mean(axis=1, dtype=np.float32)) / 2
    return score


def weigh(
    current: View,
    goal: View,
    R_goal_current: Float[np.ndarray, "3 3"],
    t_goal_current_m: Float[np.ndarray, "3"],
    tolerance_m: float,
    converged: bool = True,
    iterations: int = 0,
) -> Evidence:
    """The evidence for one hypothesis."""
    forward = current.points_m @ R_goal_current.T + t_goal_current_m
    backward = (goal.points_m - t_goal_current_m) @ R_goal_current
    dz, missed = (np.concatenate(x) for x in zip(goal.compare(forward), current.compare(backward), strict=True))
    on = missed == 0
    fits = on & (np.abs(dz) <= tolerance_m)
    return Evidence(
        fit=float(fits.mean()),
        in_front=float((on & (dz < -tolerance_m)).mean()),
        outside=float((~on).mean()),
        behind=float((on & (dz > tolerance_m)).mean()),
        residual_m=float(np.sqrt(np.mean(dz[fits] ** 2))) if fits.any() else float("nan"),
        converged=converged,
        iterations=iterations,
    )
