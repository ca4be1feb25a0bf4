"""Images and texts in the form that the view of a browser takes."""

import numpy as np
from jaxtyping import UInt8

from reorient.imaging import DepthImage
from reorient.reporting.pictures import shade

IMAGE_PX = 300


def picture(image: DepthImage) -> UInt8[np.ndarray, "h w 3"]:
    """An image shaded, its unknown pixels orange."""
    shaded = np.array(shade(image, IMAGE_PX))
    side = max(image.depth_m.shape)
    rows, columns = ((np.arange(IMAGE_PX) + 0.5) * side / IMAGE_PX for _ in range(2))
    top, left = ((side - n) // 2 for n in image.depth_m.shape)
    inside = np.pad(image.unknown, ((top, side - image.camera.height - top), (left, side - image.camera.width - left)))
    shaded[inside[np.ix_(rows.astype(int), columns.astype(int))]] = (172, 119, 0)
    return shaded


def plain(text: str) -> str:
    """Text in which Markdown and HTML have no meaning."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()#+!|<>~&$" else letter for letter in text)
