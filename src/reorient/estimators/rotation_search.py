"""The estimator for any rotation: search hypotheses (``search``), verify them (``verifier``), polish the best.

It needs no GPU, no model of the object and no initial guess. The answer comes with a calibrated confidence, and with
the other rotations that fit where the object is symmetric or the two views leave the rotation open.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import cpu_count
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from reorient.errors import ReorientError, unknown_name
from reorient.estimators.base import History, RotationEstimate, check_pair, checked_history
from reorient.estimators.confidence_sets import candidate_sets
from reorient.estimators.equivalents import smallest_equivalent
from reorient.estimators.goal_symmetry import NONE, Symmetry, supported, symmetries
from reorient.estimators.polish import expected_covariance, polish, uncertainty
from reorient.estimators.search import EFFORTS, Found, search
from reorient.estimators.static_part import find_static_part
from reorient.estimators.threads import threads
from reorient.estimators.tracking import track
from reorient.estimators.views_verifier import assess
from reorient.imaging import DepthImage, Goal
from reorient.registration import (
    EVIDENCE_POINTS,
    INLIER_TOLERANCE,
    DepthView,
    Problem,
    aligned_goal,
    build_problem,
    non_maximum_suppression,
    posed_views,
)
from reorient.runs.pool import Pool

DISTINCT_RAD = np.radians(12)  # two hypotheses closer than this are one answer
POSSIBLE = 0.01  # probability: a less likely hypothesis is in no confidence set
ALTERNATIVE_ABOVE = 0.25  # of the answer's probability: a less likely hypothesis is no alternative
ENOUGH = 0.9  # confidence of a short search after which no longer one follows; docs/tuning.md, "Effort"
SURE = 0.9  # probability above which a known pivot is not doubted, and a hypothesis is as good as the answer
CONTRADICTED2 = 5.0  # squared Mahalanobis distance of a motion from leaving the pivot in place that contradicts it
IMPOSSIBLE2 = 50.0  # the same, however unlikely that motion is
DOUBTED = 0.49  # largest confidence of an answer that part of the image contradicts
LEAST_COVISIBLE, UNSUPPORTED = 0.05, 0.1  # with a smaller co-visible inlier ratio the confidence is at most the latter


class RotationSearch:
    """Any rotation, with a calibrated confidence and alternatives."""

    several_views: ClassVar[bool] = True

    def __init__(self, effort: str | None = None, threads: int | None = 1) -> None:
        """``effort``: of the search, fast or normal; None: a part of fast, and normal where that leaves doubt.
        ``threads``: of the linear algebra of one estimate; None: as the library is set.

        Raises ReorientError for an unknown effort.
        """
        if effort is not None and effort not in EFFORTS:
            raise unknown_name("effort", effort, list(EFFORTS))
        self._effort, self._threads = effort, threads

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage | Goal,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; of the history the captures that show the most new are used."""
        check_pair(current, goal, pivot_m)
        with threads(self._threads):
            goal, warnings = aligned_goal(goal, pivot_m)
            problem = build_problem(current, goal, pivot_m, checked_history(history))
            verified = self._without_wrong_pivot(self._verified(problem))
            return polished(self._without_static_part(verified).with_warning(*warnings), symmetries(goal))

    def track(self, current: DepthImage, goal: DepthImage | Goal, previous: RotationEstimate) -> RotationEstimate:
        """The motion near ``previous``, an estimate of a moment ago: see ``reorient.estimators.tracking.track``."""
        return track(current, goal, previous)

    def _verified(self, problem: Problem) -> "Verified":
        """The hypotheses of a search, verified; with no fixed effort, of a short one unless that leaves doubt."""
        if self._effort is not None:
            return self._fully_verified(problem)
        short = verify(problem, search(problem, EFFORTS["fast"], robust=False), "fast")
        return short if short.confidence >= ENOUGH else self._fully_verified(problem)

    def _fully_verified(self, problem: Problem) -> "Verified":
        effort = self._effort or "normal"
        return verify(problem, search(problem, EFFORTS[effort]), effort)

    def _without_wrong_pivot(self, verified: "Verified") -> "Verified":
        """The hypotheses without the pivot where they are verified with it only poorly, and better without it."""
        prior = verified.problem.prior
        if not prior.known or verified.confidence >= SURE:
            return verified
        freely = self._fully_verified(verified.problem.without_pivot)
        best = freely.found.hypotheses[np.array([freely.best])]
        distance2 = prior.mahalanobis2(best.R, best.t_m)[0]
        more_likely = freely.confidence > max(verified.confidence, DOUBTED)
        if distance2 <= (CONTRADICTED2 if more_likely else IMPOSSIBLE2):
            return verified
        error_cm = 100 * prior.error_m(best.R[0], best.t_m[0])
        return freely.with_warning(
            f"the images contradict the pivot, which would be {error_cm:.1f} cm off: it was not used (is it the centre "
            "about which the object rotates, in camera axes?)"
        )

    def _without_static_part(self, verified: "Verified") -> "Verified":
        """The hypotheses without the part of the image that did not move, if there is one."""
        best = verified.found.hypotheses[np.array([verified.best])]
        static = find_static_part(verified.problem, best.R[0], best.t_m[0], verified.confidence >= SURE)
        if static is None:
            return verified
        message = f"part of the image did not move ({static.share:.0%} of the returns): "
        if static.rest is None:
            return verified.with_warning(message + "remove it (--mask, --box, --remove-plane)").at_most(DOUBTED)
        rest = self._verified(static.rest)
        if not static.still and rest.confidence < verified.confidence:
            return verified
        return rest.with_warning(message + "the estimate is of the rest", *verified.warnings)

    def final_covariance(self, current: DepthImage, goal: DepthImage | Goal) -> Float[np.ndarray, "3 3"]:
        """Covariance (rad^2) of an estimate at the goal pose, by the goal's shape and the noise of the images."""
        check_pair(current, goal)
        with threads(self._threads):
            aligned, _ = aligned_goal(goal)
            projection = symmetries(aligned).projection(np.zeros(3), 1.0)[:3, :3]
            covariance = expected_covariance(DepthView(current), posed_views(aligned))
            return np.asarray(projection @ covariance @ projection.T)

    def estimate_many(
        self,
        pairs: Sequence[tuple[DepthImage, DepthImage | Goal]],
        pivots_m: Sequence[Float[np.ndarray, "3"] | None] | None = None,
        workers: int | None = None,
    ) -> list[RotationEstimate]:
        """``estimate`` for many (current, goal) pairs on several processes (``workers`` None: one a core).

        Raises ReorientError where ``pivots_m`` has another length than ``pairs``.
        """
        pivots = [None] * len(pairs) if pivots_m is None else list(pivots_m)
        if len(pivots) != len(pairs):
            raise ReorientError(f"{len(pivots)} pivots for {len(pairs)} pairs: expected one each, or no pivots_m")
        pool = Pool(max(min(workers or cpu_count() or 1, len(pairs)), 1))
        tasks = [(*pair, pivot_m) for pair, pivot_m in zip(pairs, pivots, strict=True)]
        return list(pool.map(lambda task: self.estimate(*task), tasks))


@dataclass(frozen=True, eq=False)
class Verified:
    """The hypotheses of a problem, and how probable each is."""

    problem: Problem
    found: Found
    log_odds: Float[np.ndarray, " k"]
    probability: Float[np.ndarray, " k"]
    warnings: tuple[str, ...] = ()

    @property
    def best(self) -> int:
        """The most likely hypothesis."""
        return int(np.argsort(-self.log_odds, kind="stable")[0])

    @property
    def confidence(self) -> float:
        """Its probability."""
        return float(self.probability[self.best])

    def with_warning(self, *warnings: str) -> "Verified":
        """The same with warnings before those that there are."""
        return replace(self, warnings=(*warnings, *self.warnings))

    def at_most(self, probability: float) -> "Verified":
        """The same with no hypothesis more probable than this."""
        return replace(self, probability=np.minimum(self.probability, probability))


def verify(problem: Problem, found: Found, effort: str) -> Verified:
    """The probability of each hypothesis of a search with that effort, from all pairs of views."""
    return Verified(problem, found, *assess(problem, found.hypotheses, effort))


def polished(verified: Verified, symmetry: Symmetry = NONE) -> RotationEstimate:
    """The most likely hypothesis, polished, and the alternatives to it. ``symmetry``: of the goal."""
    hypotheses, probability, best = verified.found.hypotheses, verified.probability, verified.best
    possible = np.nonzero((probability > POSSIBLE) | (probability >= probability[best]))[0]
    # the best first
    distinct = possible[non_maximum_suppression(hypotheses.R[possible], verified.log_odds[possible], DISTINCT_RAD)]
    problem = verified.problem if verified.found.silhouettes[best] else verified.problem.without_silhouettes
    equivalent = distinct[1:][probability[distinct[1:]] >= SURE]  # a flip that only fits alike may be no symmetry
    chosen, axis = smallest_equivalent(problem, hypotheses[np.array([best])], hypotheses[equivalent])
    symmetry = supported(verified.problem, chosen, symmetry)
    chosen = symmetry.smallest(chosen)
    others = distinct[symmetry.apart_rad(hypotheses.R[distinct], chosen.R[0]) > DISTINCT_RAD]
    if symmetry:  # what is the same counts once
        distinct = np.union1d([best], others)
    share = probability / max(float(probability[distinct].sum()), 1.0)  # normalised only if they sum to more than 1
    near, also = (x.nearest_views(chosen.R[0]) for x in (problem, verified.problem))
    answer = polish(near, chosen, *([] if verified.found.silhouettes[best] else [also]))
    projection = symmetry.projection(near.prior.goal_m, near.diameter_m / 2)
    covariance, converged = uncertainty(near, answer, projection)
    hypothesis = answer.hypothesis if symmetry.axis is None else symmetry.smallest(answer.hypothesis)
    motion = hypothesis.R[0], hypothesis.t_m[0]
    evidence = verified.problem.evidence(*motion, INLIER_TOLERANCE * problem.diameter_m, EVIDENCE_POINTS)
    unsupported = not evidence.covisible_inlier_ratio >= LEAST_COVISIBLE  # also if it is NaN
    confidence = min(verified.confidence, UNSUPPORTED) if unsupported else verified.confidence
    named = [(motion[0], min(confidence, float(share[best]))), *((hypotheses.R[i], float(share[i])) for i in others)]
    candidates, guaranteed = candidate_sets(named, verified.problem, evidence)
    return RotationEstimate(
        *motion,
        replace(evidence, converged=converged, iterations=answer.iterations),
        confidence=confidence,
        alternatives=tuple(
            (hypotheses.R[i], float(share[i])) for i in others if probability[i] > ALTERNATIVE_ABOVE * probability[best]
        ),
        covariance_rad2=covariance[:3, :3],
        motion_covariance=covariance,
        free_axis=axis if symmetry.axis is None else symmetry.axis,
        symmetries=tuple(symmetry.rotations),
        warnings=verified.warnings,
        candidates=candidates,
        guaranteed=guaranteed,
    )
