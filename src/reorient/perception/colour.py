"""Colours as hue, saturation and value, and ranges of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage

from reorient.errors import ReorientError

_FEWEST = 200  # pixels to learn a range from
_SHARE = 0.95  # of the pixels that a learned range holds, in hue and in saturation
_GREY = 0.15  # below this median saturation hue is noise, and any will do
_MORE = 0.05  # a learned range reaches this much further in saturation
_BINS = 16  # of a table of colours, in each of red, green, blue
_CLEARLY = 3.0  # times as common in a thing as in what surrounds it is its own
_RAREST = 0.01  # of the density of a thing's commonest colour: what is rarer is not its own


def hsv_from_rgb(rgb: UInt8[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Hue in degrees [0, 360), saturation and value in [0, 1]."""
    x = rgb.astype(float) / 255
    value, low = x.max(axis=-1), x.min(axis=-1)
    chroma = value - low
    safe = np.where(chroma > 0, chroma, 1)
    r, g, b = np.moveaxis(x, -1, 0)
    sector = np.select([value == r, value == g], [(g - b) / safe % 6, (b - r) / safe + 2], (r - g) / safe + 4)
    return np.stack([60 * sector * (chroma > 0), chroma / np.where(value > 0, value, 1), value], axis=-1)


@dataclass(frozen=True)
class ColourRange:
    """A box in hue, saturation and value. Raises ReorientError for limits that are none."""

    hue_deg: tuple[float, float] = (0.0, 360.0)
    """From, to, eastwards: (350, 10) is around red."""
    saturation: tuple[float, float] = (0.0, 1.0)
    value: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        if not all(0 <= hue <= 360 for hue in self.hue_deg) or not all(
            0 <= low <= high <= 1 for low, high in (self.saturation, self.value)
        ):
            raise ReorientError(
                f"colour range hue {self.hue_deg}, saturation {self.saturation}, value {self.value}: expected degrees "
                "from 0 to 360, and 0 <= low <= high <= 1"
            )

    def contains(self, rgb: UInt8[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Which colours lie in the range."""
        hue, saturation, value = np.moveaxis(hsv_from_rgb(rgb), -1, 0)
        low, high = self.hue_deg
        in_hue = (hue >= low) & (hue <= high) if low <= high else (hue >= low) | (hue <= high)
        return (
            in_hue
            & (saturation >= self.saturation[0])
            & (saturation <= self.saturation[1])
            & (value >= self.value[0])
            & (value <= self.value[1])
        )

    @classmethod
    def learned(cls, rgb: UInt8[np.ndarray, "n 3"]) -> "ColourRange":
        """The range of nearly all of these colours: the shortest arc of hue, unless they are grey, and saturation.

        Value is left free, as it changes with the light. Raises ReorientError for too few.
        """
        if len(rgb) < _FEWEST:
            raise ReorientError(f"{len(rgb)} pixels to learn a colour from: expected at least {_FEWEST} of the gripper")
        hue, saturation, _ = np.moveaxis(hsv_from_rgb(rgb), -1, 0)
        low, high = np.quantile(saturation, [(1 - _SHARE) / 2, (1 + _SHARE) / 2])
        if np.median(saturation) < _GREY:
            return cls(saturation=(0.0, min(float(high) + _MORE, 1.0)))
        return cls(_shortest_arc(hue), (max(float(low) - _MORE, 0.0), min(float(high) + _MORE, 1.0)))


@dataclass(frozen=True, eq=False)
class ColourTable:
    """The colours that are one thing's rather than those of what surrounds it."""

    own: Bool[np.ndarray, "red green blue"]
    """By bins of red, green and blue."""

    @classmethod
    def learned(cls, rgb: UInt8[np.ndarray, "n 3"], others: UInt8[np.ndarray, "m 3"]) -> "ColourTable":
        """From pixels of the thing and of what surrounds it; light and shade between those seen count as well."""
        density, other_density = (_density(pixels) for pixels in (rgb, others))
        return cls((density > _CLEARLY * other_density) & (density > _RAREST * density.max()))

    def contains(self, rgb: UInt8[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Which colours are the thing's."""
        return self.own[tuple(np.moveaxis(rgb // (256 // _BINS), -1, 0))]


def _density(rgb: UInt8[np.ndarray, "n 3"]) -> Float[np.ndarray, "red green blue"]:
    """A smoothed histogram; all zero for no pixels."""
    counts, _ = np.histogramdd(rgb, bins=_BINS, range=[(0, 256)] * 3)
    return ndimage.gaussian_filter(counts / max(len(rgb), 1), 1.0, mode="constant")


def _shortest_arc(hue_deg: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """The shortest arc that holds the learned share of the hues."""
    hue = np.sort(hue_deg)
    count = int(np.ceil(_SHARE * len(hue)))
    ends = np.concatenate([hue, hue + 360])[count - 1 : count - 1 + len(hue)]
    first = int(np.argmin(ends - hue))
    return float(hue[first]), float(ends[first] % 360)
