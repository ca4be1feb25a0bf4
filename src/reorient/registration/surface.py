"""A view as a field of planes to slide points onto, and the frame in which a pair's hypotheses move.

Every pixel has one plane. On the object it is the surface's own. Outside the silhouette it is the plane through the
camera and the nearest piece of outline: a point's distance from it is how far it must move aside to be hidden from
view. So depth and silhouette residuals have one form, ``normal @ x - offset``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from reorient.imaging import DepthImage
from reorient.registration.evidence import GAP_PX, View, evenly, size_m
from reorient.registration.normals import fit_planes

LARGEST_PX = 160  # an object's picture larger than this is shrunk: finer pixels cost time and add nothing
MARGIN_PX = 4
OUTLINE_PX = 1.5  # a point may stand outside the outline by this much
PIVOT_ERROR_M = 0.007  # standard deviation along each axis of what a known pivot is good to (uniform in 1 cm)
SLACK = 0.01  # of the object's size: how far a motion may miss a pivot even so


def compact(image: DepthImage) -> DepthImage:
    """The image around the object alone, shrunk where that is large."""
    rows, columns = (np.nonzero(image.valid.any(axis=axis))[0] for axis in (1, 0))
    top, left = rows[0] - MARGIN_PX, columns[0] - MARGIN_PX
    height, width = rows[-1] + 1 + MARGIN_PX - top, columns[-1] + 1 + MARGIN_PX - left
    image = image.cropped(int(left), int(top), int(width), int(height))
    scale = LARGEST_PX / max(width, height)
    return image if scale >= 1 else image.resized(max(round(width * scale), 1), max(round(height * scale), 1))


class Surface(View):
    """A view whose every pixel has a plane."""

    def __init__(self, image: DepthImage) -> None:
        image = compact(image)
        super().__init__(image)
        planes = fit_planes(image)
        self.normals = planes.normals.astype(np.float32)
        """(m, 3) of all returns, towards the camera."""
        self._normal = np.ascontiguousarray(self.normals[self._nearest].T)
        self._offset_m = planes.offsets_m.astype(np.float32)[self._nearest]
        self._set_outline()

    def _set_outline(self) -> None:
        """The planes of the pixels outside the silhouette."""
        gap = self._gap_px.reshape(self._height, self._width)
        nearest = ndimage.distance_transform_edt(gap > 0, return_distances=False, return_indices=True)
        outside = np.nonzero(self._gap_px > GAP_PX)[0]
        row, column = outside // self._width, outside % self._width
        edge_row, edge_column = nearest[0].ravel()[outside], nearest[1].ravel()[outside]
        along_u, along_v = (column - edge_column) / self._gap_px[outside], (row - edge_row) / self._gap_px[outside]
        u = (edge_column + 0.5 + OUTLINE_PX * along_u - self._centre[0]) / self._focal[0]
        v = (edge_row + 0.5 + OUTLINE_PX * along_v - self._centre[1]) / self._focal[1]
        self._normal[:, outside] = along_u, along_v, -(along_u * u + along_v * v)
        self._offset_m[outside] = 0

    def sampled_normals(self, points: int) -> Float[np.ndarray, "3 n"]:
        """The normals of ``sample(points)``."""
        return np.ascontiguousarray(self.normals[evenly(len(self.normals), points)].T)

    def planes(
        self, place: Int[np.ndarray, "*batch"]
    ) -> tuple[
        Float[np.ndarray, "*batch"],
        Float[np.ndarray, "*batch"],
        Float[np.ndarray, "*batch"],
        Float[np.ndarray, "*batch"],
    ]:
        """The three parts of the normals, and the offsets, at places."""
        x, y, z = self._normal
        return x.take(place), y.take(place), z.take(place), self._offset_m.take(place)


@dataclass(frozen=True, eq=False)
class Frame:
    """What all hypotheses of a pair share: the scale, and the point about which the object turns.

    A motion takes ``turning_m`` (current's camera axes) near ``center_m`` (the goal's).
    """

    size_m: float
    """Diagonal of what is seen, but for stray points."""
    turning_m: Float[np.ndarray, "3"]
    center_m: Float[np.ndarray, "3"]
    pivot_known: bool
    """Whether the two are one known pivot, which a motion must leave in place."""

    def start(self, R: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3"]:
        """The translations that take the turning point to the centre."""
        return self.center_m - R @ self.turning_m

    def prior(
        self, R: Float[np.ndarray, "k 3 3"], t_m: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, "k 3 3"], Float[np.ndarray, "k 3"]]:
        """How far each motion moves the known pivot, and the information (inverse covariance, 1/m^2) against that.

        A pivot wrong by d makes the motion seem to move it by (I - R) d: not at all along the axis of the rotation.
        """
        away = np.eye(3) - R
        covariance = PIVOT_ERROR_M**2 * away @ np.swapaxes(away, 1, 2) + (SLACK * self.size_m) ** 2 * np.eye(3)
        return np.linalg.inv(covariance), R @ self.turning_m + t_m - self.center_m

    def surprise(self, R: Float[np.ndarray, "k 3 3"], t_m: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Squared Mahalanobis distance of each motion from leaving the pivot in place; 0 where none is known."""
        if not self.pivot_known:
            return np.zeros(len(R))
        information, moved_m = self.prior(R, t_m)
        return np.einsum("ki,kij,kj->k", moved_m, information, moved_m)


def frame_of(current: Surface, goal: Surface, pivot_m: Float[np.ndarray, "3"] | None) -> Frame:
    """The frame of a pair. A pivot is of no use where its error of 1 cm is not small against the object."""
    size = max(size_m(current.all_points_m), size_m(goal.all_points_m))
    if pivot_m is not None and 0.15 * size > 0.01:
        pivot = np.asarray(pivot_m, float)
        return Frame(size, pivot, pivot, True)
    behind = np.array([0.0, 0.0, 0.12 * size])  # guess where the object turns: behind the middle of what is seen
    return Frame(size, current.all_points_m.mean(axis=0) + behind, goal.all_points_m.mean(axis=0) + behind, False)
