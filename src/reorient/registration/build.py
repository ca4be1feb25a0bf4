"""Building the alignment problem from images: views, prior, and earlier observations put in place."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.imaging import DepthImage
from reorient.registration.depth_view import DepthView
from reorient.registration.gauss_newton import refine
from reorient.registration.pivot import pivot_prior
from reorient.registration.problem import Observation, Problem

OBSERVATIONS = 2  # earlier captures that are used: those that show the most new
LEAST_NEW_RAD = np.radians(10)  # a capture rotated by less shows nothing new
_TOLERANCES = (0.08, 0.06, 0.04, 0.03, 0.02, 0.015, 0.01)  # of the steps that put an earlier capture in place
_POINTS = 400


def build_problem(
    current: DepthImage,
    goal: DepthImage,
    pivot_m: Float[np.ndarray, "3"] | None,
    history: Sequence[tuple[DepthImage, Float[np.ndarray, "3 3"]]] = (),
) -> Problem:
    """The problem of a pair of images, with a rotation centre (camera axes) or None, and with earlier captures.

    ``history``: earlier captures, each with R_now_then. They rotate to now about the pivot (or its guess), and a
    registration without rotation puts them in place.
    """
    now, target = DepthView(current), DepthView(goal)
    observations = [Observation(now, np.eye(3), np.zeros(3))]
    for image, R in _most_new(history):
        then = DepthView(image)
        to_now = Problem((Observation(then, np.eye(3), np.zeros(3)),), now, pivot_prior(then, now, pivot_m))
        placed = refine(to_now, to_now.start(R[None]), _TOLERANCES, _POINTS, rotate=False)
        observations.append(Observation(then, R, placed.t_m[0]))
    return Problem(tuple(observations), target, pivot_prior(now, target, pivot_m))


def _most_new(
    history: Sequence[tuple[DepthImage, Float[np.ndarray, "3 3"]]],
) -> list[tuple[DepthImage, Float[np.ndarray, "3 3"]]]:
    """One after another, the capture that is rotated farthest from all chosen and from now."""
    chosen: list[tuple[DepthImage, Float[np.ndarray, "3 3"]]] = []
    known = [np.eye(3)]
    while len(chosen) < min(OBSERVATIONS, len(history)):
        away = [min(float(so3.angle_difference(R, x)) for x in known) for _, R in history]
        farthest = int(np.argmax(away))
        if away[farthest] < LEAST_NEW_RAD:
            break
        chosen.append(history[farthest])
        known.append(history[farthest][1])
    return chosen
