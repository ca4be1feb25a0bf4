"""Lens distortion: undone by resampling, so that everything behind the readers has a pinhole camera.

The models map an ideal direction (x / z, y / z) to the distorted one. Every pixel of the undistorted image takes the
depth of the distorted pixel that it came from (nearest neighbour). Depth is along the optical axis, so it stays.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from reorient.errors import ReorientError
from reorient.imaging.camera import Camera

Model = Literal["brown", "modified", "fisheye"]
_LARGEST = 1e4  # of a coefficient; Azure Kinect's reach 10
_SAMPLES = 2000  # of the radius, in the search for its largest sound value


@dataclass(frozen=True)
class Distortion:
    """Lens distortion as OpenCV (``brown``, ``fisheye``) and librealsense (``modified``) define it.

    Raises ReorientError for more coefficients than the model has, and for coefficients that no lens has.
    """

    model: Model = "brown"
    """``brown``: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, Brown-Conrady with the rational and thin-prism terms.
    ``modified``: k1 k2 p1 p2 k3, the tangential terms at the radially distorted point. ``fisheye``: k1 k2 k3 k4, the
    equidistant (Kannala-Brandt) model."""
    coefficients: tuple[float, ...] = ()
    """In the model's order; missing ones are 0."""

    def __post_init__(self) -> None:
        most = {"brown": 12, "modified": 5, "fisheye": 4}[self.model]
        if len(self.coefficients) > most and any(self.coefficients[most:]):
            raise ReorientError(
                f"lens distortion with {len(self.coefficients)} coefficients: expected at most {most} for the model "
                f"{self.model!r} (a tilted sensor is not supported: undistort the images)"
            )
        if not all(abs(x) <= _LARGEST for x in self.coefficients):
            raise ReorientError(
                f"lens distortion {list(self.coefficients)}: expected finite coefficients up to {_LARGEST:g}"
            )
        padded = (*self.coefficients, *(0.0,) * most)[:most]
        object.__setattr__(self, "coefficients", tuple(map(float, padded)))

    def __bool__(self) -> bool:
        """Whether there is any. The fisheye model distorts even where its coefficients are 0."""
        return self.model == "fisheye" or any(self.coefficients)

    def distorted(
        self, x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]
    ) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
        """The distorted direction of each ideal one; NaN beyond the radius at which the model folds over."""
        r2 = x * x + y * y
        r = np.sqrt(r2)
        with np.errstate(all="ignore"):
            factor = np.where(r > 0, self._radius(r) / np.where(r > 0, r, 1), 1.0)
            factor = np.where(r <= self._largest_radius(float(r.max(initial=0))), factor, np.nan)
            if self.model == "fisheye":
                return x * factor, y * factor
            p1, p2 = self.coefficients[2:4]
            s1, s2, s3, s4 = self.coefficients[8:12] if self.model == "brown" else (0.0,) * 4
            xr, yr = x * factor, y * factor
            a, b = (xr, yr) if self.model == "modified" else (x, y)
            return (
                xr + 2 * p1 * a * b + p2 * (r2 + 2 * a * a) + s1 * r2 + s2 * r2 * r2,
                yr + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b + s3 * r2 + s4 * r2 * r2,
            )

    def source(
        self, camera: Camera
    ) -> tuple[Int[np.ndarray, "height width"], Int[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
        """Row and column of the distorted pixel for each undistorted one, and whether there is one (else 0, 0)."""
        rays = camera.rays()
        x, y = self.distorted(rays[..., 0], rays[..., 1])
        with np.errstate(invalid="ignore"):
            column, row = np.floor(x * camera.fx + camera.cx), np.floor(y * camera.fy + camera.cy)
            inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        return np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int), inside

    def undone(self, image: Shaped[np.ndarray, "height width"], camera: Camera, beyond: float) -> np.ndarray:
        """The image as the pinhole ``camera`` of the same intrinsics has it; ``beyond``: the value outside of it."""
        row, column, inside = self.source(camera)
        return np.asarray(np.where(inside, image[row, column], np.asarray(beyond, image.dtype)))

    def _radius(self, r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Distorted radius of an ideal one, without the tangential and prism terms."""
        if self.model == "fisheye":
            k1, k2, k3, k4 = self.coefficients
            theta = np.arctan(r)
            t2 = theta * theta
            return np.asarray(theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))
        k1, k2, _, _, k3 = self.coefficients[:5]
        k4, k5, k6 = self.coefficients[5:8] if self.model == "brown" else (0.0,) * 3
        r2 = r * r
        return np.asarray(r * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6))))

    def _largest_radius(self, most: float) -> float:
        """The ideal radius up to which a larger one is distorted to a larger one: beyond it the polynomial, fitted to
        the image alone, folds back into the image."""
        r = np.linspace(0, most, _SAMPLES)
        falling = np.flatnonzero(~(np.diff(self._radius(r)) > 0))
        return float(r[falling[0]]) if len(falling) else most
