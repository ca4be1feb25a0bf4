"""Depth images and intrinsics on disk.

Depth: 16-bit PNG and TIFF (the scale, metres per unit, is stated in the file when we write it, 0.001 when a file says
nothing), float TIFF, .npy and .npz in metres. Intrinsics: JSON as reorient, Open3D or RealSense write it.
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
_TIFF_DESCRIPTION = 270


def read_camera(path: str | Path) -> Camera:
    """Intrinsics from JSON: Open3D (``intrinsic_matrix``), RealSense (``ppx``, ``ppy``), or our own (``cx``, ``cy``).

    Open3D and RealSense count pixel centres at integers, so 0.5 is added to their principal point; our own files count
    them at +0.5. Raises ReorientError for what is missing and for lens distortion, which must be rectified before.
    """
    text = _existing(path, "camera file").read_text(errors="replace")
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise ReorientError(f"camera file {str(path)!r} is not JSON ({error}): expected intrinsics") from error
    return camera_from(data, str(path))


def write_camera(path: str | Path, camera: Camera) -> None:
    """Our own JSON style; pixel centres at +0.5."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(_camera_data(camera), indent=2) + "\n")


def read_depth(path: str | Path, camera: Camera | None = None, scale_m: float | None = None) -> DepthImage:
    """A depth image from .png, .tif(f), .npy or .npz.

    ``camera``: its intrinsics, overriding what the file states; needed where it states none. ``scale_m``: metres per
    unit of integer depth, overriding the file's own; floats are metres whatever it is. Raises ReorientError for a
    missing, truncated or unknown file, missing intrinsics, and whatever DepthImage refuses.
    """
    path = _existing(path, "depth image")
    if path.suffix.lower() not in SUFFIXES:
        raise ReorientError(f"depth image {str(path)!r}: expected one of {', '.join(SUFFIXES)}")
    if scale_m is not None:
        _check_scale(scale_m)
    try:
        depth, stated = _read_arrays(path)
    except ReorientError:
        raise
    except Exception as error:  # decoders raise whatever they like on broken files
        raise ReorientError(
            f"cannot read depth image {str(path)!r} ({type(error).__name__}: {error}): expected a complete file"
        ) from error
    if camera is None and "camera" in stated:
        camera = camera_from(stated["camera"], str(path))
    if camera is None:
        raise ReorientError(f"missing intrinsics for {str(path)!r}: expected a camera file (--camera camera.json)")
    if depth.ndim != 2:
        raise ReorientError(f"depth image {str(path)!r} has shape {depth.shape}: expected one channel, (height, width)")
    integer = np.issubdtype(depth.dtype, np.integer)
    if integer and (scale_m is not None or "scale_m" in stated):
        scale_m = stated["scale_m"] if scale_m is None else scale_m
        depth = depth * _check_scale(scale_m)
    try:
        return DepthImage(depth, camera, stated.get("stamp_s"))
    except ReorientError as error:
        if integer or scale_m is None:
            raise
        raise ReorientError(f"{error}; a scale is for integers, but {str(path)!r} holds {depth.dtype}") from error


def write_depth(path: str | Path, image: DepthImage, scale_m: float = SCALE_M) -> None:
    """Write .png (16-bit, rounded to ``scale_m``), .tif(f) (float32), .npy or .npz; all but .npy carry the camera.

    Raises ReorientError for another suffix, for a scale not above 0 and for depth beyond 65535 units.
    """
    path = Path(path)
    _check_scale(scale_m)
    stated: dict[str, Any] = {"camera": _camera_data(image.camera)}
    if image.stamp_s is not None:
        stated["stamp_s"] = image.stamp_s
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ReorientError(f"cannot write depth as {path.name!r}: expected one of {', '.join(SUFFIXES)}")
    with replacing(path) as temporary:
        if suffix == ".png":
            units = np.rint(image.depth_m.astype(np.float64) / scale_m)
            if units.max() > 65535:
                raise ReorientError(f"depth of {image.depth_m.max():.2f} m does not fit 16 bits of {scale_m} m each")
            text = PngImagePlugin.PngInfo()
            text.add_text("reorient", json.dumps(stated | {"scale_m": scale_m}))
            Image.fromarray(units.astype(np.uint16)).save(temporary, pnginfo=text)
        elif suffix in (".tif", ".tiff"):
            tags = TiffImagePlugin.ImageFileDirectory_v2()
            tags[_TIFF_DESCRIPTION] = json.dumps(stated)
            Image.fromarray(image.depth_m).save(temporary, tiffinfo=tags)
        else:
            with temporary.open("wb") as file:  # given a name, numpy adds ".npz" to ".NPZ"
                if suffix == ".npz":
                    np.savez_compressed(file, depth_m=image.depth_m, stated=json.dumps(stated))
                else:
                    np.save(file, image.depth_m)


def read_mask(path: str | Path) -> np.ndarray:
    """A boolean (height, width) mask, true where the .npy array or any colour of the picture is not zero."""
    path = _existing(path, "mask")
    try:
        if path.suffix == ".npy":
            return np.load(path) != 0
        with Image.open(path) as picture:
            if picture.mode != "P" and len(picture.getbands()) == 1:  # numbers, which RGB would clip
                return np.asarray(picture) != 0
            return np.asarray(picture.convert("RGB")).max(axis=-1) > 0  # without transparency
    except Exception as error:
        raise ReorientError(f"cannot read mask {str(path)!r} ({error}): expected a picture or a .npy array") from error


def _existing(path: str | Path, what: str) -> Path:
    path = Path(path)
    if not path.is_file():
        raise ReorientError(f"no {what} at {str(path)!r}: expected an existing file")
    return path


def _check_scale(scale_m: Any) -> float:
    if not (isinstance(scale_m, int | float) and 0 < scale_m < np.inf):
        raise ReorientError(f"depth scale {scale_m!r}: expected metres per unit, above 0")
    return float(scale_m)


def _read_arrays(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """The array as stored, and what the file states: camera, scale_m, stamp_s."""
    suffix = path.suffix.lower()
    stated: Any = {}
    if suffix == ".npy":
        array = np.load(path)
    elif suffix == ".npz":
        with np.load(path) as arrays:
            if "depth_m" not in arrays:
                raise ReorientError(f"{str(path)!r} holds {', '.join(arrays)}: expected an array depth_m")
            array = arrays["depth_m"]
            stated = json.loads(str(arrays["stated"])) if "stated" in arrays else {}
    else:
        array, stated = _read_picture(path)
    if not (isinstance(array, np.ndarray) and array.dtype.kind in "fiu" and isinstance(stated, dict)):
        raise ReorientError(f"{str(path)!r} holds no depth: expected an array of numbers")
    return array, stated


def _read_picture(path: Path) -> tuple[np.ndarray, Any]:
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
    """Intrinsics from JSON that is read already, of the file ``source``; otherwise as ``read_camera``."""
    if not isinstance(data, dict):
        raise ReorientError(f"camera in {source!r}: expected a JSON object with width, height and intrinsics")
    offset = 0.5
    try:
        size = int(data["width"]), int(data["height"])
        if size != (float(data["width"]), float(data["height"])):
            raise ReorientError(
                f"camera in {source!r} of {data['width']} x {data['height']} px: expected whole numbers"
            )
        if "intrinsic_matrix" in data:  # Open3D, column-major
            K = np.array(data["intrinsic_matrix"], float).reshape(3, 3)
            K = K if np.any(K[2, :2]) else K.T  # some writers store rows
            if np.any(K[[0, 1, 0, 1], [1, 0, 2, 2]]) or K[2, 2] != 1:
                raise ReorientError(
                    f"intrinsic_matrix in {source!r}: expected [fx 0 0 0 fy 0 cx cy 1], column by column"
                )
            (fx, fy), (cx, cy) = np.diag(K)[:2].tolist(), K[2, :2].tolist()
        elif "ppx" in data:  # RealSense
            if np.any(np.asarray(data.get("coeffs", 0.0), float) != 0):
                raise ReorientError(
                    f"camera in {source!r} has lens distortion {data['coeffs']}: expected a rectified image"
                )
            fx, fy, cx, cy = (float(data[name]) for name in ("fx", "fy", "ppx", "ppy"))
        else:
            fx, fy, cx, cy = (float(data[name]) for name in ("fx", "fy", "cx", "cy"))
            offset = 0.5 - float(data.get("pixel_centers_at", 0.5))
    except ReorientError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ReorientError(
            f"missing intrinsics in {source!r} ({error}): expected width, height and fx, fy, cx, cy, or an Open3D "
            "intrinsic_matrix, or RealSense's ppx, ppy"
        ) from error
    return Camera(*size, fx, fy, cx + offset, cy + offset)
