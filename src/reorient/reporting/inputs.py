"""A picture of how objects were isolated: the raw frames, with what was kept, removed, and is unknown."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from reorient.imaging import DepthImage
from reorient.imaging.summary import Summary
from reorient.reporting.pictures import BACKGROUND, INK, depth_range

KEPT, UNKNOWN = (0, 158, 115), (230, 159, 0)  # from the palette of Okabe and Ito
_WIDTH_PX, _GAP_PX, _LINE_PX = 480, 6, 26
_MARGIN = 0.35  # around the object in the lower picture, of its larger extent


def picture(frames: Sequence[tuple[str, DepthImage, DepthImage]]) -> Image.Image:
    """A column for each frame, (title, raw, isolated): the whole frame, and the surroundings of the object.

    Grey: removed returns, near ones bright; green: the object; orange: unknown; black: no return, not the object.
    """
    columns = [_column(*frame) for frame in frames]
    height = max(column.height for column in columns)
    width = len(columns) * (_WIDTH_PX + _GAP_PX) - _GAP_PX
    sheet = Image.new("RGB", (width, height + _LINE_PX), BACKGROUND)
    for i, column in enumerate(columns):
        sheet.paste(column, (i * (_WIDTH_PX + _GAP_PX), 0))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    left = 8.0
    for label, colour in (("object", KEPT), ("unknown", UNKNOWN), ("removed", (150, 150, 150))):
        draw.rectangle((left, height + 6, left + 14, height + 20), colour)
        draw.text((left + 20, height + 4), label, INK, font)
        left += 40 + draw.textlength(label, font)
    return sheet


def _column(title: str, raw: DepthImage, isolated: DepthImage) -> Image.Image:
    whole = Image.fromarray(coloured(raw, isolated))
    rows, columns = np.nonzero(isolated.valid)
    half = (0.5 + _MARGIN) * max(np.ptp(rows), np.ptp(columns)) + 4
    middle = (rows.min() + rows.max()) / 2, (columns.min() + columns.max()) / 2
    window = (middle[1] - half, middle[0] - half * 0.75, middle[1] + half, middle[0] + half * 0.75)
    near = whole.crop(tuple(round(x) for x in window)).resize(
        (_WIDTH_PX, round(_WIDTH_PX * 0.75)), Image.Resampling.NEAREST
    )
    whole = whole.resize((_WIDTH_PX, round(_WIDTH_PX * whole.height / whole.width)), Image.Resampling.NEAREST)
    column = Image.new("RGB", (_WIDTH_PX, _LINE_PX + whole.height + _GAP_PX + near.height), BACKGROUND)
    ImageDraw.Draw(column).text((4, 4), f"{title}: {Summary.of(isolated)}", INK, ImageFont.load_default(15))
    column.paste(whole, (0, _LINE_PX))
    column.paste(near, (0, _LINE_PX + whole.height + _GAP_PX))
    return column


def coloured(raw: DepthImage, isolated: DepthImage | None) -> UInt8[np.ndarray, "height width 3"]:
    """The raw frame in grey, the object green, unknown pixels orange; ``isolated`` None: no object was found."""
    near_m, far_m = depth_range([raw])
    grey = np.where(raw.valid, 190 - 140 * np.clip((raw.depth_m - near_m) / max(far_m - near_m, 1e-9), 0, 1), 0)
    colours = np.repeat(grey[..., None], 3, axis=2)
    if isolated is not None:
        kept_near_m, kept_far_m = depth_range([isolated])
        share = np.clip((raw.depth_m - kept_near_m) / max(kept_far_m - kept_near_m, 1e-9), 0, 1)
        kept = isolated.valid
        colours[kept] = np.array(KEPT) * (1.4 - 0.9 * share[kept, None])
        colours[isolated.unknown] = np.array(UNKNOWN) * (0.6 + 0.4 * ~raw.valid[isolated.unknown, None])
    return np.asarray(np.clip(colours, 0, 255).astype(np.uint8))
