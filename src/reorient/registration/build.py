"""Building the alignment problem from images: views, prior, and earlier observations put in place."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.imaging import DepthImage
from reorient.imaging.goal import Goal
from reorient.registration.aligning import posed_views
from reorient.registration.depth_view import DepthView
from reorient.registration.gauss_newton import refine
from reorient.registration.problem import PosedView, Problem

OBSERVATIONS = 2  # earlier captures that are used: those that show the most new
LEAST_NEW_RAD = np.radians(10)  # a capture rotated by less shows nothing new
_TOLERANCES = (0.08, 0.06, 0.04, 0.03, 0.02, 0.015, 0.01)  # of the steps that put an earlier capture in place
_POINTS = 400


def build_problem(
    current: DepthImage,
    goal: DepthImage | Goal,
    pivot_m: Float[np.ndarray, "3"] | None,
    history: Sequence[tuple[DepthImage, Float[np.ndarray, "3 3"]]] = (),
) -> Problem:
    """The problem of an image and a goal, with a rotation centre (camera axes) or None, and with earlier captures.

    ``history``: earlier captures, each with R_now_then. They rotate to now about the pivot (or its guess), and a
    registration without rotation puts them in place. Goal views are taken as they are; see ``aligned_goal``.
    """
    now = PosedView.first(DepthView(current))
    views_now = [now]
    for image, R in _most_new(history):
        to_now = Problem.of((PosedView.first(DepthView(image)),), (now,), pivot_m)
        placed = refine(to_now, to_now.start(R[None]), _TOLERANCES, _POINTS, rotate=False)
        views_now.append(PosedView(to_now.current, R, placed.t_m[0]))
    return Problem.of(tuple(views_now), posed_views(goal, pivot_m), pivot_m)


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
