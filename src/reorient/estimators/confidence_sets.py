"""Sets of rotations that hold the truth with a stated probability: split-conformal calibration.

The verifier gives each candidate a probability. On held-out objects it is recorded which probability the truth had, 0
where no candidate was within 5 degrees of it. Of n such estimates, a set of level a holds every candidate with at least
the probability that the truth had in k = ceil(a (n + 1)) of them; it misses the truth of one more like these in at most
1 - a of the cases, whatever the verifier is worth (Vovk et al., Algorithmic Learning in a Random World, 2005). Where
the truth was among the candidates in fewer than k of them, no such set exists.

That holds over estimates of one group: the same number of views (one pair, or more), noise as the images show it, and
probability that the candidates have in all.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from reorient.estimators.base import Candidate
from reorient.estimators.calibration import load_calibration
from reorient.estimators.views_verifier import fingerprint
from reorient.registration import Evidence, Problem

NOISE = (0.0055,)  # residual of the inliers, relative to the object diameter, that separate groups
FOUND = (0.5, 0.8)  # probability of all candidates together that separates groups
Rotation = Float[np.ndarray, "3 3"]


def group_of(views: int, noise: float, found: float) -> str:
    """The group of an estimate: its pairs of views, the residual of its inliers, the probability of all candidates."""
    kind = "one pair of views" if views == 1 else "several pairs"
    return f"{kind}, noise {np.searchsorted(NOISE, noise)}, found {np.searchsorted(FOUND, found)}"


def candidate_sets(
    named: Sequence[tuple[Rotation, float]], problem: Problem, evidence: Evidence
) -> tuple[tuple[Candidate, ...], float]:
    """The candidates of an estimate from its distinct rotations with their probabilities, the answer first; and the
    largest level of their confidence sets, 0 where the verifier is not the calibrated one."""
    views = len(problem.views_now) * len(problem.goal_views)
    noise = float(np.nan_to_num(evidence.residual_m)) / problem.diameter_m
    group, calibration = group_of(views, noise, sum(p for _, p in named)), load_calibration()
    if calibration.verifiers[views > 1] != fingerprint(views > 1) or group not in calibration.truth:
        return tuple(Candidate(R, p, 1.0) for R, p in named), 0.0
    candidates = [Candidate(R, p, calibration.level(group, p)) for R, p in named]
    return tuple(candidates), calibration.guaranteed(group)
