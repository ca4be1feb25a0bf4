"""Depth images: the pinhole camera, the image and its checks, points, crops.

Camera axes are OpenCV's: x right, y down, z forward. Pixel centres lie at +0.5: the pixel in row 0, column 0 covers
[0, 1) x [0, 1), so that cropping subtracts whole numbers from cx, cy and resizing scales fx, fy, cx, cy alike.
"""

from dataclasses import dataclass, replace
from math import isfinite
from numbers import Real
from operator import index

import numpy as np
from jaxtyping import Bool, Float, Shaped

from reorient.errors import ReorientError

NEAREST_M = 0.01  # a median depth below this is no camera's
MILLIMETRES_ABOVE = 20.0  # a median depth of over 20 is taken for millimetres: no depth camera holds an object there
ISOLATED_BELOW = 0.6  # an object alone leaves at least this much of the frame empty


def _is_number(x: object) -> bool:
    return isinstance(x, Real) and isfinite(x)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion; numbers of any type are kept as int and float.

    Raises ReorientError for sizes or focal lengths that are none.
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
        if not all(_is_number(x) and x == int(x) and x >= 1 for x in sizes):
            raise ReorientError(f"camera of {self.width} x {self.height} px: expected whole numbers above 0")
        if not all(_is_number(x) for x in optics) or min(self.fx, self.fy) <= 0:
            raise ReorientError(
                f"camera of fx={self.fx}, fy={self.fy}, cx={self.cx}, cy={self.cy}: expected finite pixels, fx, fy > 0"
            )
        for name, kind in self.__annotations__.items():
            object.__setattr__(self, name, kind(getattr(self, name)))

    def cropped(self, left: int, top: int, width: int, height: int) -> "Camera":
        """The camera of a window of this image; the window may reach beyond it."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def resized(self, width: int, height: int) -> "Camera":
        """The camera of this image scaled to another size in pixels."""
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)

    def rays(self) -> Float[np.ndarray, "height width 3"]:
        """Through every pixel centre the direction (x, y, 1): times a depth, the point in camera axes."""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        u, v = np.meshgrid(x, y)
        return np.stack([u, v, np.ones_like(u)], axis=-1)

    def project(self, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Pixel coordinates (column, row) of points in front of the camera; NaN for z <= 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(points_m[..., 2] > 0, points_m[..., 2], np.nan)
            u = self.fx * points_m[..., 0] / z + self.cx
            v = self.fy * points_m[..., 1] / z + self.cy
        return np.stack([u, v], axis=-1)


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth of one isolated object, as a camera saw it.

    Raises ReorientError for a wrong shape or dtype, NaN or infinity, negative or all-zero depth, and what looks like
    millimetres, and for a stamp that is no finite number. Floating-point depth of any width is kept as float32.
    """

    depth_m: Float[np.ndarray, "height width"]
    """Metres along the optical axis; 0 = no return, or not the object."""
    camera: Camera
    stamp_s: float | None = None
    """When it was captured, seconds on the station's clock; None if unknown."""

    def __post_init__(self) -> None:
        try:
            depth_m = np.asarray(self.depth_m)
        except ValueError as error:  # rows of different lengths
            raise ReorientError(f"depth is no image ({error}): expected an array (height, width)") from error
        if not isinstance(self.camera, Camera):
            raise ReorientError(
                "missing intrinsics: expected a reorient.Camera (width, height, fx, fy, cx, cy) with the depth image"
            )
        if not np.issubdtype(depth_m.dtype, np.floating):
            raise ReorientError(
                f"depth of dtype {depth_m.dtype}: expected floating-point metres (raw 16-bit units times their scale, "
                "often 0.001)"
            )
        if depth_m.shape != (self.camera.height, self.camera.width):
            raise ReorientError(
                f"depth of shape {depth_m.shape}: expected (height, width) = ({self.camera.height}, "
                f"{self.camera.width}) as in its camera"
            )
        with np.errstate(over="ignore"):
            depth_m = depth_m.astype(np.float32)
        lowest, highest = depth_m.min(), depth_m.max()  # NaN where any pixel is
        if not np.isfinite([lowest, highest]).all():
            raise ReorientError(
                f"depth has {np.count_nonzero(~np.isfinite(depth_m))} NaN or infinite pixels: expected 0 for no return "
                "(numpy.nan_to_num)"
            )
        if lowest < 0:
            raise ReorientError(f"depth as low as {lowest:.3g} m: expected no negative value, 0 for no return")
        if highest == 0:
            raise ReorientError("depth is 0 everywhere: expected returns from the object (empty frame or empty mask?)")
        returns = depth_m[depth_m > 0]
        if returns.min() < NEAREST_M or highest > MILLIMETRES_ABOVE:  # else the median, dearer, is neither
            median = float(np.median(returns))
            if median < NEAREST_M:
                raise ReorientError(
                    f"median depth is {median:.2g} m: expected metres, at least {NEAREST_M} (wrong scale?)"
                )
            if median > MILLIMETRES_ABOVE:
                raise ReorientError(
                    f"median depth is {median:.0f}: this looks like millimetres, expected metres (times 0.001)"
                )
        object.__setattr__(self, "depth_m", depth_m)
        if self.stamp_s is not None:
            if not _is_number(self.stamp_s):
                raise ReorientError(f"stamp {self.stamp_s!r}: expected finite seconds, or None if unknown")
            object.__setattr__(self, "stamp_s", float(self.stamp_s))

    @property
    def valid(self) -> Bool[np.ndarray, "height width"]:
        """Where there is a return."""
        return self.depth_m > 0

    def points(self) -> Float[np.ndarray, "n 3"]:
        """The returns as points in camera axes, metres, row by row."""
        valid = self.valid
        return self.camera.rays()[valid] * self.depth_m[valid][:, None].astype(np.float64)

    def cropped(self, left: int, top: int, width: int, height: int) -> "DepthImage":
        """A window; where it reaches beyond the image it has no returns. Raises ReorientError if none is left."""
        camera = self.camera.cropped(left, top, width, height)
        out = np.zeros((height, width), np.float32)
        rows = slice(max(top, 0), min(top + height, self.camera.height))
        columns = slice(max(left, 0), min(left + width, self.camera.width))
        if rows.start < rows.stop and columns.start < columns.stop:
            inside = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
            out[inside] = self.depth_m[rows, columns]
        return replace(self, depth_m=out, camera=camera)

    def resized(self, width: int, height: int) -> "DepthImage":
        """Another size by nearest neighbour: mixing depths across an edge would invent points."""
        rows = ((np.arange(height) + 0.5) * self.camera.height / height).astype(int)
        columns = ((np.arange(width) + 0.5) * self.camera.width / width).astype(int)
        return replace(self, depth_m=self.depth_m[np.ix_(rows, columns)], camera=self.camera.resized(width, height))


def require_isolated(image: DepthImage) -> DepthImage:
    """The image itself. Raises ReorientError for a whole scene: returns on over 60% of it, and on most of its border,
    which a tight crop of an object leaves empty."""
    share = float(np.mean(image.valid))
    border = np.concatenate([image.valid[[0, -1]].ravel(), image.valid[:, [0, -1]].ravel()])
    if share > ISOLATED_BELOW and float(np.mean(border)) > 0.5:
        raise ReorientError(
            f"isolate the object: returns fill {share:.0%} of the image, expected at most {ISOLATED_BELOW:.0%}; "
            "give a mask, a box or a near/far range (--mask, --box, --near, --far)"
        )
    return image


def isolate(
    image: DepthImage,
    mask: Shaped[np.ndarray, "height width"] | None = None,
    box_px: tuple[int, int, int, int] | None = None,
    near_m: float | None = None,
    far_m: float | None = None,
) -> DepthImage:
    """Only the returns inside the mask, the box (left, top, width, height) and the depth range; the size stays.

    Raises ReorientError for a mask of another size, a box that is none, where nothing is left, and where what is left
    is still a scene.
    """
    keep = image.valid.copy()
    if mask is not None:
        mask = np.asarray(mask) != 0
        if mask.shape != keep.shape:
            raise ReorientError(f"mask of shape {mask.shape}: expected {keep.shape} as its depth image")
        if not mask.any():
            raise ReorientError("the mask is empty: expected non-zero pixels on the object")
        keep &= mask
    if box_px is not None:
        try:
            left, top, width, height = (index(x) for x in box_px)
        except (TypeError, ValueError) as error:
            raise ReorientError(f"box {box_px}: expected left, top, width, height in whole pixels") from error
        if width < 1 or height < 1:
            raise ReorientError(f"box of {width} x {height} px: expected left, top, width, height with a size above 0")
        inside = np.zeros_like(keep)
        inside[max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)] = True
        keep &= inside
    if near_m is not None:
        keep &= image.depth_m >= near_m
    if far_m is not None:
        keep &= image.depth_m <= far_m
    if not keep.any():
        raise ReorientError(
            "nothing is left of the image: expected returns inside the mask, the box and the depth range"
        )
    return require_isolated(replace(image, depth_m=np.where(keep, image.depth_m, np.float32(0))))
