"""Depth images and intrinsics on disk.

Depth: 16-bit PNG and TIFF (scale in metres per unit from the file, 0.001 where the file has none), float TIFF, .npy and
.npz in metres. Intrinsics: JSON in the format of reorient, Open3D or RealSense.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, PngImagePlugin, TiffImagePlugin

from reorient.errors import ReorientError
from reorient.imaging.camera import Camera
from reorient.imaging.depth_image import DepthImage
from reorient.runs.files import replacing

SCALE_M = 0.001  # what RealSense and Open3D write into 16-bit files
SUFFIXES = (".png", ".npy", ".npz", ".tif", ".tiff")
NO_RETURN = 65535  # in 16-bit files: unknown
_TIFF_DESCRIPTION = 270


def read_camera(path: str | Path) -> Camera:
    """Intrinsics from JSON: Open3D (``intrinsic_matrix``), RealSense (``ppx``, ``ppy``), or reorient (``cx``, ``cy``).

    Open3D and RealSense count pixel centres at integers, so 0.5 is added to their principal point; files of reorient
    count them at +0.5. Raises ReorientError for missing values, and for lens distortion: rectify the images first.
    """
    text = _existing(path, "camera file").read_text(errors="replace")
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise ReorientError(f"camera file {str(path)!r} is not JSON ({error}): expected intrinsics") from error
    return camera_from(data, str(path))


def write_camera(path: str | Path, camera: Camera) -> None:
    """Write intrinsics as JSON in the format of reorient; pixel centres at +0.5."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(_camera_data(camera), indent=2) + "\n")


def read_depth(path: str | Path, camera: Camera | None = None, scale_m: float | None = None) -> DepthImage:
    """A depth image from .png, .tif(f), .npy or .npz.

    ``camera``: intrinsics, overriding those in the file; needed where the file has none. ``scale_m``: metres per unit
    of integer depth, overriding the file's own; floats are metres in any case. Raises ReorientError for a missing,
    truncated or unknown file, missing intrinsics, and whatever DepthImage refuses.
    """
    path = _existing(path, "depth image")
    if path.suffix.lower() not in SUFFIXES:
        raise ReorientError(f"depth image {str(path)!r}: expected one of {', '.join(SUFFIXES)}")
    if scale_m is not None:
        _check_scale(scale_m)
    depth, stated = _read_arrays(path)
    camera = camera or _stated_camera(stated, path)
    if depth.ndim != 2:
        raise ReorientError(f"depth image {str(path)!r} has shape {depth.shape}: expected one channel, (height, width)")
    if np.issubdtype(depth.dtype, np.integer):
        return _scaled(depth, camera, stated, scale_m)
    try:
        return DepthImage(depth, camera, stated.get("stamp_s"))
    except ReorientError as error:
        if scale_m is None:
            raise
        raise ReorientError(f"{error}; a scale is for integers, but {str(path)!r} holds {depth.dtype}") from error


def _stated_camera(stated: dict[str, Any], path: Path) -> Camera:
    if "camera" not in stated:
        raise ReorientError(f"missing intrinsics for {str(path)!r}: expected a camera file (--camera camera.json)")
    return camera_from(stated["camera"], str(path))


def _scaled(units: np.ndarray, camera: Camera, stated: dict[str, Any], scale_m: float | None) -> DepthImage:
    """A depth image from integer units at the given scale, else at that of the file."""
    if scale_m is None:
        scale_m = stated.get("scale_m")
    depth = units if scale_m is None else units * _check_scale(scale_m)
    unknown = (units == NO_RETURN) & (units.dtype == np.uint16)
    return DepthImage(depth, camera, stated.get("stamp_s"), unknown)


def write_depth(path: str | Path, image: DepthImage, scale_m: float = SCALE_M) -> None:
    """Write .png (16-bit, rounded to ``scale_m``), .tif(f) (float32), .npy or .npz; all but .npy contain the camera.

    Unknown pixels are 65535 in .png and NaN elsewhere. Raises ReorientError for another suffix, for a scale not above
    0 and for depth above 65534 units.
    """
    path = Path(path)
    _check_scale(scale_m)
    stated: dict[str, Any] = {"camera": _camera_data(image.camera)}
    if image.stamp_s is not None:
        stated["stamp_s"] = image.stamp_s
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ReorientError(f"cannot write depth as {path.name!r}: expected one of {', '.join(SUFFIXES)}")
    depth_m = np.where(image.unknown, np.float32(np.nan), image.depth_m)
    with replacing(path) as temporary:
        if suffix == ".png":
            units = np.rint(image.depth_m.astype(np.float64) / scale_m)
            if units.max() >= NO_RETURN:
                raise ReorientError(
                    f"depth of {image.depth_m.max():.2f} m does not fit 16 bits of {scale_m} m: expected a larger scale"
                )
            units[image.unknown] = NO_RETURN
            text = PngImagePlugin.PngInfo()
            text.add_text("reorient", json.dumps(stated | {"scale_m": scale_m}))
            Image.fromarray(units.astype(np.uint16)).save(temporary, pnginfo=text)
        elif suffix in (".tif", ".tiff"):
            tags = TiffImagePlugin.ImageFileDirectory_v2()
            tags[_TIFF_DESCRIPTION] = json.dumps(stated)
            Image.fromarray(depth_m).save(temporary, tiffinfo=tags)
        else:
            with temporary.open("wb") as file:  # given a name, numpy appends ".npz" to ".NPZ"
                if suffix == ".npz":
                    np.savez_compressed(file, depth_m=depth_m, stated=json.dumps(stated))
                else:
                    np.save(file, depth_m)


def read_mask(path: str | Path) -> np.ndarray:
    """A boolean (height, width) mask: true where the .npy array, or any colour channel of the picture, is not zero.

    Of an RGBA picture with transparent pixels (a cut-out) the mask is where it is at least half opaque.
    """
    path = _existing(path, "mask")
    try:
        if path.suffix == ".npy":
            return np.asarray(np.load(path) != 0)
        with Image.open(path) as picture:
            if picture.mode != "P" and len(picture.getbands()) == 1:  # RGB would clip its numbers
                return np.asarray(np.asarray(picture) != 0)
            rgba = np.asarray(picture.convert("RGBA"))
            opaque = rgba[..., 3] >= 128
            is_cut_out = picture.mode == "RGBA" and opaque.any() and rgba[..., 3].min() == 0
            return np.asarray(opaque if is_cut_out else rgba[..., :3].max(axis=-1) > 0)
    except Exception as error:
        raise ReorientError(f"cannot read mask {str(path)!r} ({error}): expected a picture or a .npy array") from error


def _existing(path: str | Path, what: str) -> Path:
    path = Path(path)
    if path.is_dir():
        raise ReorientError(f"{str(path)!r} is a folder: expected a file")
    if not path.is_file():
        raise ReorientError(f"no {what} at {str(path)!r}: expected an existing file")
    return path


def _check_scale(scale_m: Any) -> float:
    if not (isinstance(scale_m, int | float) and 0 < scale_m < np.inf):
        raise ReorientError(f"depth scale {scale_m!r}: expected metres per unit, above 0")
    return float(scale_m)


def _read_arrays(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """The array as stored, and the metadata of the file: camera, scale_m, stamp_s."""
    try:
        array, stated = {".npy": _read_npy, ".npz": _read_npz}.get(path.suffix.lower(), _read_picture)(path)
    except ReorientError:
        raise
    except Exception as error:  # the decoders raise many kinds of errors on broken files
        raise ReorientError(
            f"cannot read depth image {str(path)!r} ({type(error).__name__}: {error}): expected a complete file"
        ) from error
    if not (isinstance(array, np.ndarray) and array.dtype.kind in "fiu" and isinstance(stated, dict)):
        raise ReorientError(f"{str(path)!r} holds no depth: expected an array of numbers")
    return array, stated


def _read_npy(path: Path) -> tuple[Any, Any]:
    return np.load(path), {}


def _read_npz(path: Path) -> tuple[Any, Any]:
    with np.load(path) as arrays:
        if "depth_m" not in arrays:
            raise ReorientError(f"{str(path)!r} holds {', '.join(arrays)}: expected an array depth_m")
        return arrays["depth_m"], json.loads(str(arrays["stated"])) if "stated" in arrays else {}


def _read_picture(path: Path) -> tuple[Any, Any]:
    with Image.open(path) as picture:
        if picture.mode not in ("I;16", "I;16B", "I", "F"):
            raise ReorientError(f"{str(path)!r} is a {picture.mode} picture: expected 16-bit depth with one channel")
        if path.suffix.lower() == ".png":
            stated = json.loads(picture.info.get("reorient", "{}"))
        else:
            description = picture.tag_v2.get(_TIFF_DESCRIPTION, "")  # type: ignore[attr-defined]
            stated = json.loads(description) if description.startswith("{") else {}
        array = np.array(picture)
    if array.dtype != np.float32:
        stated.setdefault("scale_m", SCALE_M)
    return array, stated


def _camera_data(camera: Camera) -> dict[str, Any]:
    names = ("width", "height", "fx", "fy", "cx", "cy")
    return {name: getattr(camera, name) for name in names} | {"pixel_centers_at": 0.5}


def camera_from(data: Any, source: str) -> Camera:
    """Intrinsics from parsed JSON of the file ``source``. Formats and errors as of ``read_camera``."""
    if not isinstance(data, dict):
        raise ReorientError(f"camera in {source!r}: expected a JSON object with width, height and intrinsics")
    try:
        width, height = int(data["width"]), int(data["height"])
        if (width, height) != (float(data["width"]), float(data["height"])):
            raise ReorientError(
                f"camera in {source!r} of {data['width']} x {data['height']} px: expected whole numbers"
            )
        return Camera(width, height, *_optics(data, source))
    except ReorientError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ReorientError(
            f"missing intrinsics in {source!r} ({error}): expected width, height and fx, fy, cx, cy, or an Open3D "
            "intrinsic_matrix, or RealSense's ppx, ppy"
        ) from error


def _optics(data: dict[str, Any], source: str) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) with pixel centres at +0.5, from any of the three formats."""
    if "intrinsic_matrix" in data:
        return _open3d_optics(data["intrinsic_matrix"], source)
    if "ppx" in data:
        return _realsense_optics(data, source)
    fx, fy, cx, cy = (float(data[name]) for name in ("fx", "fy", "cx", "cy"))
    offset = 0.5 - float(data.get("pixel_centers_at", 0.5))
    return fx, fy, cx + offset, cy + offset


def _open3d_optics(matrix: Any, source: str) -> tuple[float, float, float, float]:
    """Open3D stores the intrinsic matrix column by column; some writers store it row by row."""
    K = np.array(matrix, float).reshape(3, 3)
    K = K.T if np.any(K[2, :2]) else K
    try:
        camera = Camera.from_K(K, 1, 1)
    except ReorientError as error:
        raise ReorientError(
            f"intrinsic_matrix in {source!r}: expected [fx 0 0 0 fy 0 cx cy 1], column by column, in pixels"
        ) from error
    return camera.fx, camera.fy, camera.cx, camera.cy


def _realsense_optics(data: dict[str, Any], source: str) -> tuple[float, float, float, float]:
    """RealSense counts pixel centres at integers, and states lens distortion as ``coeffs``."""
    if np.any(np.asarray(data.get("coeffs", 0.0), float) != 0):
        raise ReorientError(f"camera in {source!r} has lens distortion {data['coeffs']}: expected a rectified image")
    fx, fy, cx, cy = (float(data[name]) for name in ("fx", "fy", "ppx", "ppy"))
    return fx, fy, cx + 0.5, cy + 0.5
