"""The course of a loop as pictures for an animation: the remaining angle up to each image."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reorient.reporting.pictures import BACKGROUND, INK

_TRUE, _PREDICTED = (86, 180, 233), (230, 159, 0)  # of the palette of Okabe and Ito, on dark
_GRID = (53, 56, 69)
_FINER = 4  # drawn larger by this factor and reduced, so that lines have no steps
_LEFT, _TOP, _RIGHT, _BOTTOM = 0.17, 0.04, 0.97, 0.84  # of the axes, of the side of the picture
_HEAD = 1.08  # free above the largest angle
_DASH, _GAP = 0.02, 0.014  # of the predicted line, of the side
_MOST_TICKS = 6


class _Axes:
    """The square picture, and the place of a point of the curve in it."""

    def __init__(self, images: int, largest_deg: float, size_px: int) -> None:
        self.side = _FINER * size_px
        self.last = max(images - 1, 1)
        self.top_deg = _HEAD * max(largest_deg, 1.0)

    def at(self, image: float, angle_deg: float) -> tuple[float, float]:
        """Column and row of an angle at an image, pixels."""
        along, up = 0.03 + 0.94 * image / self.last, angle_deg / self.top_deg
        return self.side * (_LEFT + along * (_RIGHT - _LEFT)), self.side * (_BOTTOM - up * (_BOTTOM - _TOP))

    def empty(self, labels: dict[str, tuple[int, int, int]]) -> Image.Image:
        """Grid, ticks, and a legend of these names and colours."""
        picture = Image.new("RGB", (self.side, self.side), BACKGROUND)
        draw, font = ImageDraw.Draw(picture), ImageFont.load_default(0.042 * self.side)
        left, top, right, bottom = (self.side * x for x in (_LEFT, _TOP, _RIGHT, _BOTTOM))
        thin = max(self.side // 300, 1)
        for angle in ticks(self.top_deg):
            row = self.at(0, angle)[1]
            draw.line((left, row, right, row), _GRID, thin)
            draw.text((left - 0.02 * self.side, row), f"{angle:g}°", INK, font, anchor="rm")
        for image in ticks(self.last, whole=True):
            column = self.at(image, 0)[0]
            draw.line((column, top, column, bottom), _GRID, thin)
            draw.text((column, bottom + 0.02 * self.side), f"{image:g}", INK, font, anchor="mt")
        draw.line((left, top, left, bottom, right, bottom), INK, thin)
        draw.text(((left + right) / 2, 0.985 * self.side), "images", INK, font, anchor="mb")
        row = top + 0.03 * self.side
        for label, colour in labels.items():
            draw.text((right, row), label, INK, font, anchor="rm")
            end = right - draw.textlength(label, font) - 0.02 * self.side
            draw.line((end - 0.07 * self.side, row, end, row), colour, 3 * thin)
            row += 0.06 * self.side
        return picture


def growing_curve(predicted_deg: Sequence[float], true_deg: Sequence[float], size_px: int) -> list[Image.Image]:
    """For each image of a loop, the remaining angle up to it, predicted and (where known) true, on a dark square."""
    axes = _Axes(max(len(predicted_deg), len(true_deg)), max(*predicted_deg, *true_deg, 0.0), size_px)
    empty = axes.empty(({"true angle": _TRUE} if true_deg else {}) | {"predicted": _PREDICTED})
    frames = []
    for count in range(1, len(predicted_deg) + 1):
        picture = empty.copy()
        draw = ImageDraw.Draw(picture)
        true = [axes.at(i, angle) for i, angle in enumerate(true_deg[:count])]
        predicted = [axes.at(i, angle) for i, angle in enumerate(predicted_deg[:count])]
        if len(true) > 1:
            draw.line(true, _TRUE, axes.side // 90, joint="curve")
        for dash in _dashes(predicted, axes.side):
            draw.line(dash, _PREDICTED, axes.side // 200)
        for points, colour, radius in ((true, _TRUE, axes.side / 70), (predicted, _PREDICTED, axes.side / 110)):
            for column, row in points[-1:]:
                draw.ellipse((column - radius, row - radius, column + radius, row + radius), colour)
        frames.append(picture.resize((size_px, size_px), Image.Resampling.BOX))
    return frames


def ticks(end: float, whole: bool = False) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from 0 to ``end``, at most seven; ``whole``: of whole numbers."""
    power = 10.0 ** np.floor(np.log10(end / _MOST_TICKS))
    if whole:
        power = max(power, 1.0)
    step = next(step for step in power * np.array([1, 2, 5, 10]) if step * _MOST_TICKS >= end)
    return [float(x) for x in step * np.arange(np.floor(end / step + 1e-9) + 1)]


def _dashes(points: Sequence[tuple[float, float]], side: int) -> list[tuple[float, ...]]:
    """The dashes of a line through points."""
    dash, period = _DASH * side, (_DASH + _GAP) * side
    lines = []
    for start, end in pairwise(np.array(points)):
        length = float(np.linalg.norm(end - start))
        for at in np.arange(0, length, period):
            first, last = (start + (end - start) * min(x / length, 1.0) for x in (at, at + dash))
            lines.append((*map(float, first), *map(float, last)))
    return lines
