"""Boolean images: their type, and the window around their pixels."""

import numpy as np
from jaxtyping import Bool

Mask = Bool[np.ndarray, "height width"]


def window(mask: Mask, margin_px: int = 0) -> tuple[slice, slice]:
    """The rows and columns of the bounding box of a mask, not empty, extended by a margin within the image."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(int(rows[0]) - margin_px, 0), int(rows[-1]) + 1 + margin_px),
        slice(max(int(columns[0]) - margin_px, 0), int(columns[-1]) + 1 + margin_px),
    )


def longer_side(part: tuple[slice, slice]) -> int:
    """Pixels along the longer side of a window."""
    rows, columns = part
    return int(max(rows.stop - rows.start, columns.stop - columns.start))
