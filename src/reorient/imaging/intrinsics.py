"""Intrinsics of a camera file, whichever tool wrote it, for one image (docs/formats.md lists the tools)."""

import json
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from reorient.errors import ReorientError
from reorient.imaging.camera import FOCAL_PX, Camera
from reorient.imaging.documents import existing, read_document
from reorient.imaging.intrinsic_fields import Fields, Intrinsics, bare, distortion_of, has_focal_length, intrinsics_of
from reorient.runs.files import replacing

_DEEPEST = 6  # levels at which a camera is looked for
_ASPECT = 0.01  # largest relative difference of the two scales of an image that was resized as a whole
_CENTRAL = 0.2  # shares of the width and height within which the principal point of an image that is no crop lies
_LEAST_FOCAL = 3.0  # px; in units of the image's width or height they are below
_NOTES = logging.getLogger(__name__)
_EXPECTED = (
    "expected fx, fy, cx, cy or a 3 x 3 matrix K, as of reorient, OpenCV, ROS, RealSense, Open3D, BOP, Azure Kinect, "
    "nerfstudio or autolab (docs/formats.md)"
)
# Azure Kinect: the part of the 1024 x 1024 depth sensor in each mode, by the size of its image: the size of the
# (binned) sensor, left, top. Colour: the 4:3 sensor, of which 16:9 images lack rows above and below.
_DEPTH_MODES = {
    (640, 576): (1024, 192, 180),
    (320, 288): (512, 96, 90),
    (512, 512): (512, 0, 0),
    (1024, 1024): (1024, 0, 0),
}
_COLOR_WIDTHS = (1280, 1920, 2560, 2048, 3840, 4096)


def read_camera(path: str | Path, width: int | None = None, height: int | None = None) -> Camera:
    """The camera of a camera file: JSON, YAML, XML, text, .mat, .npy, .npz or .intr (docs/formats.md).

    ``width``, ``height``: the image size, px, for files that state none. ``FILE#NAME`` chooses one of several cameras.
    Raises ReorientError for missing values, and for lens distortion, which ``read_depth`` undoes, given the file.
    """
    intrinsics = read_intrinsics(path, None if width is None or height is None else (width, height))
    if intrinsics.distortion:
        raise ReorientError(
            f"camera file {str(path)!r} states lens distortion: expected an undistorted camera; read_depth(image, "
            f"{Path(path).name!r}) undoes it"
        )
    return _explained(path, intrinsics, (width, height))


def read_pinhole(path: str | Path) -> Camera:
    """The camera of the images that ``read_depth`` makes with a camera file: as ``read_camera``, without the lens
    distortion, which it undoes."""
    return _explained(path, read_intrinsics(path), (None, None))


def _explained(path: str | Path, intrinsics: Intrinsics, size: tuple[int | None, int | None]) -> Camera:
    try:
        return intrinsics.camera(*size)
    except ReorientError as error:
        raise ReorientError(f"camera file {str(path)!r}: {error}") from error


def write_camera(path: str | Path, camera: Camera) -> None:
    """Write intrinsics as JSON in the format of reorient; pixel centres at +0.5."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(camera_data(camera), indent=2) + "\n", encoding="utf-8")


def camera_data(camera: Camera) -> dict[str, Any]:
    """The camera as JSON has it."""
    names = ("width", "height", "fx", "fy", "cx", "cy")
    return {name: getattr(camera, name) for name in names} | {"pixel_centers_at": 0.5}


def camera_from(data: Any, source: str) -> Camera:
    """An undistorted camera of parsed JSON. Raises ReorientError as ``read_camera``."""
    intrinsics = intrinsics_from(data, source)
    if intrinsics.distortion:
        raise ReorientError(f"camera in {source!r} states lens distortion: expected an undistorted camera")
    return _explained(source, intrinsics, (None, None))


def read_intrinsics(
    path: str | Path, size: tuple[int, int] | None = None, image: str | Path | None = None
) -> Intrinsics:
    """Everything that a camera file states. ``size`` (width, height) and ``image``, the file, choose among several.

    Raises ReorientError for a missing or broken file, for values that are missing or have no meaning, and where the
    file has several cameras of which none is chosen.
    """
    name = ""
    if not Path(path).exists():
        bare_path, _, name = str(path).rpartition("#")
        path = bare_path if bare_path and Path(bare_path).exists() else path
    file = existing(path, "camera file")
    return intrinsics_from(read_document(file), str(path), size, image, name)


def intrinsics_from(
    data: Any,
    source: str,
    size: tuple[int, int] | None = None,
    image: str | Path | None = None,
    name: str = "",
) -> Intrinsics:
    """As ``read_intrinsics``, from the content of the file ``source``."""
    try:
        if isinstance(data, Mapping) and "CalibrationInformation" in data:
            return _azure(data["CalibrationInformation"], size, name)
        cameras = {words: intrinsics_of(fields) for words, fields in _cameras(data)}
        if not cameras:
            raise ReorientError(f"missing intrinsics: {_EXPECTED}")
        return _chosen(cameras, size, image, name)
    except ReorientError as error:
        raise ReorientError(f"camera in {source!r}: {error}") from error
    except Exception as error:  # a document can hold anything, even text that is none
        raise ReorientError(f"camera in {source!r} has no intrinsics ({type(error).__name__}): {_EXPECTED}") from error


def fitted(intrinsics: Intrinsics, size: tuple[int, int], source: str, image: str) -> Intrinsics:
    """The intrinsics for an image of this (width, height), scaled where the file is for another resolution.

    Logs a note where they are scaled. Raises ReorientError for another aspect ratio, for a principal point beyond the
    image, where the file states no size, and for focal lengths that are no pixels.
    """
    width, height = size
    if FOCAL_PX[0] <= min(intrinsics.fx, intrinsics.fy) < _LEAST_FOCAL:
        raise ReorientError(
            f"camera file {source!r} has focal lengths ({intrinsics.fx:g}, {intrinsics.fy:g}): expected pixels; "
            "multiply normalised intrinsics by the width and the height of the image"
        )
    if intrinsics.width is None or intrinsics.height is None:
        if not (0 < intrinsics.cx < width and 0 < intrinsics.cy < height):
            raise ReorientError(
                f"camera file {source!r} has its principal point at ({intrinsics.cx:.1f}, {intrinsics.cy:.1f}), beyond "
                f"the {width} x {height} px of {image!r}: expected the intrinsics of this resolution"
            )
        if not all(_CENTRAL <= share <= 1 - _CENTRAL for share in (intrinsics.cx / width, intrinsics.cy / height)):
            _NOTES.warning(
                "note: the principal point (%.1f, %.1f) of camera file %r is far from the centre of the %d x %d px of "
                "%r: right only for a crop",
                *(intrinsics.cx, intrinsics.cy, source, width, height, image),
            )
        return replace(intrinsics, width=width, height=height)
    if (intrinsics.width, intrinsics.height) == size:
        return intrinsics
    sx, sy = width / intrinsics.width, height / intrinsics.height
    if abs(sx / sy - 1) > _ASPECT:
        raise ReorientError(
            f"camera file {source!r} is for {intrinsics.width} x {intrinsics.height} px, {image!r} has {width} x "
            f"{height}, another aspect ratio: expected the intrinsics of this resolution or crop"
        )
    _NOTES.warning(
        "note: camera file %r is for %d x %d px, scaled by %.4g to the %d x %d px of %r",
        *(source, intrinsics.width, intrinsics.height, sx, width, height, image),
    )
    camera = intrinsics.camera().resized(width, height)
    return replace(intrinsics, width=width, height=height, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)


def _cameras(
    data: Any, inherited: Fields | None = None, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Fields]]:
    """(place, fields) of every camera in a document; a place is the names that lead to it."""
    if len(words) > _DEEPEST:
        return
    if isinstance(data, list | tuple):
        yield from _cameras_of_list(data, inherited or {}, words)
    if not isinstance(data, Mapping):
        return
    fields = {bare(key): value for key, value in data.items()}
    both = {**(inherited or {}), **fields}
    if has_focal_length(fields):
        yield words, both
        return
    passed = {key: value for key, value in both.items() if not isinstance(value, Mapping)}
    for key, value in data.items():
        yield from _cameras(value, passed, (*words, str(key)))


def _cameras_of_list(
    data: Sequence[Any], inherited: Fields, words: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], Fields]]:
    """A list is a matrix at the top of a document, else perhaps frames, named by their picture or their place."""
    if not words and has_focal_length({"k": data}):
        yield words, {"k": data}
        return
    for index, item in enumerate(data):
        if isinstance(item, Mapping):
            yield from _cameras(item, inherited, (*words, Path(str(item.get("file_path", index))).stem))


def _chosen(
    cameras: dict[tuple[str, ...], Intrinsics], size: tuple[int, int] | None, image: str | Path | None, name: str
) -> Intrinsics:
    """One of the cameras: by the given name, the image's number, the image's size, or because it is the depth camera.

    Each rule counts where it leaves some; cameras with the same values are one.
    """
    if name:
        named = [one for words, one in cameras.items() if any(_same(name, word) for word in words)]
        if not named:
            raise ReorientError(f"no camera {name!r}: expected one of {_listed(cameras)}")
        return named[0]
    stem = Path(image).stem if image is not None else ""
    rules: tuple[Callable[[tuple[str, ...], Intrinsics], bool], ...] = (
        lambda words, one: bool(stem) and any(_same(stem, word) for word in words),
        lambda words, one: size is not None and (one.width, one.height) == size,
        lambda words, one: any("depth" in word.lower() for word in words),
    )
    left = cameras
    for rule in rules:
        left = {words: one for words, one in left.items() if rule(words, one)} or left
    if len(set(left.values())) > 1:
        raise ReorientError(
            f"several cameras: {_listed(left)}; expected one, chosen as FILE#NAME, or a depth image named by its number"
        )
    return next(iter(left.values()))


def _same(a: str, b: str) -> bool:
    """Whether two names are the same, or the same number: 000003 and 3."""
    return a.lower() == b.lower() or (a.isdecimal() and b.isdecimal() and a.lstrip("0") == b.lstrip("0"))


def _listed(cameras: dict[tuple[str, ...], Intrinsics]) -> str:
    names = ["/".join(words) for words in cameras]
    return ", ".join(names[:5]) + (f", ... ({len(names)} in all)" if len(names) > 5 else "")


def _azure(data: Any, size: tuple[int, int] | None, name: str) -> Intrinsics:
    """The raw calibration of an Azure Kinect: intrinsics over the sensor's size, of which an image shows a part."""
    if size is None:
        raise ReorientError(
            "the raw calibration of an Azure Kinect depends on the image: expected an image size with it"
        )
    if size in _DEPTH_MODES and not re.search("pv|color", name.lower()):
        location, (sensor, left, top) = "D0", _DEPTH_MODES[size]
        sensor_size = (sensor, sensor)
    elif size[0] in _COLOR_WIDTHS and size[1] <= size[0] * 3 // 4:
        location, sensor_size = "PV0", (size[0], size[0] * 3 // 4)
        left, top = 0, (sensor_size[1] - size[1]) // 2
    else:
        raise ReorientError(
            f"no mode of an Azure Kinect has {size[0]} x {size[1]} px: expected an unscaled image of one"
        )
    lens = {str(one["Location"])[-len(location) :]: one["Intrinsics"] for one in data["Cameras"]}[location]
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1 = map(float, lens["ModelParameters"])
    if codx or cody:
        raise ReorientError("a centre of distortion (codx, cody) is not understood: expected undistorted images")
    distortion = distortion_of(lens["ModelType"], [k1, k2, p1, p2, k3, k4, k5, k6])
    w, h = sensor_size
    return Intrinsics(fx * w, fy * h, cx * w - left, cy * h - top, *size, distortion, 0.001)
