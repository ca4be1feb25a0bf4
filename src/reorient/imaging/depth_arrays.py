"""Arrays of depth from the files that cameras, simulators and other tools write.

A reader returns the array as stored and what the file states beside it: ``camera`` (JSON), ``scale_m``, ``stamp_s``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from reorient.errors import ReorientError
from reorient.extras import import_extra
from reorient.imaging.documents import parse_json, refuse_pickle
from reorient.imaging.point_clouds import read_pcd, read_ply

SCALE_M = 0.001  # what RealSense and Open3D write into 16-bit files
TIFF_DESCRIPTION = 270
_EXR_CHANNELS = ("Z", "depth.Z", "Depth.Z", "ViewLayer.Depth.Z", "depth", "Y", "R", "V")
Read = tuple[Any, Any]


def read_arrays(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """The array of a file, (height, width) or points (height, width, 3), and what the file states beside it.

    Raises ReorientError for a broken file and for one that holds no depth.
    """
    refuse_pickle(path)
    try:
        array, stated = READERS[path.suffix.lower()](path)
    except ReorientError as error:
        raise ReorientError(f"{str(path)!r} {error}") from error
    except Exception as error:  # the decoders raise many kinds of errors on broken files
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ReorientError(f"cannot read depth image {str(path)!r} ({reason}): expected a complete file") from error
    if not (isinstance(array, np.ndarray) and array.dtype.kind in "fiu" and isinstance(stated, dict)):
        raise ReorientError(f"{str(path)!r} holds no depth: expected an array of numbers")
    return one_channel(array, str(path)), stated


def one_channel(array: np.ndarray, source: str) -> np.ndarray:
    """(height, width), also of (height, width, 1) and (1, height, width); points (height, width, 3) stay.

    Raises ReorientError for any other shape.
    """
    shape = array.shape
    if array.ndim == 3 and shape[2] == 1:
        return np.asarray(array[:, :, 0])
    if array.ndim == 3 and shape[0] == 1:
        return np.asarray(array[0])
    if array.ndim == 2 or (array.ndim == 3 and shape[2] == 3 and array.dtype.kind == "f"):
        return array
    raise ReorientError(
        f"depth image {source!r} has shape {shape}: expected one channel, (height, width), or floating-point points "
        "(height, width, 3)"
    )


def _read_npy(path: Path) -> Read:
    return _numbers(lambda: np.load(path, allow_pickle=False)), {}


def _read_npz(path: Path) -> Read:
    """``depth_m``, or the only array in it that can be an image."""
    with np.load(path, allow_pickle=False) as arrays:
        if "depth_m" in arrays:
            return arrays["depth_m"], parse_json(str(arrays["stated"])) if "stated" in arrays else {}
        images = [name for name in arrays if _numbers(lambda name=name: arrays[name]).ndim in (2, 3)]  # type: ignore[misc]
        if len(images) != 1:
            raise ReorientError(
                f"holds {', '.join(arrays) or 'nothing'}: expected an array depth_m, or one image alone"
            )
        return arrays[images[0]], {}


def _numbers(load: Callable[[], Any]) -> Any:
    """What a loader returns. Raises ReorientError for an array of Python objects, which only a pickle can hold."""
    try:
        return load()
    except ValueError as error:
        if "allow_pickle" in str(error) or "pickle" in str(error).lower():
            raise ReorientError(
                "holds pickled Python objects, which can run code when they are loaded: expected an array of numbers"
            ) from error
        raise


def _read_picture(path: Path) -> Read:
    with Image.open(path) as picture:
        if picture.mode not in ("I;16", "I;16B", "I", "F"):
            raise ReorientError(f"is a {picture.mode} picture: expected 16-bit depth with one channel")
        if path.suffix.lower() == ".png":
            stated = parse_json(picture.info.get("reorient", "{}"))
        else:
            description = picture.tag_v2.get(TIFF_DESCRIPTION, "")  # type: ignore[attr-defined]
            stated = parse_json(description) if description.startswith("{") else {}
        return np.array(picture), stated


def _read_pgm(path: Path) -> Read:
    """P5 or P2 of more than 8 bits; big-endian by definition."""
    words, body = _header(path.read_bytes(), 4)
    kind, width, height, largest = words[0], *map(int, words[1:])
    if kind not in (b"P5", b"P2") or largest < 256:
        raise ReorientError("is no PGM of 16 bits: expected P5 or P2 with a largest value above 255")
    if kind == b"P2":
        values = np.array(body.split()[: width * height], np.uint16)
    else:
        values = np.frombuffer(body, ">u2", width * height).astype(np.uint16)
    return values.reshape(height, width), {}


def _read_pfm(path: Path) -> Read:
    """Pf: float32, rows from the bottom; a negative scale means little-endian."""
    words, body = _header(path.read_bytes(), 4)
    kind, width, height, scale = words[0], int(words[1]), int(words[2]), float(words[3])
    if kind != b"Pf":
        raise ReorientError("is no PFM with one channel: expected Pf")
    values = np.frombuffer(body, "<f4" if scale < 0 else ">f4", width * height)
    return values.reshape(height, width)[::-1].astype(np.float32), {}


def _header(data: bytes, count: int) -> tuple[list[bytes], bytes]:
    """The first words of a Netpbm file, without comments, and what follows the one white space after them."""
    words: list[bytes] = []
    place = 0
    while len(words) < count:
        end = next(
            i for i in range(place, len(data) + 1) if data[i : i + 1].isspace() or data[i : i + 1] in (b"#", b"")
        )
        if end > place:
            words.append(data[place:end])
        if data[end : end + 1] == b"#":
            end = data.index(b"\n", end)
        if end >= len(data):
            raise ValueError("the header ends early")
        place = end + 1
    return words, data[place:]


def _read_exr(path: Path) -> Read:
    """The channel Z, or the one channel that there is, or three equal ones."""
    openexr = import_extra("OpenEXR")
    with openexr.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    name = next((name for name in _EXR_CHANNELS if name in channels), next(iter(channels), ""))
    colours = [channels[each] for each in ("R", "G", "B") if each in channels]
    different = any(not np.array_equal(colours[0], each, equal_nan=True) for each in colours[1:])
    if not channels or (name not in _EXR_CHANNELS[:5] and (different or (len(channels) > 1 and not colours))):
        raise ReorientError(f"holds the channels {', '.join(channels)}: expected Z, or one channel alone")
    return channels[name].astype(np.float32), {}


READERS: dict[str, Callable[[Path], Read]] = {
    ".png": _read_picture,
    ".npy": _read_npy,
    ".npz": _read_npz,
    ".tif": _read_picture,
    ".tiff": _read_picture,
    ".exr": _read_exr,
    ".pgm": _read_pgm,
    ".pfm": _read_pfm,
    ".pcd": lambda path: (read_pcd(path), {}),
    ".ply": lambda path: (read_ply(path), {}),
}
"""By suffix, lower case."""
