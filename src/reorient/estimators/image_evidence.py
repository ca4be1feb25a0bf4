"""Evidence images: what each pixel of one image shows for a hypothesis, compared with the other image.

The returns of each image move by the hypothesis into the other view, as for the features of the verifier; but each
keeps its place in its own image, reduced to ``SIZE`` pixels. So the images of all hypotheses of a pair show the same
pixels, and a network can compare them pixel by pixel.
"""

import numpy as np
from jaxtyping import Float, Int, UInt8

from reorient.registration import DepthView, Hypotheses, Problem
from reorient.registration.hypotheses import rotate

SIZE = 48  # px
CHANNELS = ("difference", "state", "normals", "facing there", "facing here")
CLIPPED = 0.1  # largest depth difference that is distinguished, relative to the object diameter
NOTHING, UNKNOWN_HERE, COMPARED, UNKNOWN_THERE, OUTSIDE = range(5)
"""States of a pixel: not the object; unknown in its own image; on the other surface; on an unknown pixel of the other
image or beyond its frame; outside its silhouette, by a distance of (state - OUTSIDE) / ``PER_PX`` pixels."""
PER_PX = 4


def evidence_images(problem: Problem, hypotheses: Hypotheses) -> UInt8[np.ndarray, "k 2 c s s"]:
    """The evidence images of hypotheses of a problem of two views: of the current image, then of the goal image.

    Channels: depth difference (128: none; positive: behind the other surface; steps grow with its square), state,
    cosine of the two normals, and cosines of the moved and of the own normal with the ray from the camera (0 to 255
    for -1 to 1). Channels without a value are 0.
    """
    views = problem.current, problem.goal
    ways = (hypotheses, hypotheses.inverse)
    return np.stack(
        [
            _one_way(source, target, motion, problem.diameter_m)
            for source, target, motion in zip(views, views[::-1], ways, strict=True)
        ],
        axis=1,
    )


def _one_way(
    source: DepthView, target: DepthView, hypotheses: Hypotheses, diameter_m: float
) -> UInt8[np.ndarray, "k c s s"]:
    """The images of one view's returns in the other view."""
    place, chosen, unknown = _grid(source)
    motion = hypotheses.single()
    points_m = np.ascontiguousarray(source.points_m[chosen].T)
    normals = np.ascontiguousarray(source.normals[chosen].T)
    x, moved = motion.move(points_m), rotate(motion.R, normals)
    warped = target.warp(x)
    outside, unseen = warped.silhouette_violation(), warped.unknown()
    relative = np.clip(warped.difference_m / np.float32(CLIPPED * diameter_m), -1, 1)
    difference = np.rint(128 + 127 * np.sign(relative) * np.sqrt(np.abs(relative)))
    away = np.minimum(np.rint(PER_PX * target.outside_px(warped.pixel)), 255 - OUTSIDE)
    state = np.where(outside, OUTSIDE + away, np.where(unseen, UNKNOWN_THERE, COMPARED))
    cosine = np.sum(np.stack(target.planes(warped.pixel)[:3], axis=1) * moved, axis=1)
    compared = ~outside & ~unseen
    values = [
        np.where(compared, difference, 0),
        state,
        np.where(compared, _coded(cosine), 0),
        _coded(np.sum(moved * x, axis=1) / np.linalg.norm(x, axis=1)),
        np.broadcast_to(_coded(np.sum(normals * points_m, axis=0) / np.linalg.norm(points_m, axis=0)), state.shape),
    ]
    images = np.zeros((len(hypotheses), len(CHANNELS), SIZE * SIZE), np.uint8)
    images[:, 1, unknown] = UNKNOWN_HERE
    images[:, :, place] = np.stack(values, axis=1)
    return images.reshape(-1, len(CHANNELS), SIZE, SIZE)


def _coded(cosine: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Cosines as 0 to 255."""
    return np.rint(np.clip(127.5 * (cosine + 1), 0, 255))


def _grid(view: DepthView) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " u"]]:
    """The pixels of the square around a view's object that show a return, the numbers of these returns, and the
    unknown pixels."""
    valid = view.image.valid
    order = np.cumsum(valid).reshape(valid.shape) - 1
    ends = [np.nonzero(valid.any(axis=axis))[0][[0, -1]] for axis in (1, 0)]
    side = max(int(last - first) + 1 for first, last in ends)
    steps = (np.arange(SIZE) + 0.5) * side / SIZE - side / 2
    row, column = (np.floor((first + last + 1) / 2 + steps).astype(int) for first, last in ends)
    within = (
        ((row >= 0) & (row < valid.shape[0]))[:, None] & ((column >= 0) & (column < valid.shape[1]))[None]
    ).ravel()
    at = np.ix_(np.clip(row, 0, valid.shape[0] - 1), np.clip(column, 0, valid.shape[1] - 1))
    place = np.nonzero(within & valid[at].ravel())[0]
    unknown = np.nonzero(within & view.image.unknown[at].ravel())[0]
    return place, order[at].ravel()[place], unknown
