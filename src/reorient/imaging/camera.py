"""The pinhole camera.

Camera axes are OpenCV's: x right, y down, z forward. Pixel centres lie at +0.5: the pixel in row 0, column 0 covers
[0, 1) x [0, 1), so that cropping subtracts whole numbers from cx, cy and resizing scales fx, fy, cx, cy alike.
"""

from dataclasses import dataclass, replace
from math import isfinite
from numbers import Real as RealNumber

import numpy as np
from jaxtyping import Float, Real

from reorient.errors import ReorientError

LARGEST_PX = 65535  # of a width or height: what image files can hold
FOCAL_PX = (1e-2, 1e7)
LARGEST_OFFSET_PX = 1e7  # of the principal point, which lies beyond the image only after a crop


def is_number(x: object) -> bool:
    """Whether ``x`` is one finite real number."""
    try:
        return isinstance(x, RealNumber) and isfinite(x)
    except OverflowError:  # a whole number of more than 308 digits
        return False


def _short(x: object) -> str:
    """A number as text of readable length, also where it has 5,000 digits."""
    try:
        return str(x)[:40]
    except ValueError:
        return "a number of thousands of digits"


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without lens distortion. Numbers of any type are converted to int and float.

    Raises ReorientError for a size that is no whole number from 1 to 65535, for a focal length outside 0.01 to 1e7 px,
    and for a principal point that is not finite or more than 1e7 px away.
    """

    width: int
    """Columns, px."""
    height: int
    """Rows, px."""
    fx: float
    """Focal length along x, px."""
    fy: float
    """Focal length along y, px."""
    cx: float
    """Principal point, px from the left edge of the image (centre of the first pixel: 0.5)."""
    cy: float
    """Principal point, px from the top edge of the image."""

    def __post_init__(self) -> None:
        sizes, optics = (self.width, self.height), (self.fx, self.fy, self.cx, self.cy)
        if not all(is_number(x) and x == int(x) and 1 <= x <= LARGEST_PX for x in sizes):
            raise ReorientError(
                f"camera of {_short(self.width)} x {_short(self.height)} px: expected whole numbers, 1 to {LARGEST_PX}"
            )
        if not (
            all(is_number(x) and abs(x) <= LARGEST_OFFSET_PX for x in optics) and FOCAL_PX[0] <= min(self.fx, self.fy)
        ):
            words = ", ".join(f"{name}={_short(x)}" for name, x in zip(("fx", "fy", "cx", "cy"), optics, strict=True))
            raise ReorientError(f"camera of {words}: expected finite pixels, fx, fy > 0 ({FOCAL_PX[0]:g} to 1e7)")
        for name, kind in self.__annotations__.items():
            object.__setattr__(self, name, kind(getattr(self, name)))

    @classmethod
    def from_K(cls, K: Real[np.ndarray, "3 3"], width: int, height: int) -> "Camera":
        """The camera of an intrinsic matrix as OpenCV, ROS, RealSense and BOP write it.

        Those count pixel centres at integers, so 0.5 is added to the principal point. ``K`` is
        ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` in pixels. Raises ReorientError for another form, for skew, and
        whatever Camera refuses.
        """
        K = np.asarray(K)
        numeric = K.shape == (3, 3) and K.dtype.kind in "iuf"
        if not numeric or np.any(K[[0, 1, 2, 2], [1, 0, 0, 1]]) or K[2, 2] != 1:
            raise ReorientError(
                f"intrinsic matrix {K.tolist()}: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, without skew"
            )
        fx, fy, cx, cy = K[[0, 1, 0, 1], [0, 1, 2, 2]].astype(float).tolist()
        return cls(width, height, fx, fy, cx + 0.5, cy + 0.5)

    def cropped(self, left: int, top: int, width: int, height: int) -> "Camera":
        """The camera of a window of this image, in pixels. The window may reach beyond the image."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def resized(self, width: int, height: int) -> "Camera":
        """The camera of this image scaled to another size, in pixels."""
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)

    def rays(self) -> Float[np.ndarray, "height width 3"]:
        """The direction (x, y, 1) through every pixel centre. Depth times direction is the point in camera axes."""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        u, v = np.meshgrid(x, y)
        return np.stack([u, v, np.ones_like(u)], axis=-1)

    def project(self, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Pixel coordinates (column, row) of points in camera axes, metres. NaN where z <= 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(points_m[..., 2] > 0, points_m[..., 2], np.nan)
            u = self.fx * points_m[..., 0] / z + self.cx
            v = self.fy * points_m[..., 1] / z + self.cy
        return np.stack([u, v], axis=-1)
