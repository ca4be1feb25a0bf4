"""Depth images and masks on disk.

Depth: 16-bit PNG, TIFF and PGM, integer .npy and .npz (metres per unit from the image, else from the camera file, else
0.001); float TIFF, PFM, EXR, .npy and .npz in metres; points from .pcd, .ply and arrays (height, width, 3).
"""

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, PngImagePlugin, TiffImagePlugin

from reorient.errors import ReorientError
from reorient.imaging.camera import Camera
from reorient.imaging.depth_arrays import READERS, SCALE_M, TIFF_DESCRIPTION, read_arrays
from reorient.imaging.depth_image import NO_RETURN, DepthImage, is_metres
from reorient.imaging.documents import existing, refuse_pickle
from reorient.imaging.intrinsic_fields import Intrinsics
from reorient.imaging.intrinsics import camera_data, fitted, intrinsics_from, read_camera, read_intrinsics, write_camera
from reorient.runs.files import replacing

__all__ = ["read_camera", "read_depth", "read_mask", "write_camera", "write_depth"]
_NOTES = logging.getLogger(__name__)
WRITTEN = (".png", ".npy", ".npz", ".tif", ".tiff")
CameraChoice = Camera | Intrinsics | str | Path | None
"""A camera, a camera file, or what ``read_intrinsics`` returned for one, to read many images with it."""


def read_depth(path: str | Path, camera: CameraChoice = None, scale_m: float | None = None) -> DepthImage:
    """A depth image from .png, .tif(f), .npy, .npz, .exr, .pgm, .pfm, .pcd or .ply.

    ``camera``: intrinsics or a file of them (docs/formats.md), overriding those in the image; needed where the image
    has none. A file may lack the image size; where it is for another resolution of the same aspect ratio, it is scaled
    and a note is logged. Its lens distortion is undone by nearest neighbour, with a note; pixels without source become
    unknown.
    ``scale_m``: metres per unit of integer depth, and of floats that are no metres (all above 20); by default the
    image's own, else the camera file's, else 0.001. In unsigned 16 bits 65535 is no return.
    Raises ReorientError for a missing, truncated or unknown file, missing intrinsics or intrinsics of another aspect
    ratio, a distortion of an unknown model, and whatever DepthImage refuses.
    """
    path = existing(path, "depth image")
    if path.suffix.lower() not in READERS:
        refuse_pickle(path)
        raise ReorientError(f"depth image {str(path)!r}: expected one of {', '.join(READERS)}")
    if scale_m is not None:
        _check_scale(scale_m)
    array, stated = read_arrays(path)
    intrinsics = _intrinsics(path, array, stated, camera)
    scale_m = next((x for x in (scale_m, stated.get("scale_m"), intrinsics.scale_m) if x is not None), None)
    depth, unknown = _metres(array, None if scale_m is None else _check_scale(scale_m))
    pinhole, stamp_s = intrinsics.camera(), stated.get("stamp_s")
    try:
        if array.shape[-1:] == (3,) and array.shape != (pinhole.height, pinhole.width):
            return DepthImage.from_points(depth, pinhole, stamp_s)
        if intrinsics.distortion:
            if not isinstance(camera, Intrinsics):  # else it is one of many
                _NOTES.warning(
                    "note: the lens distortion of %r is undone; boxes are in the pixels of that image", str(path)
                )
            depth = intrinsics.distortion.undone(depth, pinhole, np.nan)
            unknown = intrinsics.distortion.undone(unknown, pinhole, True)
        return DepthImage(depth, pinhole, stamp_s, unknown)
    except ReorientError as error:
        cure = "; give the scale (--depth-scale 0.001)" if "millimetres" in str(error) else ""
        raise ReorientError(f"depth image {str(path)!r}: {error}{cure}") from error


def read_mask(path: str | Path, camera: CameraChoice = None) -> np.ndarray:
    """A boolean (height, width) mask: true where the .npy array, or any colour channel of the picture, is not zero.

    Of an RGBA picture with transparent pixels (a cut-out) it is where the picture is at least half opaque. ``camera``:
    that of its depth image. Where it is a file with lens distortion, the mask is undistorted in the same way. Raises
    ReorientError for a missing or broken file.
    """
    path = existing(path, "mask")
    refuse_pickle(path)
    try:
        mask = _mask(path)
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ReorientError(f"cannot read mask {str(path)!r} ({reason}): expected a picture or a .npy array") from error
    if not isinstance(camera, Intrinsics | str | Path) or mask.ndim != 2:
        return mask
    intrinsics = _intrinsics(path, mask, {}, camera)
    return intrinsics.distortion.undone(mask, intrinsics.camera(), False) if intrinsics.distortion else mask


def _mask(path: Path) -> np.ndarray:
    if path.suffix.lower() == ".npy":
        return np.asarray(np.load(path, allow_pickle=False) != 0)
    with Image.open(path) as picture:
        if picture.mode != "P" and len(picture.getbands()) == 1:  # RGB would clip its numbers
            return np.asarray(np.asarray(picture) != 0)
        rgba = np.asarray(picture.convert("RGBA"))
        opaque = rgba[..., 3] >= 128
        is_cut_out = picture.mode == "RGBA" and opaque.any() and rgba[..., 3].min() == 0
        return np.asarray(opaque if is_cut_out else rgba[..., :3].max(axis=-1) > 0)


def write_depth(path: str | Path, image: DepthImage, scale_m: float = SCALE_M) -> None:
    """Write .png (16-bit, rounded to ``scale_m``), .tif(f) (float32), .npy or .npz; all but .npy contain the camera.

    Unknown pixels are 65535 in .png and NaN elsewhere. Raises ReorientError for another suffix, for a scale not above
    0 and for depth above 65534 units.
    """
    path = Path(path)
    _check_scale(scale_m)
    stated: dict[str, Any] = {"camera": camera_data(image.camera)}
    if image.stamp_s is not None:
        stated["stamp_s"] = image.stamp_s
    suffix = path.suffix.lower()
    if suffix not in WRITTEN:
        raise ReorientError(f"cannot write depth as {path.name!r}: expected one of {', '.join(WRITTEN)}")
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
            tags[TIFF_DESCRIPTION] = json.dumps(stated)
            Image.fromarray(depth_m).save(temporary, tiffinfo=tags)
        else:
            with temporary.open("wb") as file:  # given a name, numpy appends ".npz" to ".NPZ"
                if suffix == ".npz":
                    np.savez_compressed(file, depth_m=depth_m, stated=json.dumps(stated))
                else:
                    np.save(file, depth_m)


def _intrinsics(path: Path, array: np.ndarray, stated: dict[str, Any], camera: CameraChoice) -> Intrinsics:
    """The intrinsics for an array: those given, else those of its own file."""
    if isinstance(camera, Camera):
        return Intrinsics(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    if camera is None and "camera" not in stated:
        raise ReorientError(f"missing intrinsics for {str(path)!r}: expected a camera file (--camera camera.json)")
    organised = array.shape[-1:] != (3,) or array.ndim == 3
    size = (array.shape[1], array.shape[0]) if organised else None
    if camera is None:
        return intrinsics_from(stated["camera"], str(path))
    known = isinstance(camera, Intrinsics)
    intrinsics = camera if isinstance(camera, Intrinsics) else read_intrinsics(camera, size, path)
    if size is not None:
        return fitted(intrinsics, size, "the camera" if known else str(camera), str(path))
    if intrinsics.width is None or intrinsics.height is None:
        raise ReorientError(
            f"{str(path)!r} holds {len(array)} points in no order, and its camera has no image size: expected width "
            "and height in the camera file"
        )
    return intrinsics


def _metres(array: np.ndarray, scale_m: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Depth or points in metres, and the pixels without return of unsigned 16-bit depth."""
    if array.dtype.kind in "iu":
        if array.dtype.itemsize == 1:
            raise ReorientError(f"depth of dtype {array.dtype}: expected 16 bits or more, 8 have no useful resolution")
        unknown = (array == NO_RETURN) & (array.dtype == np.uint16)
        return array * (SCALE_M if scale_m is None else scale_m), unknown
    depth = array[..., 2] if array.ndim == 3 else array
    with np.errstate(invalid="ignore"):
        returns = depth[(depth > 0) & np.isfinite(depth)]
    if scale_m is not None and len(returns) and not is_metres(returns):
        array = array * scale_m
    return array, np.zeros(array.shape[:2], bool)


def _check_scale(scale_m: Any) -> float:
    if not (isinstance(scale_m, int | float) and 0 < scale_m < np.inf):
        raise ReorientError(f"depth scale {scale_m!r}: expected metres per unit, above 0")
    return float(scale_m)
