"""The symmetry of a goal that shows all sides, from its own views.

A rotation of the object that is a symmetry lets every goal view fit every other, as no rotation does. So the views are
searched against themselves. What a current image then leaves open by symmetry is no doubt: the rotations are the same.
A difference on one side of six hardly counts there, so each current image is asked, too (``supported``).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

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
    least_rad: float = float(np.radians(35))
    """Smaller rotations are symmetries of solids of revolution alone: those of others are at least 36 degrees, or of
    more than ten equal parts."""
    as_likely: float = 0.2
    """Least probability, relative to the answer's, of equivalents that the images support. 34 motions under which goals
    of tuning and generated objects fit: of the 10 that are symmetries of the mesh 6 have more, of the others 3. Chosen
    after a look at 10 such motions of the reporting half."""
    probes: int = 8
    """Rotations about an axis, evenly spaced, that all fit a solid of revolution."""
    revolution_loss: float = 0.1
    """Co-visible inlier ratio that these may lose against no rotation."""
    step_rad: float = float(np.radians(20))
    """Between the rotations about its axis that the estimate lists."""


SETTINGS = Settings()


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The motions S (goal's camera axes) that leave the object as it is, so that R and S R are the same."""

    separate: Hypotheses = field(default_factory=lambda: Hypotheses(np.empty((0, 3, 3)), np.empty((0, 3))))
    """Without the identity. Of a solid of revolution those that swap its ends, for one rotation about the axis each."""
    axis: Float[np.ndarray, "3"] | None = None
    """Of a solid of revolution: unit vector; every rotation about it is one of the motions."""
    point_m: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """A point of the axis."""

    def __bool__(self) -> bool:
        return len(self.separate) > 0 or self.axis is not None

    @property
    def rotations(self) -> Float[np.ndarray, "k 3 3"]:
        """Of the motions, without the identity; about an axis in steps of ``step_rad``."""
        if self.axis is None:
            return self.separate.R
        about = so3.exp(np.arange(0, 2 * np.pi - SETTINGS.step_rad / 2, SETTINGS.step_rad)[:, None] * self.axis)
        return np.concatenate([about[1:], *(about @ S for S in self.separate.R)])

    def about(self, motions: Hypotheses, angles_rad: Float[np.ndarray, " k"]) -> Hypotheses:
        """Motions rotated further about the axis, each by its angle."""
        assert self.axis is not None
        return motions.perturbed(self.point_m, so3.exp(angles_rad[:, None] * self.axis), np.zeros((len(angles_rad), 3)))

    def smallest(self, answer: Hypotheses) -> Hypotheses:
        """Of a motion and all that are the same, the one with the smallest rotation."""
        same = answer.and_also(self.separate.after(answer.R[0], answer.t_m[0]))
        if self.axis is not None:
            same = self.about(same, np.array([-so3.twist_angle(R, self.axis) for R in same.R]))
        return same[np.array([np.argmin(so3.angle(same.R))])]

    def apart_rad(self, R: Float[np.ndarray, "k 3 3"], R_answer: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " k"]:
        """The least angle of each of k rotations to those that are the same as an answer."""
        same = np.stack([R_answer, *(S @ R_answer for S in self.separate.R)])
        return np.asarray(so3.angle_but_about(R[:, None] @ np.swapaxes(same, 1, 2), self.axis).min(axis=1))

    def projection(self, about_m: Float[np.ndarray, "3"], unit_m: float) -> Float[np.ndarray, "6 6"]:
        """Takes rotations about the axis out of a small motion: a rotation vector about a point and a shift, in units
        of ``unit_m``."""
        if self.axis is None:
            return np.eye(6)
        freedom = np.concatenate([self.axis, np.cross(self.point_m - about_m, self.axis) / unit_m])
        return np.asarray(np.eye(6) - np.outer(freedom, np.concatenate([self.axis, np.zeros(3)])))


NONE = Symmetry()


def symmetries(goal: DepthImage | Goal) -> Symmetry:
    """The symmetry of a goal: none of one that does not show all sides.

    ``goal``: aligned; the answer is computed once.
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
def _symmetries(goal: Goal) -> Symmetry:
    views = posed_views(goal)
    problem = Problem.of(views, views, None)
    found = search_once(problem, EFFORTS["fast"])
    found = found[so3.angle(found.R) > SETTINGS.distinct_rad]
    still = Hypotheses(np.eye(3)[None], np.zeros((1, 3)))
    as_it_is = _fit(problem, still, with_itself=False)
    fits = np.array([_fit(problem, found[np.array([k])]) for k in range(len(found))])
    fit = fits >= as_it_is - SETTINGS.loss
    found, fits = found[fit], fits[fit]
    found = found[non_maximum_suppression(found.R, fits, SETTINGS.distinct_rad)]
    revolution = next(_revolutions(problem, found, as_it_is - SETTINGS.revolution_loss), None)
    if revolution is None:
        return Symmetry(found[so3.angle(found.R) > SETTINGS.least_rad])
    swaps = found[np.nonzero(found.R @ revolution.axis @ revolution.axis < -np.cos(SETTINGS.distinct_rad))[0]]
    return replace(revolution, separate=swaps[:1])


def _revolutions(problem: Problem, found: Hypotheses, least: float) -> Iterator[Symmetry]:
    """The solids of revolution, about the axes of motions that fit, of which all rotations about the axis fit."""
    step_rad = 2 * np.pi / (SETTINGS.probes + 1)
    angles_rad = step_rad * np.arange(1, SETTINGS.probes + 1)
    still = Hypotheses(np.eye(3)[None], np.zeros((1, 3)))[np.zeros(SETTINGS.probes, int)]
    for k in range(len(found)):
        axis = so3.log(found.R[k]) / so3.angle(found.R[k])
        axis = axis * (1 if axis[np.argmax(np.abs(axis))] > 0 else -1)
        start = Symmetry(axis=axis, point_m=_point_of_axes(found[np.array([k])])).about(still, angles_rad)
        probes = refine(problem, start, EFFORTS["normal"].stages[-1].tolerances, SETTINGS.points)
        stay = so3.angle_difference(probes.R, start.R) < step_rad / 2
        if stay.all() and all(_fit(problem, probes[np.array([k])]) >= least for k in range(len(probes))):
            axis = np.linalg.eigh(np.sum(probes.R + np.swapaxes(probes.R, 1, 2), axis=0))[1][:, 2]
            yield Symmetry(axis=axis, point_m=_point_of_axes(probes))


def _point_of_axes(motions: Hypotheses) -> Float[np.ndarray, "3"]:
    """The point that motions about one axis move least."""
    fixed = np.eye(3) - motions.R
    point_m: Float[np.ndarray, 3] = np.linalg.lstsq(fixed.reshape(-1, 3), motions.t_m.reshape(-1), rcond=1e-3)[0]
    return point_m


def _fit(problem: Problem, motion: Hypotheses, with_itself: bool = True) -> float:
    """The co-visible inlier ratio of all pairs of views together; ``with_itself``: also of a view with itself."""
    warped: list[Warped] = []
    for pair in problem.pairs(motion):
        if with_itself or pair.now.view is not pair.goal.view:
            motions = pair.motions.R[0], pair.motions.t_m[0]
            warped += warp_both(pair.now.view, pair.goal.view, *motions, SETTINGS.points)
    return evidence_of(warped, INLIER_TOLERANCE * problem.diameter_m).covisible_inlier_ratio


def supported(problem: Problem, answer: Hypotheses, symmetry: Symmetry) -> Symmetry:
    """What of a symmetry the images of a problem support: after a separate motion they are about as likely as by the
    answer; after rotations about the axis they fit about as well."""
    separate, axis = symmetry.separate, symmetry.axis
    if len(separate):
        same = _refined(problem, answer.and_also(separate.after(answer.R[0], answer.t_m[0])))
        _, probability = assess(problem, same, "normal")
        separate = separate[probability[1:] >= SETTINGS.as_likely * probability[0]]
    if axis is not None:
        angles_rad = np.pi / 3 * np.arange(6)
        about = _refined(problem, symmetry.about(answer[np.zeros(len(angles_rad), int)], angles_rad))
        fits = [_fit(problem, about[np.array([k])]) for k in range(len(about))]
        axis = axis if np.median(fits[1:]) >= fits[0] - SETTINGS.revolution_loss else None
    return replace(symmetry, separate=separate, axis=axis)


def _refined(problem: Problem, motions: Hypotheses) -> Hypotheses:
    for stage in EFFORTS["normal"].stages[-2:]:
        motions = refine(problem, motions, stage.tolerances, stage.points)
    return motions
