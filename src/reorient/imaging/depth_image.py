"""The depth image of one isolated object: its checks, points, crops."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from reorient.errors import ReorientError
from reorient.imaging.camera import Camera, is_number

NEAREST_M = 0.01  # no depth camera measures a median depth below this
MILLIMETRES_ABOVE = 20.0  # a median depth above this is taken as millimetres: no held object is 20 m away


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth of one isolated object, measured by one camera.

    A pixel has one of three states: the object (``valid``), not the object, and unknown. Floating-point depth of any
    width is converted to float32. Raises ReorientError for a wrong shape or dtype, negative depth, an image without
    returns, depth that is probably in millimetres, a missing camera, and a stamp that is no finite number.
    """

    depth_m: Float[np.ndarray, "height width"]
    """Metres along the optical axis; 0 = not the object. NaN and infinity (no return) become 0 and unknown."""
    camera: Camera
    stamp_s: float | None = None
    """Time of capture, seconds on the station's clock; None if not known."""
    unknown: Bool[np.ndarray, "height width"] = None  # type: ignore[assignment]
    """Pixels that may or may not show the object: without return, with something in front, outside the sensor's range.
    Their depth becomes 0. Default: those with NaN or infinite depth."""

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise ReorientError(
                "missing intrinsics: expected a reorient.Camera (width, height, fx, fy, cx, cy) with the depth image"
            )
        depth_m = _checked_depth(self.depth_m, self.camera)
        unknown = ~np.isfinite(depth_m)
        if self.unknown is not None:
            unknown |= _checked_unknown(self.unknown, self.camera)
        depth_m[unknown] = 0
        _check_values(depth_m)
        object.__setattr__(self, "depth_m", depth_m)
        object.__setattr__(self, "unknown", unknown)
        if self.stamp_s is not None:
            if not is_number(self.stamp_s):
                raise ReorientError(f"stamp {self.stamp_s!r}: expected finite seconds, or None if unknown")
            object.__setattr__(self, "stamp_s", float(self.stamp_s))

    @property
    def valid(self) -> Bool[np.ndarray, "height width"]:
        """The pixels with a return."""
        return np.asarray(self.depth_m > 0)

    def points(self) -> Float[np.ndarray, "n 3"]:
        """The returns as points in camera axes, metres, in row-major order."""
        valid = self.valid
        return np.asarray(self.camera.rays()[valid] * self.depth_m[valid][:, None].astype(np.float64))

    def cropped(self, left: int, top: int, width: int, height: int) -> "DepthImage":
        """A window in pixels; beyond the image it is unknown. Raises ReorientError if it has no return at all."""
        camera = self.camera.cropped(left, top, width, height)
        out, unknown = np.zeros((height, width), np.float32), np.ones((height, width), bool)
        rows = slice(max(top, 0), min(top + height, self.camera.height))
        columns = slice(max(left, 0), min(left + width, self.camera.width))
        if rows.start < rows.stop and columns.start < columns.stop:
            inside = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
            out[inside], unknown[inside] = self.depth_m[rows, columns], self.unknown[rows, columns]
        return replace(self, depth_m=out, camera=camera, unknown=unknown)

    def resized(self, width: int, height: int) -> "DepthImage":
        """Another size in pixels, by nearest neighbour: interpolating depth across an edge would invent points."""
        rows = ((np.arange(height) + 0.5) * self.camera.height / height).astype(int)
        columns = ((np.arange(width) + 0.5) * self.camera.width / width).astype(int)
        chosen = np.ix_(rows, columns)
        camera = self.camera.resized(width, height)
        return replace(self, depth_m=self.depth_m[chosen], camera=camera, unknown=self.unknown[chosen])


def _checked_depth(depth_m: object, camera: Camera) -> Float32[np.ndarray, "height width"]:
    """A float32 copy of the depth. Raises ReorientError unless it is floating-point, of the size of this camera."""
    try:
        depth = np.asarray(depth_m)
    except ValueError as error:  # rows of different lengths
        raise ReorientError(f"depth is no image ({error}): expected an array (height, width)") from error
    if not np.issubdtype(depth.dtype, np.floating):
        raise ReorientError(
            f"depth of dtype {depth.dtype}: expected floating-point metres (raw 16-bit units times their scale, "
            "often 0.001)"
        )
    if depth.shape != (camera.height, camera.width):
        raise ReorientError(
            f"depth of shape {depth.shape}: expected (height, width) = ({camera.height}, {camera.width}) as in its "
            "camera"
        )
    with np.errstate(over="ignore"):
        return depth.astype(np.float32)


def _checked_unknown(unknown: object, camera: Camera) -> Bool[np.ndarray, "height width"]:
    mask = np.asarray(unknown)
    if mask.dtype != bool or mask.shape != (camera.height, camera.width):
        raise ReorientError(
            f"unknown pixels of dtype {mask.dtype} and shape {mask.shape}: expected booleans, (height, width) = "
            f"({camera.height}, {camera.width}) as in the camera"
        )
    return mask


def _check_values(depth_m: Float32[np.ndarray, "height width"]) -> None:
    """Raise ReorientError for values that no depth image in metres has."""
    lowest, highest = depth_m.min(), depth_m.max()
    if lowest < 0:
        raise ReorientError(f"depth as low as {lowest:.3g} m: expected no negative value, 0 for no return")
    if highest == 0:
        raise ReorientError("depth is 0 everywhere: expected returns from the object (empty frame or empty mask?)")
    returns = depth_m[depth_m > 0]
    if returns.min() >= NEAREST_M and highest <= MILLIMETRES_ABOVE:
        return  # then so is the median, which takes longer to compute
    median = float(np.median(returns))
    if median < NEAREST_M:
        raise ReorientError(f"median depth is {median:.2g} m: expected metres, at least {NEAREST_M} (wrong scale?)")
    if median > MILLIMETRES_ABOVE:
        raise ReorientError(f"median depth is {median:.0f}: this looks like millimetres, expected metres (times 0.001)")
