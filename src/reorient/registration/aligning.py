"""The views of a goal, put in place: aligned to each other, and without those that contradict the others.

A robot states how it rotated the object between two views, and is wrong by a degree or two: the grasp slips, the arm
misses. Such views have no translation: they rotated about one pivot, which is estimated first. Gauss-Newton then aligns
each of them to all others, in turn and with ever finer tolerances, and a prior keeps it near its stated motion where
the views leave that open. A view with a translation, from CAD or aligned before, keeps its motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.imaging import DepthImage
from reorient.imaging.goal import Goal
from reorient.registration.agreement import agreed_pivot, best_agreeing
from reorient.registration.depth_view import DepthView
from reorient.registration.evidence import INLIER_TOLERANCE
from reorient.registration.gauss_newton import normal_equations, refine, stepped
from reorient.registration.hypotheses import Hypotheses
from reorient.registration.pivot import PIVOT_ERROR_M, pivot_prior
from reorient.registration.problem import PosedView, Problem


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Lengths relative to the object diameter unless they have a unit."""

    tolerances: tuple[float, ...] = (0.04, 0.03, 0.025, 0.02, 0.015, 0.012, 0.01, 0.01)
    """Of the Gauss-Newton steps of each view."""
    pivot_tolerances: tuple[float, ...] = (0.08, 0.08, 0.06, 0.06, 0.04, 0.04, 0.03, 0.02)
    """Of the steps that estimate the pivot."""
    points: int = 1000
    """Of each image."""
    rotation_rad: float = 0.03
    """Standard deviation of a stated rotation, about each axis. Of 0.026 to 0.1 on tuning objects 0.03 left right ones
    where they were (0.3 degrees median) and halved slips of two degrees."""
    shift: float = 0.03
    """Standard deviation of a stated translation, along each axis. Not tuned."""
    fits: float = 0.75
    """Co-visible inlier ratio of a view that agrees with the others: four in five of right views have it."""
    contradicts: float = 0.25
    """The same of a view that does not, whatever the reason: thin objects have 0.4."""
    better: float = 0.12
    """A view between the two contradicts the others if another rotation gains so much."""
    tried: int = 64
    """Number of other motions that are tried."""
    tried_rad: float = 0.45
    """Root mean square of their rotations about each axis."""
    tried_tolerances: tuple[float, ...] = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.012)
    """Of the steps from them."""
    compared: float = 0.05
    """A view of which all but this share of the points is occluded shares too little with the others to contradict."""


SETTINGS = Settings()


def posed_views(goal: DepthImage | Goal, pivot_m: Float[np.ndarray, "3"] | None = None) -> tuple[PosedView, ...]:
    """The views of a goal as it states them, the primary first. Those without a translation rotated about the pivot
    (camera axes); without one, about an estimate of it."""
    if isinstance(goal, DepthImage) or not goal.views:
        return (PosedView.first(DepthView(goal if isinstance(goal, DepthImage) else goal.image)),)
    return _posed(goal, None if pivot_m is None else tuple(np.asarray(pivot_m, float).tolist()))


@lru_cache(maxsize=8)
def _posed(goal: Goal, pivot_m: tuple[float, ...] | None) -> tuple[PosedView, ...]:
    primary = PosedView.first(DepthView(goal.image))
    views = [DepthView(x.image) for x in goal.views]
    turned = [(view, x.R_goal_view) for view, x in zip(views, goal.views, strict=True) if x.t_goal_view_m is None]
    center_m = _pivot(primary, turned, None if pivot_m is None else np.array(pivot_m)) if turned else np.zeros(3)
    return (
        primary,
        *(
            PosedView(
                view,
                x.R_goal_view,
                center_m - x.R_goal_view @ center_m if x.t_goal_view_m is None else x.t_goal_view_m,
            )
            for view, x in zip(views, goal.views, strict=True)
        ),
    )


def aligned_goal(
    goal: DepthImage | Goal, pivot_m: Float[np.ndarray, "3"] | None = None
) -> tuple[Goal, tuple[str, ...]]:
    """The goal with its views aligned to each other, each with a translation; and what is wrong, a sentence each.

    A view that has a translation keeps its motion, so an aligned goal stays as it is. Another that contradicts the
    others is left out and named. The primary view stays as it is. ``pivot_m``: rotation centre of the views without
    translation (camera axes), good to about 1 cm; None: unknown. The answer for a goal is computed once.
    """
    if isinstance(goal, DepthImage) or not goal.views:
        return (Goal(goal) if isinstance(goal, DepthImage) else goal), ()
    return _aligned(goal, None if pivot_m is None else tuple(np.asarray(pivot_m, float).tolist()))


@lru_cache(maxsize=8)
def _aligned(goal: Goal, pivot_m: tuple[float, ...] | None) -> tuple[Goal, tuple[str, ...]]:
    stated = views = dict(enumerate(_posed(goal, pivot_m)))
    free = {k for k, x in enumerate(goal.views, start=1) if x.t_goal_view_m is None}
    warnings = []
    while free:
        views = best_agreeing(stated, _together(stated, free))
        found = {k: fit for k in free if (fit := _contradiction(views, k)) is not None}
        if not found:
            break
        worst = min(found, key=lambda k: found[k])
        del stated[worst], views[worst]
        free.remove(worst)
        warnings.append(
            f"goal view {worst} contradicts the others ({found[worst]:.0%} of its co-visible points fit): it was not "
            "used (is its rotation right, and is it the same object?)"
        )
    further = [
        replace(goal.views[k - 1], R_goal_view=x.R_first_view, t_goal_view_m=x.t_first_view_m)
        for k, x in views.items()
        if k
    ]
    return Goal(goal.image, tuple(further)), tuple(warnings)


def _together(stated: dict[int, PosedView], free: set[int]) -> dict[int, PosedView]:
    """The views, by number, with those that are free aligned to all; the primary, number 0, is not."""
    views = dict(stated)
    for tolerance in SETTINGS.tolerances:
        for k in free:
            views[k] = _nearer(views, k, stated[k], tolerance)
    return views


def _nearer(views: dict[int, PosedView], k: int, stated: PosedView, tolerance: float) -> PosedView:
    """A view after one step towards all others, held near its stated motion."""
    problem, motion = _against_others(views, k)
    H, g = normal_equations(problem, motion, tolerance, SETTINGS.points)
    center_m, half_m = problem.prior.goal_m, problem.diameter_m / 2
    R = motion.R[0] @ stated.R_first_view.T
    shift_m = motion.t_m[0] - center_m - R @ (stated.t_first_view_m - center_m)
    information = np.repeat([SETTINGS.rotation_rad**-2, (2 * SETTINGS.shift) ** -2], 3)
    H += np.diag(information)
    g += information * np.concatenate([so3.log(R), shift_m / half_m])
    nearer = stepped(problem, motion, H, g)
    return PosedView(problem.current, nearer.R[0], nearer.t_m[0])


def _against_others(views: dict[int, PosedView], k: int) -> tuple[Problem, Hypotheses]:
    """The problem of a view and all others, and its present motion."""
    view = views[k]
    others = tuple(x for number, x in views.items() if number != k)
    motion = Hypotheses(view.R_first_view[None], view.t_first_view_m[None])
    return Problem.of((PosedView.first(view.view),), others, None), motion


def _contradiction(views: dict[int, PosedView], k: int) -> float | None:
    """The co-visible inlier ratio of a view that contradicts the others; None for one that does not."""
    problem, motion = _against_others(views, k)
    fit = _fit(problem, motion)
    if fit is None or fit >= SETTINGS.fits:
        return None
    if fit < SETTINGS.contradicts:
        return fit
    rng, count = np.random.default_rng(0), SETTINGS.tried
    R = so3.exp(SETTINGS.tried_rad * rng.standard_normal((count, 3)))
    tried = motion[np.zeros(count, int)].perturbed(problem.prior.goal_m, R, np.zeros((count, 3)))
    tried = refine(problem, tried, SETTINGS.tried_tolerances, SETTINGS.points // 2)
    score = problem.score(tried, INLIER_TOLERANCE, SETTINGS.points)
    other = _fit(problem, tried[np.array([np.argmax(score)])])
    return fit if other is not None and other > fit + SETTINGS.better else None


def _fit(problem: Problem, motion: Hypotheses) -> float | None:
    """The co-visible inlier ratio of a motion; None where nearly all points are occluded."""
    evidence = problem.evidence(motion.R[0], motion.t_m[0], INLIER_TOLERANCE * problem.diameter_m, SETTINGS.points)
    return evidence.covisible_inlier_ratio if 1 - evidence.occluded >= SETTINGS.compared else None


def _pivot(
    primary: PosedView, turned: Sequence[tuple[DepthView, Float[np.ndarray, "3 3"]]], stated_m: np.ndarray | None
) -> Float[np.ndarray, "3"]:
    """The centre about which views were rotated, from the fit of all pairs of views; near the stated one, if any."""
    prior = pivot_prior(primary.view, primary.view, None)
    center_m = prior.goal_m if stated_m is None else stated_m
    deviation_m = prior.diameter_m / 2 if stated_m is None else PIVOT_ERROR_M
    first_m = center_m
    every = [(primary.view, np.eye(3)), *turned]
    for tolerance in SETTINGS.pivot_tolerances:
        H, g = np.eye(3) / deviation_m**2, (center_m - first_m) / deviation_m**2
        for k, (view, R) in enumerate(every):
            for other, R_other in every[k + 1 :]:
                goal = PosedView(other, R_other, center_m - R_other @ center_m)
                problem = Problem.of((PosedView.first(view),), (goal,), None)
                motion = Hypotheses(R[None], (center_m - R @ center_m)[None])
                H_pair, g_pair = normal_equations(problem, motion, tolerance, SETTINGS.points // 2)
                by_center = (R_other - R) / (problem.diameter_m / 2)  # shift of the one against the other
                H += by_center.T @ H_pair[0, 3:, 3:] @ by_center
                g += by_center.T @ g_pair[0, 3:]
        step_m = np.linalg.solve(H, g)
        center_m = center_m - step_m * min(1.0, 0.1 * prior.diameter_m / max(float(np.linalg.norm(step_m)), 1e-12))
    return agreed_pivot([PosedView(view, R, np.zeros(3)) for view, R in every], np.asarray(center_m))
