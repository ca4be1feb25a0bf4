"""The verifier of several views: the probability of a hypothesis from the evidence of all pairs of views.

The verifier of two views gives log-odds for each pair of a view now and a goal view. Their evidence is not independent,
and a pair that hardly overlaps has little. So its log-odds and the most informative features of all pairs, as least,
mean and largest, go through boosted trees of their own, trained on problems of several views (``verifier-views.npz``;
its card is ``verifier-views.md``). With one goal view the mean of the log-odds is enough.
"""

import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.estimators import image_verifier
from reorient.estimators.image_verifier import with_images
from reorient.estimators.verifier import FEATURES, features, load_verifier
from reorient.registration import INLIER_TOLERANCE, Hypotheses, Problem

WEIGHTS = Path(__file__).with_name("verifier-views.npz")
POINTS = 1000  # of each image where there is one pair
LEAST_WEIGHT = 0.05  # of a pair, for the share of its points that are not occluded

_SUMMARISED = tuple(
    f"{way} {name}"
    for name in (
        *(f"{x} {INLIER_TOLERANCE}" for x in ("inlier", "covisible inlier", "free space")),
        *("silhouette", "occluded", "occluded and facing", "median residual", "normals agree"),
    )
    for way in ("least", "most")
)
_LOG_ODDS = ("largest", "second", "mean", "weighted mean", "least")
VIEWS_FEATURES = (
    *(f"{x} log-odds" for x in _LOG_ODDS),
    *(f"{x} log-odds less the best's" for x in _LOG_ODDS),
    *(f"{how} of {x}" for x in _SUMMARISED for how in ("least", "mean", "largest")),
    *("score", "less than best", "lead over next", "near a better one", "competing"),
    *("angle", "prior distance2", "pivot known", "views now", "goal views"),
)


def assess(
    problem: Problem, hypotheses: Hypotheses, effort: str
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """The log-odds of each hypothesis of a search with an effort, and its calibrated probability, from all pairs of
    views."""
    verifier = load_verifier()
    each = [features(*pair) for pair in problem.each_pair(hypotheses)]
    log_odds = np.stack([verifier.log_odds(x) for x in each])
    if len(each) == 1:
        by_trees = log_odds[0], verifier.probability(log_odds[0], effort)
        return with_images(problem, hypotheses, each[0], *by_trees, effort)
    if len(problem.goal_views) == 1:  # the data of several views has hardly any of them
        return log_odds.mean(axis=0), verifier.probability(log_odds.mean(axis=0), effort)
    of_views = load_verifier(WEIGHTS, VIEWS_FEATURES)
    combined = of_views.log_odds(views_features(problem, hypotheses, each, log_odds))
    return combined, of_views.probability(combined, group_of(len(problem.goal_views)))


def views_features(
    problem: Problem,
    hypotheses: Hypotheses,
    each: Sequence[Float[np.ndarray, "k f"]],
    log_odds: Float[np.ndarray, "pairs k"],
) -> Float[np.ndarray, "k g"]:
    """The features, one column for each of ``VIEWS_FEATURES``; ``each``: those of each pair, with its log-odds."""
    summary = _summary(each, log_odds)
    of_pairs = np.stack([[x[:, FEATURES.index(name)] for name in _SUMMARISED] for x in each])  # (pairs, names, k)
    stated = np.stack([of_pairs.min(axis=0), of_pairs.mean(axis=0), of_pairs.max(axis=0)], axis=1).reshape(
        -1, len(hypotheses)
    )
    k, prior = len(hypotheses), problem.prior
    own = [
        so3.angle(hypotheses.R),
        np.minimum(prior.mahalanobis2(hypotheses.R, hypotheses.t_m), 100.0),
        np.full(k, float(prior.known)),
        np.full(k, float(len(problem.views_now))),
        np.full(k, float(len(problem.goal_views))),
    ]
    of_set = _of_set(hypotheses, problem.image_score(hypotheses, INLIER_TOLERANCE, POINTS))
    return np.stack([*summary, *(summary - summary.max(axis=1, keepdims=True)), *stated, *of_set, *own], axis=1)


def _summary(
    each: Sequence[Float[np.ndarray, "k f"]], log_odds: Float[np.ndarray, "pairs k"]
) -> Float[np.ndarray, "5 k"]:
    """The log-odds of the pairs as in ``_LOG_ODDS``; the weight of a pair is the share of its points not occluded."""
    hidden = [
        sum(x[:, FEATURES.index(f"{way} {name}")] for way in ("least", "most") for name in ("occluded", "unknown")) / 2
        for x in each
    ]
    weight = np.clip(1 - np.stack(hidden), LEAST_WEIGHT, 1)
    ordered = np.sort(log_odds, axis=0)
    weighted = (weight * log_odds).sum(axis=0) / weight.sum(axis=0)
    return np.stack([ordered[-1], ordered[-2], log_odds.mean(axis=0), weighted, ordered[0]])


def _of_set(hypotheses: Hypotheses, score: Float[np.ndarray, " k"]) -> list[Float[np.ndarray, " k"]]:
    """The score, and how it compares with those of the other hypotheses."""
    k = len(hypotheses)
    between = so3.angle_difference(hypotheses.R[:, None], hypotheses.R[None])
    others = np.where(np.eye(k, dtype=bool), -np.inf, score[None])
    return [
        score,
        score.max() - score,
        score - np.maximum(others.max(axis=1), -1.0),
        np.where(score[None] > score[:, None], between, np.pi).min(axis=1),
        np.sum((others > score[:, None] - 0.05) & (between > np.radians(10)), axis=1).astype(float),
    ]


def group_of(goal_views: int) -> str:
    """The name of the calibration of so many goal views."""
    return f"{min(goal_views, 6)} goal views"


@cache
def fingerprint(several: bool = False) -> str:
    """Of all that ``assess`` uses, for one pair of views or for several: what was calibrated with other verifiers does
    not hold."""
    found = (load_verifier(), load_verifier(WEIGHTS, VIEWS_FEATURES)) if several else (load_verifier(),)
    parts = [x.value.tobytes() + repr(sorted(x.calibration.items())).encode() for x in found]
    if not several:
        parts.append(image_verifier.WEIGHTS.read_bytes())
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]
