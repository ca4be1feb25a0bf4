"""The depth image of one isolated object: its checks, points, crops."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer

from reorient.errors import ReorientError
from reorient.imaging.camera import Camera, is_number
from reorient.imaging.intrinsic_fields import distortion_of
from reorient.imaging.splatting import splat

NEAREST_M = 0.01  # no depth camera measures nearer
MILLIMETRES_ABOVE = 20.0  # depth above this is taken as millimetres: no held object is 20 m away
_STRAY = (
    0.0003  # share of a raw frame's returns that may be stray. More near a camera may be an object before a far scene
)
NO_RETURN = 65535  # in unsigned 16 bits
_AWAY = 0.1  # of the width: largest median distance of organised points from their pixels, by lens distortion
_RANGE_M = (1e-4, 1e3)  # single returns outside it are no measurement: rounding of zero, a renderer's "infinitely far"


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth of one isolated object, measured by one camera.

    A pixel has one of three states: the object (``valid``), not the object, and unknown. Floating-point depth of any
    width is converted to float32. Raises ReorientError for a wrong shape or dtype, negative depth, an image without
    returns, depth that is probably in millimetres, a missing camera, and a stamp that is no finite number.
    """

    depth_m: Float[np.ndarray, "height width"]
    """Metres along the optical axis; 0 = not the object. Pixels without return (NaN, infinity, masked elements of a
    masked array, depth below 0.1 mm or above 1 km) become 0 and unknown."""
    camera: Camera
    stamp_s: float | None = None
    """Time of capture, seconds on the station's clock; None if not known."""
    unknown: Bool[np.ndarray, "height width"] = None  # type: ignore[assignment]
    """Pixels that may or may not show the object: without return, with something in front, outside the sensor's range.
    Their depth becomes 0. Default: those without return."""

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise ReorientError(
                "missing intrinsics: expected a reorient.Camera (width, height, fx, fy, cx, cy) with the depth image"
            )
        depth_m = _checked_depth(self.depth_m, self.camera)
        unknown = _without_return(depth_m)
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

    @classmethod
    def from_uint16(
        cls,
        raw: Integer[np.ndarray, "..."],
        camera: Camera,
        scale_m: float = 0.001,
        stamp_s: float | None = None,
    ) -> "DepthImage":
        """A raw frame of integer depth, (height, width) or (height, width, 1); isolate it next.

        0, 65535 and masked elements are no return, so unknown. ``scale_m``: metres per unit. Raises ReorientError for
        another dtype, a scale that is not above 0, and as DepthImage.
        """
        units = without_mask(raw, 0)
        if units.ndim == 3 and units.shape[2] == 1:
            units = units[:, :, 0]
        if units.dtype.kind not in "iu":
            raise ReorientError(
                f"raw depth of dtype {units.dtype}: expected integers (metres: DepthImage(depth_m, camera))"
            )
        if not (is_number(scale_m) and scale_m > 0):
            raise ReorientError(f"depth scale {scale_m!r}: expected metres per unit, above 0")
        nothing = (units == 0) | (units == NO_RETURN)
        return cls(np.where(nothing, np.nan, units * float(scale_m)), camera, stamp_s)

    @classmethod
    def from_points(
        cls, points_m: Float[np.ndarray, "*n 3"], camera: Camera, stamp_s: float | None = None
    ) -> "DepthImage":
        """Points in camera axes (x right, y down, z forward), metres, as the camera sees them: the nearest of a pixel.

        Points of an image (height, width, 3) or in any order (n, 3); NaN and (0, 0, 0) are none. Pixels without a point
        are unknown; isolate the image next. Raises ReorientError for another shape, where no point projects into the
        image, and as DepthImage.
        """
        points = without_mask(points_m, np.nan)
        if points.dtype.kind != "f" or points.ndim < 2 or points.shape[-1] != 3:
            raise ReorientError(
                f"points of dtype {points.dtype} and shape {points.shape}: expected floats (height, width, 3) or (n, 3)"
            )
        flat = points.reshape(-1, 3).astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore"):
            uv_px = camera.project(flat)
            depth = splat(uv_px, flat[:, 2], (camera.height, camera.width))
        if points.shape[:-1] == depth.shape:
            _check_organised(uv_px.reshape(*depth.shape, 2), camera)
        if not depth.any():
            raise ReorientError(
                f"none of {len(flat)} points projects into the {camera.width} x {camera.height} px of the camera: "
                "expected camera axes (x right, y down, z forward), metres"
            )
        return cls(np.where(depth > 0, depth, np.nan), camera, stamp_s)

    @classmethod
    def from_open3d(
        cls, image: Any, intrinsic: Any, scale_m: float = 0.001, stamp_s: float | None = None
    ) -> "DepthImage":
        """An ``open3d.geometry.Image`` or ``open3d.t.geometry.Image`` and a ``PinholeCameraIntrinsic``.

        Integers are raw units of ``scale_m`` metres (as ``from_uint16``), floats metres with 0 for no return.
        Raises ReorientError as DepthImage.
        """
        pixels = np.asarray(image.as_tensor().cpu().numpy() if hasattr(image, "as_tensor") else image)
        pixels = pixels[:, :, 0] if pixels.ndim == 3 and pixels.shape[2] == 1 else pixels
        camera = Camera.from_K(np.asarray(intrinsic.intrinsic_matrix), intrinsic.width, intrinsic.height)
        if pixels.dtype.kind in "iu":
            return cls.from_uint16(pixels, camera, scale_m, stamp_s)
        return cls(np.where(pixels == 0, np.nan, pixels), camera, stamp_s)

    @classmethod
    def from_realsense(cls, frame: Any, scale_m: float | None = None) -> "DepthImage":
        """A ``pyrealsense2.depth_frame``, also one aligned to colour: its intrinsics, unit and time stamp are used.

        Lens distortion is undone. ``scale_m``: metres per unit; by default the frame's own. Raises ReorientError for a
        distortion that librealsense does not define, and as DepthImage.
        """
        lens = frame.profile.as_video_stream_profile().get_intrinsics()
        camera = Camera(lens.width, lens.height, lens.fx, lens.fy, lens.ppx + 0.5, lens.ppy + 0.5)
        distortion = distortion_of(str(lens.model), list(lens.coeffs))
        units = np.asanyarray(frame.get_data())
        if distortion:
            units = distortion.undone(units, camera, 0)
        scale_m = float(frame.get_units()) if scale_m is None else scale_m
        return cls.from_uint16(units, camera, scale_m, frame.get_timestamp() / 1000)

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
        floating = np.issubdtype(getattr(depth_m, "dtype", float), np.floating)
        depth = without_mask(depth_m, np.nan if floating else 0)
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


def _check_organised(uv_px: Float[np.ndarray, "height width 2"], camera: Camera) -> None:
    """Raise ReorientError where the points of an image lie far from their own pixels, beyond any lens distortion."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    away = np.hypot(uv_px[..., 0] - columns, uv_px[..., 1] - rows)
    away = away[np.isfinite(away)]
    if len(away) and np.median(away) > _AWAY * camera.width:
        raise ReorientError(
            f"points lie {np.median(away):.0f} px (median) from their own pixels: expected camera axes (x right, "
            "y down, z forward) and the camera that took them (a picture of three colours is no depth)"
        )


def without_mask(array: object, fill: float) -> np.ndarray:
    """The array, with ``fill`` where it is a masked array and masked."""
    return np.asarray(array.filled(fill) if isinstance(array, np.ma.MaskedArray) else array)


def _without_return(depth_m: Float32[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """NaN, infinity, and single returns outside any camera's range. Where nearly all are outside, the unit is wrong."""
    with np.errstate(invalid="ignore"):
        nothing = ~np.isfinite(depth_m)
        outside = (depth_m > _RANGE_M[1]) | ((depth_m > 0) & (depth_m < _RANGE_M[0]))
        seen = (depth_m >= _RANGE_M[0]) & ~nothing
        some = np.count_nonzero(seen & (depth_m <= MILLIMETRES_ABOVE)) > _STRAY * np.count_nonzero(seen)
    return np.asarray(nothing | outside if some else nothing)


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
        return  # then so are the quantiles, which take longer to compute
    found = f"depths are {returns.min():.3g} to {highest:.3g}"
    if np.quantile(returns, 1 - _STRAY) < NEAREST_M:
        raise ReorientError(f"{found} m: expected metres, at least {NEAREST_M} (wrong scale?)")
    if not is_metres(returns):
        raise ReorientError(f"{found}: this looks like millimetres, expected metres (times 0.001)")


def is_metres(returns: Float[np.ndarray, " n"]) -> bool:
    """Whether depth may be in metres: some of it, more than stray returns, is where an object may be.

    Most returns of a raw frame may be from a far background.
    """
    return bool(np.quantile(returns, _STRAY) <= MILLIMETRES_ABOVE)
