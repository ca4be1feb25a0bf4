"""What an aligned pair says: warp one image's points into the other's view and compare depths. No mesh needed.

A point of one view, moved by a hypothesis into the other camera, is one of four things. It *fits* the surface seen
there; it would stand *in front* of it, where the camera saw through to something farther; it falls *outside* the
silhouette, where the camera saw nothing of the object; or it lies *behind* the surface, where it may well be hidden.
In front and outside speak against the hypothesis, behind says nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from reorient.imaging import DepthImage

GAP_PX = 2.0  # holes and gaps no wider either way count as surface
NOWHERE_M = np.float32(1e3)  # the surface's depth where there is none: whatever comes before it contradicts
_PAD = 4  # pixels around the image, more than the gap
_AT_ONCE = 30_000  # points moved in one go: what they need stays in the cache

# glibc returns freed blocks above a threshold to the system, and touching them anew costs as much as the arithmetic
# here. Freeing one block just below 32 MB, never touched, raises the threshold for good; elsewhere it does nothing.
np.empty(30_000_000, np.uint8)


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
        camera = image.camera
        self.all_points_m = image.points().astype(np.float32)
        """(m, 3) all returns, row by row, camera axes."""
        self.points_m = self.all_points_m[evenly(len(self.all_points_m), points)]
        """(n, 3) of them, spread evenly over the image."""
        valid = np.pad(image.valid, _PAD)
        distance, nearest = ndimage.distance_transform_edt(~valid, return_indices=True)
        order = np.zeros(valid.shape, int)
        order[valid] = np.arange(len(self.all_points_m))
        # flat tables over the padded image; a point beyond it meets the outermost pixel
        self._height, self._width = valid.shape
        self._nearest = order[tuple(nearest)].ravel()  # the nearest return of each pixel
        self._gap_px = distance.astype(np.float32).ravel()
        self._depth_m = self.all_points_m[self._nearest, 2]  # holes take the nearest return's depth
        self._surface_m = np.where(self._gap_px <= GAP_PX, self._depth_m, NOWHERE_M)
        self._focal = np.float32(camera.fx), np.float32(camera.fy)
        self._centre = np.float32(camera.cx + _PAD), np.float32(camera.cy + _PAD)
        self._samples: dict[int, Float[np.ndarray, "3 n"]] = {}

    def sample(self, points: int) -> Float[np.ndarray, "3 n"]:
        """At most so many returns, spread evenly, as columns."""
        if points not in self._samples:
            chosen = self.all_points_m[evenly(len(self.all_points_m), points)]
            self._samples[points] = np.ascontiguousarray(chosen.T)
        return self._samples[points]

    def pixels(
        self, x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"], z: Float[np.ndarray, "*batch"]
    ) -> Int[np.ndarray, "*batch"]:
        """Where points in this camera's axes fall: places in the flat tables."""
        inverse = 1 / np.maximum(z, np.float32(1e-6))
        u, v = x * inverse, y * inverse
        u *= self._focal[0]
        u += self._centre[0]
        v *= self._focal[1]
        v += self._centre[1]
        np.clip(u, 0, self._width - 1, out=u)
        np.clip(v, 0, self._height - 1, out=v)
        place = v.astype(np.int32)
        place *= self._width
        place += u.astype(np.int32)
        return place

    def surface_m(self, place: Int[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """The surface's depth at places; ``NOWHERE_M`` outside the silhouette."""
        return self._surface_m.take(place)

    def depth_m(self, place: Int[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """The depth of the nearest return at places."""
        return self._depth_m.take(place)

    def gap_px(self, place: Int[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """By how many pixels beyond ``GAP_PX`` places miss the object; 0 on it."""
        return np.maximum(self._gap_px.take(place) - GAP_PX, 0)

    def compare(
        self, points_m: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch"]]:
        """For points in this camera's axes: their depth minus the surface's, and by how many pixels beyond ``GAP_PX``
        they miss it (0: they land on it; small holes count as surface)."""
        place = self.pixels(*np.moveaxis(np.asarray(points_m, np.float32), -1, 0))
        return points_m[..., 2] - self.depth_m(place), self.gap_px(place)


def size_m(points: Float[np.ndarray, "n 3"]) -> float:
    """Diagonal of the box around a cloud, but for a few stray points far from the rest."""
    low, high = np.percentile(points, [1, 99], axis=0)
    return min(float(np.linalg.norm(np.ptp(points, axis=0))), 1.5 * float(np.linalg.norm(high - low)))


def evenly(n: int, most: int) -> Int[np.ndarray, " k"]:
    """At most so many of n places, at equal steps."""
    return np.linspace(0, n - 1, min(most, n)).astype(int)


def batches(k: int, points: int) -> Iterator[slice]:
    """Slices of k hypotheses that each move so many points, about equally long."""
    step = max(ceil(k / max(ceil(k * points / _AT_ONCE), 1)), 1)
    return (slice(begin, begin + step) for begin in range(0, k, step))


def moved(
    R: Float[np.ndarray, "k 3 3"], t_m: Float[np.ndarray, "k 3"], points_m: Float[np.ndarray, "3 n"]
) -> Float[np.ndarray, "k 3 n"]:
    """Points (as columns) under many motions, in one matrix product."""
    x = (R.reshape(-1, 3) @ points_m).reshape(len(R), 3, -1)
    x += t_m[:, :, None]
    return x


def agreement(
    current: View,
    goal: View,
    R_goal_current: Float[np.ndarray, "k 3 3"],
    t_goal_current_m: Float[np.ndarray, "k 3"],
    tolerance_m: float,
    points: int | None = None,
) -> Float[np.ndarray, " k"]:
    """Score in [-1, 1] of many hypotheses at once: share that fits, less the shares in front and outside.

    ``points``: of each image, the view's own where None.
    """
    forward, backward = (
        np.ascontiguousarray(view.points_m.T) if points is None else view.sample(points) for view in (current, goal)
    )
    tolerance = np.float32(tolerance_m)
    score = np.zeros(len(R_goal_current), np.float32)
    for batch in batches(len(score), max(forward.shape[1], backward.shape[1])):
        R, t = R_goal_current[batch].astype(np.float32), t_goal_current_m[batch].astype(np.float32)
        R_back = np.ascontiguousarray(np.swapaxes(R, 1, 2))
        t_back = -(R_back @ t[:, :, None])[:, :, 0]
        for view, x in ((goal, moved(R, t, forward)), (current, moved(R_back, t_back, backward))):
            beyond = x[:, 2] - view.surface_m(view.pixels(x[:, 0], x[:, 1], x[:, 2]))
            each = np.full(x.shape[2], 0.5 / x.shape[2], np.float32)  # a product with ones counts fastest
            score[batch] += (beyond <= tolerance).astype(np.float32) @ each  # what fits, and what contradicts
            score[batch] -= (beyond < -tolerance).astype(np.float32) @ (2 * each)  # which counts -1, not 1
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
