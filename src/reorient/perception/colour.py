"""Colours as hue, saturation and value; ranges and tables of colours."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage

from reorient.errors import ReorientError

_FEWEST = 200  # pixels needed to learn a range
_SHARE = 0.95  # of the pixels inside a learned range, in hue and in saturation
_GREY = 0.15  # median saturation below which hue is noise and is not restricted
_MORE = 0.05  # margin of a learned range in saturation
_BINS = 16  # of a table of colours, per channel
_CLEARLY = 3.0  # smallest ratio of the density of a colour in the object to that in its surroundings
_RAREST = 0.01  # smallest density of a colour of the object, over that of its most common colour


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
    """A box in hue, saturation and value. Raises ReorientError for invalid limits."""

    hue_deg: tuple[float, float] = (0.0, 360.0)
    """From, to, in increasing hue; (350, 10) contains red."""
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
        """Whether each colour is in the range."""
        hue, saturation, value = np.moveaxis(hsv_from_rgb(rgb), -1, 0)
        low, high = self.hue_deg
        in_hue = (hue >= low) & (hue <= high) if low <= high else (hue >= low) | (hue <= high)
        in_saturation = (saturation >= self.saturation[0]) & (saturation <= self.saturation[1])
        return np.asarray(in_hue & in_saturation & (value >= self.value[0]) & (value <= self.value[1]))

    @classmethod
    def learned(cls, rgb: UInt8[np.ndarray, "n 3"]) -> "ColourRange":
        """The range of 95% of these colours in hue (shortest arc; all hues for grey) and in saturation.

        Value is not restricted, because it changes with the light. Raises ReorientError for fewer than 200 pixels.
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
    """The colours that distinguish an object from its surroundings."""

    own: Bool[np.ndarray, "red green blue"]
    """Whether each bin of red, green and blue is a colour of the object."""

    @classmethod
    def learned(cls, rgb: UInt8[np.ndarray, "n 3"], others: UInt8[np.ndarray, "m 3"]) -> "ColourTable":
        """From pixels of the object and of its surroundings, by smoothed histograms."""
        density, other_density = (_density(pixels) for pixels in (rgb, others))
        return cls((density > _CLEARLY * other_density) & (density > _RAREST * density.max()))

    def contains(self, rgb: UInt8[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Whether each colour is one of the object."""
        return np.asarray(self.own[tuple(np.moveaxis(rgb // (256 // _BINS), -1, 0))])


def _density(rgb: UInt8[np.ndarray, "n 3"]) -> Float[np.ndarray, "red green blue"]:
    """A smoothed histogram; zero without pixels."""
    counts, _ = np.histogramdd(rgb, bins=_BINS, range=[(0, 256)] * 3)
    return np.asarray(ndimage.gaussian_filter(counts / max(len(rgb), 1), 1.0, mode="constant"))


def _shortest_arc(hue_deg: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """The shortest arc with 95% of the hues."""
    hue = np.sort(hue_deg)
    count = int(np.ceil(_SHARE * len(hue)))
    ends = np.concatenate([hue, hue + 360])[count - 1 : count - 1 + len(hue)]
    first = int(np.argmin(ends - hue))
    return float(hue[first]), float(ends[first] % 360)
