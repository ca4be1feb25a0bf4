"""The estimator for any rotation: search hypotheses (``search``), verify them (``verifier``), polish the best.

It needs no GPU, no model of the object and no initial guess. The answer comes with a calibrated confidence, and with
the other rotations that fit where the object is symmetric or the two views leave the rotation open.
"""

from collections.abc import Sequence
from os import cpu_count

import numpy as np
from jaxtyping import Float

from reorient.errors import ReorientError, unknown_name
from reorient.estimators.base import History, RotationEstimate, check_pair, checked_history, with_evidence
from reorient.estimators.polish import covariance_rad2, polish
from reorient.estimators.search import EFFORTS, search
from reorient.estimators.verifier import Verifier, features, load_verifier
from reorient.imaging import DepthImage
from reorient.registration import Hypotheses, Problem, build_problem, non_maximum_suppression
from reorient.runs.pool import Pool

DISTINCT_RAD = np.radians(12)  # two hypotheses closer than this are one answer
ALTERNATIVE_ABOVE = 0.25  # of the answer's probability: a less likely hypothesis is no alternative


class RotationSearch:
    """Any rotation, with a calibrated confidence and alternatives; ``effort``: fast, normal or thorough."""

    def __init__(self, effort: str = "normal") -> None:
        """Raises ReorientError for an unknown effort."""
        if effort not in EFFORTS:
            raise unknown_name("effort", effort, list(EFFORTS))
        self._effort = effort

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; of the history the captures that show the most new are used."""
        check_pair(current, goal, pivot_m)
        problem = build_problem(current, goal, pivot_m, checked_history(history))
        return select_and_polish(problem, search(problem, EFFORTS[self._effort]), load_verifier(), self._effort)

    def estimate_many(
        self,
        pairs: Sequence[tuple[DepthImage, DepthImage]],
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


def select_and_polish(problem: Problem, hypotheses: Hypotheses, verifier: Verifier, effort: str) -> RotationEstimate:
    """The most likely hypothesis of a search with that effort, polished, and the alternatives to it."""
    by_observation = [verifier.log_odds(features(problem.only(x), hypotheses)) for x in problem.observations]
    log_odds = np.mean(by_observation, axis=0)
    probability = verifier.probability(log_odds, effort)
    best = int(np.argsort(-log_odds, kind="stable")[0])
    likely = np.nonzero(probability > ALTERNATIVE_ABOVE * probability[best])[0]
    distinct = likely[non_maximum_suppression(hypotheses.R[likely], log_odds[likely], DISTINCT_RAD)]  # the best first
    share = probability / max(float(probability[distinct].sum()), 1.0)  # normalised only if they sum to more than 1
    answer = polish(problem, hypotheses[np.array([best])])
    return with_evidence(
        problem.current,
        problem.goal,
        answer.hypothesis.R[0],
        answer.hypothesis.t_m[0],
        converged=answer.converged,
        iterations=answer.iterations,
        confidence=float(probability[best]),
        alternatives=tuple((hypotheses.R[i], float(share[i])) for i in distinct[1:]),
        covariance_rad2=covariance_rad2(problem, answer.hypothesis),
    )
