"""Splatting: from projected points to a depth image, the nearest point of each pixel."""

import numpy as np
from jaxtyping import Float, Int


def splat(
    uv_px: Float[np.ndarray, "n 2"],
    depth_m: Float[np.ndarray, " n"],
    shape: tuple[int, ...],
    image: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "..."]:
    """Depth images of the nearest point in each pixel, 0 in pixels without a point.

    ``uv_px``: pixel coordinates (column, row), the first pixel covers [0, 1). ``depth_m``: depth along the optical
    axis. ``shape``: (height, width), or (images, height, width) with the index ``image`` of each point's image. Points
    outside the image, with a depth that is not positive, or with NaN coordinates are ignored.
    """
    height, width = shape[-2:]
    u, v = uv_px.T
    inside = np.flatnonzero((depth_m > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height))
    pixel = v[inside].astype(np.intp) * width + u[inside].astype(np.intp)
    if image is not None:
        pixel += image[inside] * (height * width)
    nearest_m = np.full(int(np.prod(shape)), np.inf, depth_m.dtype)
    np.minimum.at(nearest_m, pixel, depth_m[inside])
    nearest_m[np.isinf(nearest_m)] = 0
    return nearest_m.reshape(shape)
