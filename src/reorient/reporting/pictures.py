"""Pictures of depth images: shading, montages, GIFs, inline PNGs."""

import base64
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.registration.normals import fit_planes
from reorient.runs.files import replacing

BACKGROUND = (24, 27, 33)
INK = (214, 218, 226)
# sRGB tints from the nearest return to the farthest
_TINTS = np.array([(255, 226, 178), (244, 176, 132), (196, 132, 150), (112, 118, 176), (62, 92, 150)], float)
# unit vectors towards the lights, camera axes
_KEY, _FILL = (np.array(v) / np.linalg.norm(v) for v in ([-0.55, -0.75, -0.75], [0.9, 0.15, -0.5]))
_OUTLINE_PX = 0.6  # small enough to keep bars one pixel wide
_COLOURS = 128  # of a GIF
SUFFIXES = (".png", ".jpg", ".jpeg")
_RETURNED, _FILLED = np.array([80, 200, 120]), np.array([250, 170, 30])


def shade(image: DepthImage, size_px: int = 256, range_m: tuple[float, float] | None = None) -> Image.Image:
    """A shaded view of a depth image, centred on a square of ``size_px``: warm near, cold far, dark without return.

    ``range_m``: depths of the warmest and the coldest tint, to make pictures comparable; None: those of the image.
    """
    near_m, far_m = depth_range([image]) if range_m is None else range_m
    valid = image.valid
    share = np.clip((image.depth_m[valid] - near_m) / max(far_m - near_m, 1e-9), 0, 1) * (len(_TINTS) - 1)
    tint = np.stack([np.interp(share, np.arange(len(_TINTS)), channel) for channel in _TINTS.T], axis=-1)
    colours = np.zeros((*valid.shape, 3))
    colours[valid] = np.clip(tint * _light(image)[:, None], 0, 255)
    # colours are extended beyond the outline, so that enlarging blends no dark fringe into the object
    nearest = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    colours = colours[tuple(nearest)]

    scale = size_px / max(valid.shape)
    size = tuple(max(round(n * scale), 1) for n in valid.shape[::-1])
    object_rgb = Image.fromarray(colours.astype(np.uint8)).resize(size, Image.Resampling.BICUBIC)
    # smoothed before it is enlarged, so that the outline has no steps
    smooth = ndimage.gaussian_filter(valid.astype(float), _OUTLINE_PX)
    cover = Image.fromarray((255 * smooth).astype(np.uint8)).resize(size, Image.Resampling.BICUBIC)
    sharpness = max(scale, 1.0)  # an enlarged outline blurs over ``scale`` pixels
    cover = cover.point([int(np.clip(127.5 + (level - 127.5) * sharpness, 0, 255)) for level in range(256)])
    picture = Image.new("RGB", (size_px, size_px), BACKGROUND)
    picture.paste(object_rgb, ((size_px - size[0]) // 2, (size_px - size[1]) // 2), cover)
    return picture


def show_mask(image: DepthImage, mask: Bool[np.ndarray, "height width"], size_px: int = 256) -> Image.Image:
    """A scene (bright near, dark far) with a mask: green with a return, orange without; cropped around the mask."""
    near_m, far_m = depth_range([image])
    grey = np.where(image.valid, 170 - 120 * np.clip((image.depth_m - near_m) / max(far_m - near_m, 1e-9), 0, 1), 0)
    picture = np.repeat(grey[..., None], 3, axis=2)
    returned = mask & image.valid
    picture[returned] = picture[returned] / 2 + _RETURNED / 2
    picture[mask & ~image.valid] = _FILLED
    rows, columns = np.nonzero(mask)
    half = 0.6 * max(np.ptp(rows), np.ptp(columns)) + 1
    middle = (columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2
    box = tuple(round(x) for x in (middle[0] - half, middle[1] - half, middle[0] + half, middle[1] + half))
    return Image.fromarray(picture.astype(np.uint8)).crop(box).resize((size_px, size_px), Image.Resampling.NEAREST)


def depth_range(images: Sequence[DepthImage]) -> tuple[float, float]:
    """Nearest and farthest depth of several images, metres: the 1st and the 99th percentile."""
    depths = np.concatenate([image.depth_m[image.valid] for image in images])
    near_m, far_m = np.percentile(depths, [1, 99])
    return float(near_m), float(far_m)


def framed(images: Sequence[DepthImage], margin: float = 0.08) -> list[DepthImage]:
    """The images cropped to one square window per camera, around the returns of all its images."""
    windows = {}
    for camera in {image.camera for image in images}:
        seen = np.any([image.valid for image in images if image.camera == camera], axis=0)
        rows, columns = np.nonzero(seen.any(axis=1))[0], np.nonzero(seen.any(axis=0))[0]
        middle = (rows[0] + rows[-1] + 1) / 2, (columns[0] + columns[-1] + 1) / 2
        side = int(np.ceil(max(np.ptp(rows), np.ptp(columns)) * (1 + 2 * margin))) + 1
        corner = (round(middle[1] - side / 2), round(middle[0] - side / 2))
        # inside the frame where it fits: beyond the frame all is unknown
        left, top = (
            int(np.clip(at, 0, most - side)) if side <= most else at
            for at, most in zip(corner, (camera.width, camera.height), strict=True)
        )
        windows[camera] = (left, top, side, side)
    return [image.cropped(*windows[image.camera]) for image in images]


def montage(pictures: Sequence[Image.Image], columns: int, labels: Sequence[str] | None = None) -> Image.Image:
    """Pictures of equal size in rows, each with its label above it."""
    if not pictures or columns < 1 or (labels is not None and len(labels) != len(pictures)):
        raise ReorientError(
            f"{len(pictures)} pictures, {columns} columns, {len(labels or ())} labels: expected at least one picture "
            "and column, and a label for each picture or none"
        )
    if len({picture.size for picture in pictures}) > 1:
        raise ReorientError(f"pictures of sizes {sorted({p.size for p in pictures})}: expected one size")
    width, height = pictures[0].size
    text_px = max(11, round(width / 17))
    head = 0 if labels is None else round(text_px * 1.9)
    gap = max(2, width // 64)
    rows = -(-len(pictures) // columns)
    columns = min(columns, len(pictures))
    sheet = Image.new("RGB", (columns * (width + gap) - gap, rows * (height + head + gap) - gap), BACKGROUND)
    for index, picture in enumerate(pictures):
        left, top = index % columns * (width + gap), index // columns * (height + head + gap)
        sheet.paste(picture, (left, top + head))
        if labels is not None:
            sheet.paste(INK, (left, top), text_mask(labels[index], (width, head), text_px))
    return sheet


def write_gif(path: str | Path, frames: Sequence[Image.Image], frame_ms: int, last_frame_ms: int) -> None:
    """Write a looped GIF with one palette for all frames; the last frame is shown for ``last_frame_ms``."""
    if not frames:
        raise ReorientError("a GIF of no frames: expected at least one")
    # one palette for first, middle and last frames; dithering would flicker and compress badly
    sample = montage([frames[len(frames) * i // 5] for i in range(5)] + [frames[-1]], columns=3)
    palette = sample.quantize(
        _COLOURS, Image.Quantize.MEDIANCUT, kmeans=2
    )  # without k-means thin bright lines lose their hue
    first, *rest = (frame.convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    durations = [frame_ms] * len(rest) + [last_frame_ms]
    with replacing(path) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=rest, duration=durations, loop=0, optimize=True)


def check_suffix(path: Path) -> None:
    """Raise ReorientError for a file name that is no picture's."""
    if path.suffix.lower() not in SUFFIXES:
        raise ReorientError(f"cannot write a picture as {path.name!r}: expected one of {', '.join(SUFFIXES)}")


def png_data_uri(picture: Image.Image) -> str:
    """The picture as a PNG data URI."""
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def text_mask(text: str, size: tuple[int, int], text_px: int) -> Image.Image:
    """A mask with centred text, drawn large and reduced, because small type has uneven gaps."""
    width, height = (4 * n for n in size)
    mask = Image.new("L", (width, height))
    font = ImageFont.load_default(4 * text_px)
    ImageDraw.Draw(mask).text((width / 2, height / 2), text, 255, font, anchor="mm")
    return mask.resize(size, Image.Resampling.BOX)


def _light(image: DepthImage) -> Float[np.ndarray, " n"]:
    """Brightness (about 0.2 to 1.1) of every return under two lights."""
    normals = fit_planes(image).normals
    rays = image.camera.rays()[image.valid]
    towards = -rays / np.linalg.norm(rays, axis=1, keepdims=True)
    halfway = towards + _KEY
    halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
    key, fill = np.maximum(normals @ _KEY, 0), np.maximum(normals @ _FILL, 0)
    gleam = np.maximum(np.sum(normals * halfway, axis=1), 0) ** 24
    return np.asarray(0.24 + 0.68 * key + 0.2 * fill + 0.14 * gleam)
