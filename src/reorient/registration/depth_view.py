"""A depth image prepared for comparison with the points of many moved copies of another one. No mesh is needed.

Every pixel has a depth and a plane. On the object both are the surface's own; gaps of up to ``GAP_PX`` take the nearest
return's. Outside the silhouette the plane is the one through the camera and the nearest piece of outline: the distance
of a point from it is how far the point must move sideways to be hidden from view. So depth and silhouette residuals
have one form, ``normal @ x - offset``. An unknown pixel hides every point that falls on it, and so does all that lies
beyond the frame. Unknown pixels beside the object may show more of it: the outline goes around them, too.
"""

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from reorient.imaging import DepthImage, without_strays
from reorient.registration.normals import fit_planes

GAP_PX = 2.0  # holes and gaps no wider either way count as surface
OUTSIDE_M = np.float32(1e3)  # the surface's depth outside the silhouette, behind any point; less this where unknown,
# in front of any point. Not tuned
LARGEST_PX = 160  # an object's image larger than this is shrunk: finer pixels cost time and add nothing
MARGIN_PX = 4  # around a cropped object; not tuned
OUTLINE_PX = 1.5  # a point may lie outside the outline by this much
MEDIAN_DEVIATION = 0.6745  # median of the absolute value of a standard normal variable
_PAD = 4  # pixels around the image, more than the gap; not tuned


def evenly_spaced(n: int, most: int) -> Int[np.ndarray, " k"]:
    """Indices of at most ``most`` of n items, at equal steps."""
    return np.linspace(0, n - 1, min(most, n)).astype(int)


def _compact(image: DepthImage) -> DepthImage:
    """The image cropped to the object, without stray returns, and shrunk to ``LARGEST_PX`` where it is larger."""
    image = without_strays(image)
    rows, columns = (np.nonzero(image.valid.any(axis=axis))[0] for axis in (1, 0))
    top, left = rows[0] - MARGIN_PX, columns[0] - MARGIN_PX
    height, width = rows[-1] + 1 + MARGIN_PX - top, columns[-1] + 1 + MARGIN_PX - left
    image = image.cropped(int(left), int(top), int(width), int(height))
    scale = LARGEST_PX / max(width, height)
    return image if scale >= 1 else image.resized(max(round(width * scale), 1), max(round(height * scale), 1))


def _gap_px(
    valid: Bool[np.ndarray, "h w"], unknown: Bool[np.ndarray, "h w"], distance_px: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """The distance of each pixel from the object and from the unknown pixels that adjoin it."""
    if not unknown.any():
        return distance_px
    labels, _ = ndimage.label(valid | unknown, np.ones((3, 3)))
    adjoining = np.isin(labels, np.unique(labels[valid]))
    return np.asarray(ndimage.distance_transform_edt(~adjoining))


@dataclass(frozen=True, eq=False)
class Warped:
    """Points of another image, moved into a view's camera axes and compared with the surface there.

    Each point is one of four things: an *inlier*, within the tolerance of the surface; a *free-space violation*, where
    the camera saw through the point to something farther; a *silhouette violation*, where the camera saw nothing of the
    object; or *occluded*, behind the surface or on an unknown pixel. Violations contradict the motion, occluded points
    do not.
    """

    pixel: Int[np.ndarray, "*batch"]
    """Places in the view's flat tables."""
    difference_m: Float[np.ndarray, "*batch"]
    """Depth of each point minus the surface's; below ``-OUTSIDE_M / 2`` outside the silhouette."""

    def inlier(self, tolerance_m: float) -> Bool[np.ndarray, "*batch"]:
        """Points within the tolerance of the surface."""
        return np.asarray(np.abs(self.difference_m) <= tolerance_m)

    def violation(self, tolerance_m: float) -> Bool[np.ndarray, "*batch"]:
        """Free-space and silhouette violations together."""
        return self.difference_m < -tolerance_m

    def silhouette_violation(self) -> Bool[np.ndarray, "*batch"]:
        """Points outside the silhouette."""
        return self.difference_m < -OUTSIDE_M / 2

    def free_space_violation(self, tolerance_m: float) -> Bool[np.ndarray, "*batch"]:
        """Points in front of the surface."""
        return np.asarray(self.violation(tolerance_m) & ~self.silhouette_violation())

    def unknown(self) -> Bool[np.ndarray, "*batch"]:
        """Points on an unknown pixel or beyond the frame."""
        return self.difference_m > OUTSIDE_M / 2

    def occluded(self, tolerance_m: float) -> Bool[np.ndarray, "*batch"]:
        """Points behind the surface, or on an unknown pixel."""
        return self.difference_m > tolerance_m


class DepthView:
    """One depth image as flat tables over its pixels: depth, gap to the object, plane."""

    def __init__(self, image: DepthImage) -> None:
        image = _compact(image)
        camera = image.camera
        self.image = image
        self.points_m = image.points().astype(np.float32)
        """(m, 3) all returns, row by row, camera axes."""
        valid = np.pad(image.valid, _PAD)
        unknown = np.pad(image.unknown, _PAD, mode="edge")  # an image's margin is empty, or beyond the frame
        distance, nearest = ndimage.distance_transform_edt(~valid, return_indices=True)
        order = np.zeros(valid.shape, int)
        order[valid] = np.arange(len(self.points_m))
        # a point beyond the padded image falls on its outermost pixel
        self._height, self._width = valid.shape
        self._nearest = order[tuple(nearest)].ravel()  # the nearest return of each pixel
        self._gap_px = _gap_px(valid, unknown, distance).astype(np.float32).ravel()
        self._surface_m = np.where(self._gap_px <= GAP_PX, self.points_m[self._nearest, 2], OUTSIDE_M)
        self._surface_m[unknown.ravel()] = -OUTSIDE_M
        self._focal = np.float32(camera.fx), np.float32(camera.fy)
        self._centre = np.float32(camera.cx + _PAD), np.float32(camera.cy + _PAD)
        self._samples: dict[int, Float[np.ndarray, "3 n"]] = {}

    @cached_property
    def without_silhouette(self) -> "DepthView":
        """The view with all that is not the object unknown: no point violates its silhouette."""
        _ = self._planes  # computed once, for both
        view = copy(self)
        view._surface_m = np.where(self._gap_px <= GAP_PX, self._surface_m, -OUTSIDE_M)
        return view

    @property
    def unknown_outline(self) -> float:
        """Share of the pixels around the returns that are unknown: of an object that goes on there, perhaps."""
        image = self.image
        around = ndimage.binary_dilation(image.valid, np.ones((3, 3))) & ~image.valid
        return float(np.mean(image.unknown[around])) if around.any() else 1.0

    @cached_property
    def diameter_m(self) -> float:
        """Diagonal of the box around the returns; a few stray returns far from the rest do not count."""
        low, high = np.percentile(self.points_m, [1, 99], axis=0)
        return min(float(np.linalg.norm(np.ptp(self.points_m, axis=0))), 1.5 * float(np.linalg.norm(high - low)))

    def sample(self, points: int) -> Float[np.ndarray, "3 n"]:
        """At most so many returns, evenly spaced over the image, as columns (metres, camera axes)."""
        if points not in self._samples:
            chosen = self.points_m[evenly_spaced(len(self.points_m), points)]
            self._samples[points] = np.ascontiguousarray(chosen.T)
        return self._samples[points]

    def warp(self, points_m: Float[np.ndarray, "*batch 3 n"]) -> Warped:
        """Compare points (as columns, in this camera's axes) with the surface that they fall on."""
        pixel = self._pixels(np.asarray(points_m, np.float32))
        return Warped(pixel, points_m[..., 2, :] - self._surface_m.take(pixel))

    def outside_px(self, pixel: Int[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """By how many pixels beyond ``GAP_PX`` places miss the object; 0 on it."""
        return np.asarray(np.maximum(self._gap_px.take(pixel) - GAP_PX, 0))

    @cached_property
    def normals(self) -> Float[np.ndarray, "m 3"]:
        """Unit normals of all returns, towards the camera."""
        return self._planes[0]

    @cached_property
    def noise_m(self) -> float:
        """Depth noise as the image shows it: the deviation (by the median) of the returns from
        the planes of their neighbours; of noise that neighbours share, a part."""
        x, y, z = self.points_m.T
        nx, ny, nz, offset_m = self.planes(self._pixels(self.points_m.T))
        return float(np.median(np.abs(nx * x + ny * y + nz * z - offset_m)) / MEDIAN_DEVIATION)

    def sample_normals(self, points: int) -> Float[np.ndarray, "3 n"]:
        """The normals of ``sample(points)``."""
        return np.ascontiguousarray(self.normals[evenly_spaced(len(self.normals), points)].T)

    def planes(
        self, pixel: Int[np.ndarray, "*batch"]
    ) -> tuple[
        Float[np.ndarray, "*batch"],
        Float[np.ndarray, "*batch"],
        Float[np.ndarray, "*batch"],
        Float[np.ndarray, "*batch"],
    ]:
        """The three components of the normals, and the offsets (metres), of the planes at places."""
        _, (x, y, z), offset_m = self._planes
        return x.take(pixel), y.take(pixel), z.take(pixel), offset_m.take(pixel)

    def _pixels(self, points_m: Float[np.ndarray, "*batch 3 n"]) -> Int[np.ndarray, "*batch n"]:
        """Places in the flat tables where points fall."""
        x, y, z = points_m[..., 0, :], points_m[..., 1, :], points_m[..., 2, :]
        inverse = 1 / np.maximum(z, np.float32(1e-6))
        u, v = x * inverse, y * inverse
        u *= self._focal[0]
        u += self._centre[0]
        v *= self._focal[1]
        v += self._centre[1]
        np.clip(u, 0, self._width - 1, out=u)
        np.clip(v, 0, self._height - 1, out=v)
        pixel: np.ndarray = v.astype(np.int32)
        pixel *= self._width
        pixel += u.astype(np.int32)
        return pixel

    @cached_property
    def _planes(self) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "3 p"], Float[np.ndarray, " p"]]:
        """Normals of the returns, and normals and offsets of the planes of all pixels."""
        fitted = fit_planes(self.image)
        normals = fitted.normals.astype(np.float32)
        normal = np.ascontiguousarray(normals[self._nearest].T)
        offset_m = fitted.offsets_m.astype(np.float32)[self._nearest]
        gap = self._gap_px.reshape(self._height, self._width)
        nearest = ndimage.distance_transform_edt(gap > 0, return_distances=False, return_indices=True)
        outside = np.nonzero(self._gap_px > GAP_PX)[0]
        row, column = outside // self._width, outside % self._width
        edge_row, edge_column = nearest[0].ravel()[outside], nearest[1].ravel()[outside]
        along_u, along_v = (column - edge_column) / self._gap_px[outside], (row - edge_row) / self._gap_px[outside]
        u = (edge_column + 0.5 + OUTLINE_PX * along_u - self._centre[0]) / self._focal[0]
        v = (edge_row + 0.5 + OUTLINE_PX * along_v - self._centre[1]) / self._focal[1]
        normal[:, outside] = along_u, along_v, -(along_u * u + along_v * v)
        offset_m[outside] = 0
        return normals, normal, offset_m
