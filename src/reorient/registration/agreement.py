"""How well the views of a goal agree, by the score of all their pairs; and the pivot and the motions that agree best.

Gauss-Newton pulls views that overlap little into each other: a point behind a surface costs nothing. On exact images of
six sides its pivot is 3 to 7 mm too near for an object of 0.2 m, the one of the best score at most 3.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from reorient.registration.evidence import score
from reorient.registration.hypotheses import Hypotheses
from reorient.registration.problem import PosedView

TOLERANCES = (0.03, 0.012, 0.006)
"""Largest depth differences of inliers, relative to the object diameter, one after another: the finer the nearer the
true pivot, and the smaller the region in which it is found."""
POINTS = 300
GAIN = 0.04
"""Added score for which an aligned motion replaces the stated one. Four objects with exact motions, four with slip."""
_EVALUATIONS = 120


def agreement(views: Sequence[PosedView], tolerance: float) -> float:
    """The scores of all pairs of views, added; ``tolerance``: relative to the object diameter."""
    diameter_m = max(x.view.diameter_m for x in views)
    total = 0.0
    for a, b in combinations(views, 2):
        start = Hypotheses(a.R_first_view[None], a.t_first_view_m[None])
        motion = start.onto(b.R_first_view, b.t_first_view_m)
        total += float(score(a.view, b.view, motion, tolerance * diameter_m, POINTS)[0])
    return total


def agreed_pivot(views: Sequence[PosedView], center_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The centre, near a given one, about which the views rotated; the first of them shows no rotation."""

    def disagreement(center_m: Float[np.ndarray, "3"], tolerance: float) -> float:
        rotated = [PosedView(x.view, x.R_first_view, center_m - x.R_first_view @ center_m) for x in views]
        return -agreement(rotated, tolerance)

    diameter_m = max(x.view.diameter_m for x in views)
    for tolerance in TOLERANCES:
        simplex = center_m + np.vstack([np.zeros(3), 1.3 * tolerance * diameter_m * np.eye(3)])
        options = {"initial_simplex": simplex, "xatol": 2e-4, "fatol": 1e-4, "maxfev": _EVALUATIONS}
        center_m = minimize(disagreement, center_m, (tolerance,), method="Nelder-Mead", options=options).x
    return np.asarray(center_m)


def best_agreeing(stated: Mapping[int, PosedView], aligned: Mapping[int, PosedView]) -> dict[int, PosedView]:
    """Of each view the stated or the aligned motion, so that the views agree best; the stated one where they tie."""

    def total(views: Mapping[int, PosedView]) -> float:
        changed = sum(view is not stated[k] for k, view in views.items())
        return agreement(list(views.values()), TOLERANCES[-1]) - GAIN * changed

    chosen, other = sorted((dict(stated), dict(aligned)), key=total, reverse=True)
    best = total(chosen)
    for k in chosen:
        changed = chosen | {k: other[k]}
        if (value := total(changed)) > best:
            chosen, best = changed, value
    return chosen
