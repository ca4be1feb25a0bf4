"""Tracking: the rotation to the goal, image after image, by local refinement from the estimate of a moment ago.

Each image is compared with the goal, never with the image before, so errors do not add up. Of several goal views the
one that is nearest to the previous estimate is used. The confidence is a logistic function of the verifier's features
of the one tracked hypothesis, and of how much is missing of what it predicts to be seen;
``benchmarks/tracking_confidence.py`` fits it. ``Tracker`` begins by an estimate without an initial guess, and does so
again where the object is lost or leapt.
"""

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators.base import Estimator, RotationEstimate, check_pair, with_evidence
from reorient.estimators.verifier import FEATURES, features
from reorient.imaging import DepthImage, Goal
from reorient.imaging.goal import as_goal
from reorient.registration import (
    INLIER_TOLERANCE,
    DepthView,
    Hypotheses,
    PosedView,
    Problem,
    aligned_goal,
    measure_evidence,
    posed_views,
    refine,
)
from reorient.registration.hypotheses import rotate

CONFIDENCE = Path(__file__).with_name("tracking.json")


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Settings; lengths relative to the object diameter. What chose them: docs/tuning.md, "Tracking"."""

    rotation_rad: float = 0.07
    """The first guess is also rotated by this much, either way about each camera axis."""
    coarse: tuple[float, ...] = (0.05, 0.04, 0.03, 0.02)
    """Tolerances of the Gauss-Newton steps from all guesses, with the silhouettes."""
    coarse_points: int = 300
    """Of each image."""
    scored_tolerance: float = 0.015
    """Depth difference of an inlier, for the choice of the best guess."""
    scored_points: int = 500
    """Of each image."""
    fine: tuple[float, ...] = (0.015, 0.012, 0.01, 0.008, 0.006)
    """Tolerances of the steps from the best, without silhouettes, which noise and lost returns displace."""
    fine_points: int = 2000
    """Of each image."""
    inlier_tolerance: float = 0.012
    """Depth difference of the inliers that measure the noise."""
    noise_factor: float = 4.0
    """The fine tolerances are at least this many residuals of the inliers."""
    seen_points: int = 1000
    """Goal points of which the prediction is made."""
    seen_cosine: float = 0.25
    """Between normal and line of sight, of a point that is predicted to be seen, at least."""
    least_seen: float = 0.35
    """A smaller share of the prediction that is seen lowers the confidence."""
    missing_slope: float = 20.0
    """By this much of the log-odds for each unit that is missing."""


TRACKING = Tracking()
LOST_BELOW = 0.5  # confidence, of an estimate or the mean of the latest images: one doubt alone is often a false alarm
AVERAGED = 3  # latest images
LEAP_RAD = float(np.radians(10))  # from one image to the next: the local refinement reaches no farther
AGREES_RAD = float(np.radians(5))  # between a tracked rotation and the estimate that confirms it
RETRY_IMAGES = 15  # while lost, the whole search is repeated after so many images; the local one at each


_GOAL_VIEWS: WeakKeyDictionary[DepthImage | Goal, tuple[PosedView, ...]] = WeakKeyDictionary()


def track(current: DepthImage, goal: DepthImage | Goal, previous: RotationEstimate) -> RotationEstimate:
    """The motion from current to goal, near that of ``previous``, an estimate of a moment ago; 10 ms at 128 px.

    About 10 degrees and 5% of the object diameter may lie between the two. What is computed of a goal is kept as long
    as the goal is. The confidence falls where the object is lost, hidden or another one. A free axis of ``previous``
    stays: the smallest of the equivalent rotations is tracked. Raises ReorientError for images that cannot be compared.
    """
    check_pair(current, as_goal(goal).image)
    R = previous.R_goal_current
    views = _goal_views(goal)
    target = views[int(np.argmin([so3.angle_difference(x.R_first_view, R) for x in views]))]
    problem = problem_of(DepthView(current), target.view)
    R_view_goal = target.R_first_view.T
    t_m = R_view_goal @ (previous.t_goal_current_m - target.t_first_view_m)
    found = fit(problem, Hypotheses((R_view_goal @ R)[None], t_m[None]))
    if previous.free_axis is not None:
        angle_rad = so3.twist_angle(target.R_first_view @ found.R[0], previous.free_axis)
        untwist = so3.exp(-angle_rad * (R_view_goal @ previous.free_axis))
        found = found.perturbed(problem.prior.goal_m, untwist[None], np.zeros((1, 3)))
    tracked = with_evidence(
        problem.current, problem.goal, found.R[0], found.t_m[0], confidence=confidence(problem, found)
    )
    return replace(
        tracked,
        R_goal_current=target.R_first_view @ tracked.R_goal_current,
        t_goal_current_m=target.R_first_view @ tracked.t_goal_current_m + target.t_first_view_m,
        free_axis=previous.free_axis,
    )


def fit(problem: Problem, start: Hypotheses) -> Hypotheses:
    """The motion near the start that fits best."""
    s = TRACKING
    away = s.rotation_rad * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    guesses = start[np.zeros(len(away), int)].perturbed(problem.prior.goal_m, so3.exp(away), np.zeros((len(away), 3)))
    guesses = refine(problem, guesses, s.coarse, s.coarse_points)
    best = guesses[np.array([np.argmax(problem.score(guesses, s.scored_tolerance, s.scored_points))])]
    inliers = measure_evidence(
        problem.current, problem.goal, best.R[0], best.t_m[0], s.inlier_tolerance * problem.diameter_m
    )
    noise = float(np.nan_to_num(inliers.residual_m)) / problem.diameter_m
    tolerances = [max(x, s.noise_factor * noise) for x in s.fine]
    return refine(problem.without_silhouettes, best, tolerances, s.fine_points)


def confidence(problem: Problem, hypothesis: Hypotheses) -> float:
    """Probability that the error of a tracked hypothesis is below 5 degrees."""
    odds = log_odds(features(problem, hypothesis)[0]) + missing_log_odds(seen_share(problem, hypothesis))
    return float(1 / (1 + np.exp(-odds)))


def log_odds(values: Float[np.ndarray, " f"]) -> float:
    """Of the verifier's features of the tracked hypothesis, that the error is below 5 degrees."""
    weights, bias = _logistic()
    return float(values @ weights + bias)


def missing_log_odds(seen: float) -> float:
    """What a small ``seen_share`` adds to the log-odds: nothing, or less."""
    return -TRACKING.missing_slope * max(TRACKING.least_seen - seen, 0.0)


def seen_share(problem: Problem, hypothesis: Hypotheses) -> float:
    """Share of the goal points that the motion predicts to face the camera now and that are inliers there.

    Where something hides the object, what is left of it may fit anywhere; then most of the prediction is missing.
    """
    motion = hypothesis.inverse.single()
    x = motion.move(problem.goal.sample(TRACKING.seen_points))[0]
    normal = rotate(motion.R, problem.goal.sample_normals(TRACKING.seen_points))[0]
    facing = np.sum(normal * x, axis=0) < -TRACKING.seen_cosine * np.linalg.norm(x, axis=0)
    found = problem.current.warp(x).inlier(INLIER_TOLERANCE * problem.diameter_m)
    return float((facing & found).sum() / max(facing.sum(), 1))


@cache
def _logistic() -> tuple[Float[np.ndarray, " f"], float]:
    """A weight for each of the verifier's features, and the bias."""
    data: Mapping[str, float] = json.loads(CONFIDENCE.read_text(encoding="utf-8"))
    return np.array([data.get(name, 0.0) for name in FEATURES]), data["bias"]


def problem_of(now: DepthView, target: DepthView) -> Problem:
    """The problem of two views, without a pivot."""
    return Problem.of((PosedView.first(now),), (PosedView.first(target),), None)


def _goal_views(goal: DepthImage | Goal) -> tuple[PosedView, ...]:
    """The views of a goal, aligned, the primary one first."""
    if goal not in _GOAL_VIEWS:
        _GOAL_VIEWS[goal] = posed_views(aligned_goal(goal)[0])
    return _GOAL_VIEWS[goal]


class Tracker:
    """Tracks the rotation to one goal: local refinement, and an estimate without initial guess where that fails.

    The object is lost at first, and where the mean confidence of the latest three images is below 0.5. It is found by a
    sure estimate, or where two images in a row are sure of what was tracked meanwhile. A leap of more than 10 degrees
    from one image to the next is beyond the local refinement: an estimate without initial guess decides.
    """

    def __init__(self, estimator: Estimator, goal: DepthImage | Goal) -> None:
        """``estimator``: finds the rotation at first and where it is lost. Raises ReorientError for an unfit goal."""
        image = as_goal(goal).image
        check_pair(image, image)
        self.estimator, self.goal = estimator, goal
        # an estimator that knows one view gets the primary one
        self._searched_goal: Any = goal if getattr(estimator, "several_views", False) else image
        self._track = getattr(estimator, "track", track)
        self._found: RotationEstimate | None = None  # the latest one of sufficient confidence
        self._confidences = deque([0.0] * AVERAGED, AVERAGED)  # of the latest images
        self.lost = True
        """Whether the rotation is unknown."""
        self._wait = 0

    @property
    def searches_next(self) -> bool:
        """Whether the next update is likely to take as long as an estimate without initial guess."""
        return self.lost and self._wait <= 0

    def update(self, image: DepthImage) -> RotationEstimate | None:
        """The estimate of the next image; None while the object is lost.

        Takes as long as ``estimate`` at first, and at every 15th image while the object is lost; else as ``track``.
        """
        tracked = self._tracked(image)
        leapt = not self.lost and self._leapt(tracked)
        if leapt and (found := self._searched(image)) is not None:
            return found
        self._confidences.append(0.0 if leapt else _confidence(tracked))
        if tracked is not None and not leapt and _is_sure(tracked):
            self._found = tracked
        *_, before, now = self._confidences
        mean = sum(self._confidences) / AVERAGED
        self.lost = min(before, now) < LOST_BELOW if self.lost else mean < LOST_BELOW
        if not self.lost:
            self._wait = 0
            return tracked
        self._wait -= 1
        if self._wait >= 0:
            return None
        self._wait = RETRY_IMAGES
        return None if leapt else self._searched(image)

    def confirm(self, image: DepthImage) -> RotationEstimate | None:
        """An estimate of the latest image without initial guess; None unless it is sure and agrees with the tracked.

        Where it is sure and does not agree, tracking goes on from it.
        """
        tracked = self._found
        estimate = self._searched(image)
        if tracked is None or estimate is None:
            return None
        away_rad = so3.angle_difference(estimate.R_goal_current, tracked.R_goal_current)
        return estimate if away_rad < AGREES_RAD else None

    def restart(self, estimate: RotationEstimate) -> RotationEstimate:
        """Track on from this estimate, which is returned."""
        self._found, self._wait, self.lost = estimate, 0, False
        self._confidences.extend([_confidence(estimate)] * AVERAGED)
        return estimate

    def _leapt(self, tracked: RotationEstimate | None) -> bool:
        """Whether more lies between this and the latest sure rotation than the local refinement reaches."""
        if tracked is None or self._found is None:
            return False
        away_rad = so3.angle_difference(tracked.R_goal_current, self._found.R_goal_current)
        return bool(away_rad > LEAP_RAD)

    def _tracked(self, image: DepthImage) -> RotationEstimate | None:
        """The local refinement; None where there is nothing to refine, or nothing to see."""
        if self._found is None:
            return None
        try:
            tracked: RotationEstimate = self._track(image, self.goal, self._found)
        except ReorientError:  # the goal was checked: it is the image that shows too little
            return None
        return tracked

    def _searched(self, image: DepthImage) -> RotationEstimate | None:
        """The estimate without initial guess; None where it is not sure, or the image shows too little."""
        try:
            estimate = self.estimator.estimate(image, self._searched_goal)
        except ReorientError:
            return None
        return self.restart(estimate) if _is_sure(estimate) else None


def _confidence(estimate: RotationEstimate | None) -> float:
    """Of a rotation, 0 of none; an estimator without confidence is trusted until ``track`` doubts it."""
    if estimate is None:
        return 0.0
    return 1.0 if estimate.confidence is None else estimate.confidence


def _is_sure(estimate: RotationEstimate) -> bool:
    """Whether the rotation counts as known."""
    return _confidence(estimate) >= LOST_BELOW
