"""The symmetry of a goal that shows all sides, from its own views.

A rotation of the object that is a symmetry lets every goal view fit every other, as no rotation does. So the views are
searched against themselves. What a current image then leaves open by symmetry is no doubt: the rotations are the same.
A difference on one side of six hardly counts there, so each current image is asked, too (``supported``).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from reorient import so3
from reorient.estimators.search import EFFORTS, search_once
from reorient.estimators.views_verifier import assess
from reorient.imaging import DepthImage, Goal
from reorient.registration import (
    INLIER_TOLERANCE,
    Hypotheses,
    Problem,
    Warped,
    evidence_of,
    non_maximum_suppression,
    posed_views,
    refine,
    warp_both,
)

NONE = Hypotheses(np.empty((0, 3, 3)), np.empty((0, 3)))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Shares are of points."""

    sides_rad: float = float(np.radians(65))
    """A goal shows all sides if every direction is this near to that of a view; 55 degrees for the faces of a cube."""
    points: int = 600
    """Of each image in a pair of views."""
    loss: float = 0.04
    """Co-visible inlier ratio between the views that a symmetry may lose against no rotation."""
    distinct_rad: float = float(np.radians(12))
    """Smaller rotations, and differences between symmetries, are none."""
    as_likely: float = 0.2
    """Least probability, relative to the answer's, of equivalents that the images support. 34 motions under which goals
    of tuning and generated objects fit: of the 10 that are symmetries of the mesh 6 have more, of the others 3. Chosen
    after a look at 10 such motions of the reporting half."""


SETTINGS = Settings()


def symmetries(goal: DepthImage | Goal) -> Hypotheses:
    """The motions S (goal's camera axes) that leave the goal as it is, so that R and S R are the same; without the
    identity.

    None of a goal that does not show all sides. Of a solid of revolution some of them. ``goal``: aligned; the answer is
    computed once.
    """
    if isinstance(goal, DepthImage) or not shows_all_sides(goal):
        return NONE
    return _symmetries(goal)


def shows_all_sides(goal: Goal) -> bool:
    """Whether every direction is near that of a view."""
    towards = np.stack([np.eye(3), *(x.R_goal_view for x in goal.views)])[:, :, 2]
    directions = so3.grid(500)[:, :, 2]
    return bool(np.arccos(np.clip(directions @ towards.T, -1, 1)).min(axis=1).max() <= SETTINGS.sides_rad)


@lru_cache(maxsize=8)
def _symmetries(goal: Goal) -> Hypotheses:
    views = posed_views(goal)
    problem = Problem.of(views, views, None)
    found = search_once(problem, EFFORTS["fast"])
    found = found[so3.angle(found.R) > SETTINGS.distinct_rad]
    still = Hypotheses(np.eye(3)[None], np.zeros((1, 3)))
    least = _fit(problem, still, with_itself=False) - SETTINGS.loss
    fits = np.array([_fit(problem, found[np.array([k])]) for k in range(len(found))])
    kept = np.nonzero(fits >= least)[0]
    return found[kept[non_maximum_suppression(found.R[kept], fits[kept], SETTINGS.distinct_rad)]]


def _fit(problem: Problem, motion: Hypotheses, with_itself: bool = True) -> float:
    """The co-visible inlier ratio of all pairs of views together; ``with_itself``: also of a view with itself."""
    warped: list[Warped] = []
    for pair in problem.pairs(motion):
        if with_itself or pair.now.view is not pair.goal.view:
            motions = pair.motions.R[0], pair.motions.t_m[0]
            warped += warp_both(pair.now.view, pair.goal.view, *motions, SETTINGS.points)
    return evidence_of(warped, INLIER_TOLERANCE * problem.diameter_m).covisible_inlier_ratio


def supported(problem: Problem, answer: Hypotheses, group: Hypotheses) -> Hypotheses:
    """The motions of a group after which the images of a problem are about as likely as by the answer."""
    if len(group) == 0:
        return group
    stages = EFFORTS["normal"].stages[-2:]
    all_of_them = answer.and_also(group.after(answer.R[0], answer.t_m[0]))
    for stage in stages:
        all_of_them = refine(problem, all_of_them, stage.tolerances, stage.points)
    _, probability = assess(problem, all_of_them, "normal")
    return group[probability[1:] >= SETTINGS.as_likely * probability[0]]


def equivalents(answer: Hypotheses, group: Hypotheses) -> Hypotheses:
    """A motion and all that a symmetry makes of it, the smallest rotation first."""
    all_of_them = answer.and_also(group.after(answer.R[0], answer.t_m[0]))
    return all_of_them[np.argsort(so3.angle(all_of_them.R), kind="stable")]
