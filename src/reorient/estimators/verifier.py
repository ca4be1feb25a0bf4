"""The verifier: how probable it is that each hypothesis is right, from the evidence of both images.

Some hundred features of each hypothesis, absolute and relative to the rest of its set, go through boosted trees that
were trained on hypotheses of known error (``reorient.learning.verifier``). The trees are plain arrays in
``verifier.npz``; its card is ``verifier.md``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError, in_short, reason_of
from reorient.registration import INLIER_TOLERANCE, DepthView, Hypotheses, Problem, normal_equations
from reorient.registration.hypotheses import rotate

WEIGHTS = Path(__file__).with_name("verifier.npz")
TOLERANCES = tuple(factor * INLIER_TOLERANCE for factor in (0.25, 0.5, 1, 2))  # relative to the object diameter
POINTS = 1000  # of each image
MOST_DEPTH = 100  # of a tree

_ONE_WAY = (
    *(f"inlier {tolerance}" for tolerance in TOLERANCES),
    *(f"free space {tolerance}" for tolerance in TOLERANCES[1:]),
    *(f"covisible inlier {tolerance}" for tolerance in TOLERANCES[1:3]),
    *("silhouette", "far outside silhouette", "unknown", "occluded", "occluded and facing", "depth occluded"),
    *("mean residual", "median residual", "normals agree", "normals differ", "relief across", "relief along"),
)
_OWN = (
    *("angle", "rotation uncertainty", "shift uncertainty", "prior distance2", "shift of centre", "pivot known"),
    "returns",
)
_OF_SET = (
    *("score", "less than best", "lead over next", "place", "near a better one", "competing"),
    *("score without silhouettes", "less than best without silhouettes"),
)
_BOTH_WAYS = (*(f"least {x}" for x in _ONE_WAY), *(f"most {x}" for x in _ONE_WAY))
FEATURES = (
    *_BOTH_WAYS,
    *(f"{x} less the best's" for x in _BOTH_WAYS),
    *(f"{x} less the mean" for x in _BOTH_WAYS),
    *_OWN,
    *_OF_SET,
)


def features(problem: Problem, hypotheses: Hypotheses) -> Float[np.ndarray, "k f"]:
    """The features, one column for each of ``FEATURES``, of all hypotheses of a problem of two views."""
    ways = np.stack(
        [
            _one_way(problem.current, problem.goal, hypotheses, problem.diameter_m),
            _one_way(problem.goal, problem.current, hypotheses.inverse, problem.diameter_m),
        ]
    )
    inlier, free_space, silhouette = (
        ways[:, :, _ONE_WAY.index(name)]
        for name in (f"inlier {INLIER_TOLERANCE}", f"free space {INLIER_TOLERANCE}", "silhouette")
    )
    without_silhouettes = (inlier - free_space).mean(axis=0)
    score = without_silhouettes - silhouette.mean(axis=0)
    both = np.concatenate([ways.min(axis=0), ways.max(axis=0)], axis=1)
    of_set = _of_set(hypotheses.R, score, without_silhouettes)
    relative = both - both[np.argmax(score)], both - both.mean(axis=0)
    return np.concatenate([both, *relative, _own(problem, hypotheses), of_set], axis=1)


def _one_way(
    source: DepthView, target: DepthView, hypotheses: Hypotheses, diameter_m: float
) -> Float[np.ndarray, "k f"]:
    """Features of one image's points in the other's view."""
    motion = hypotheses.single()
    x = motion.move(source.sample(POINTS))
    warped = target.warp(x)
    difference = warped.difference_m / np.float32(diameter_m)
    outside = warped.silhouette_violation()
    own = rotate(motion.R, source.sample_normals(POINTS))
    cosine = np.sum(np.stack(target.planes(warped.pixel)[:3], axis=1) * own, axis=1)
    fits = np.abs(difference) <= TOLERANCES[-1]
    residual = np.where(fits, np.abs(difference), np.nan)
    residual[~fits.any(axis=1)] = TOLERANCES[-1]
    count = np.maximum(fits.sum(axis=1), 1)
    silhouette = outside.mean(axis=1)
    inlier = [(np.abs(difference) <= tolerance).mean(axis=1) for tolerance in TOLERANCES]
    free_space = [(~outside & (difference < -tolerance)).mean(axis=1) for tolerance in TOLERANCES[1:]]
    unknown = warped.unknown()
    occluded = ~unknown & (difference > INLIER_TOLERANCE)
    spread = (own * fits[:, None]) @ np.swapaxes(own, 1, 2) / count[:, None, None]  # small for flat faces
    relief = np.linalg.eigvalsh(spread)
    columns = [
        *inlier,
        *free_space,
        *(x / np.maximum(x + y + silhouette, 1e-3) for x, y in zip(inlier[1:3], free_space[:2], strict=True)),
        silhouette,
        (target.outside_px(warped.pixel) > 3).mean(axis=1),
        unknown.mean(axis=1),
        occluded.mean(axis=1),
        (occluded & (np.sum(own * x, axis=1) < 0)).mean(axis=1),
        np.where(occluded, difference, 0).sum(axis=1) / np.maximum(occluded.sum(axis=1), 1),
        np.nanmean(residual, axis=1),
        np.nanmedian(residual, axis=1),
        np.where(fits, cosine, 0).sum(axis=1) / count,
        (fits & (cosine < 0.7)).sum(axis=1) / count,
        relief[:, 0],
        relief[:, 1],
    ]
    return np.stack(columns, axis=1).astype(float)


def _own(problem: Problem, hypotheses: Hypotheses) -> Float[np.ndarray, "k f"]:
    """Features of the motion itself, and of how well the images determine it."""
    prior = problem.prior
    H, _ = normal_equations(problem, hypotheses, INLIER_TOLERANCE, POINTS // 2)
    covariance = np.linalg.inv(H + 1e-6 * np.eye(6))
    rotation, shift = (np.linalg.eigvalsh(covariance[:, part, part])[:, -1] for part in (slice(3), slice(3, 6)))
    center_m = (hypotheses.R @ prior.current_m) + hypotheses.t_m - prior.goal_m
    k = len(hypotheses)
    columns = [
        so3.angle(hypotheses.R),
        np.log(np.maximum(rotation, 1e-12)) / 2,
        np.log(np.maximum(shift, 1e-12)) / 2,
        np.minimum(prior.mahalanobis2(hypotheses.R, hypotheses.t_m), 100.0),
        np.linalg.norm(center_m, axis=1) / prior.diameter_m,
        np.full(k, float(prior.known)),
        np.full(k, np.log(min(len(view.points_m) for view in (problem.current, problem.goal)))),
    ]
    return np.stack(columns, axis=1)


def _of_set(
    R: Float[np.ndarray, "k 3 3"], score: Float[np.ndarray, " k"], without_silhouettes: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k f"]:
    """Features relative to the other hypotheses."""
    k = len(R)
    between = so3.angle_difference(R[:, None], R[None])
    better = score[None] > score[:, None]
    others = np.where(np.eye(k, dtype=bool), -np.inf, score[None])
    next_best = others.max(axis=1) if k > 1 else np.full(k, -1.0)
    columns = [
        score,
        score.max() - score,
        score - np.maximum(next_best, -1.0),
        better.sum(axis=1),
        np.where(better, between, np.pi).min(axis=1),
        np.sum((others > score[:, None] - 0.05) & (between > np.radians(10)), axis=1),
        without_silhouettes,
        without_silhouettes.max() - without_silhouettes,
    ]
    return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class Verifier:
    """Boosted trees as arrays: every tree padded to the same number of nodes, a leaf pointing to itself."""

    feature: np.ndarray
    """(trees, nodes) index of the feature that a node compares."""
    threshold: np.ndarray
    """(trees, nodes) go left where the feature is at most this."""
    left: np.ndarray
    right: np.ndarray
    value: np.ndarray
    """(trees, nodes) log-odds that a leaf adds."""
    depth: int
    baseline: float
    calibration: Mapping[str, tuple[float, float]]
    """By effort or number of goal views: scale and shift of the chosen hypothesis's log-odds, from held-out objects."""

    def log_odds(self, values: Float[np.ndarray, "k f"]) -> Float[np.ndarray, " k"]:
        """Log-odds of the trees that the symmetry-aware error of each hypothesis is below 5 degrees."""
        trees = np.arange(len(self.feature))[None]
        node = np.zeros((len(values), len(self.feature)), int)
        rows = np.arange(len(values))[:, None]
        for _ in range(self.depth):
            goes_left = values[rows, self.feature[trees, node]] <= self.threshold[trees, node]
            node = np.where(goes_left, self.left[trees, node], self.right[trees, node])
        return np.asarray(self.value[trees, node].sum(axis=1) + self.baseline)

    def probability(self, log_odds: Float[np.ndarray, " k"], group: str) -> Float[np.ndarray, " k"]:
        """Calibrated probability; by effort, as a longer search leaves more wrong hypotheses that fit well, or by the
        number of goal views."""
        if group not in self.calibration:
            raise ReorientError(
                f"the verifier is not calibrated for {group!r}: expected one of {list(self.calibration)}"
            )
        scale, shift = self.calibration[group]
        return 1 / (1 + np.exp(-(scale * log_odds + shift)))


@cache
def load_verifier(path: Path = WEIGHTS, expected: tuple[str, ...] = FEATURES) -> Verifier:
    """The verifier of the package. Raises ReorientError for another kind of file, and for other features."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            names = tuple(arrays["features"].tolist())
            trees = {name: arrays[name] for name in ("feature", "threshold", "left", "right", "value")}
            calibration = dict(zip(arrays["efforts"].tolist(), map(tuple, arrays["calibration"].tolist()), strict=True))
            depth, baseline = int(arrays["depth"]), float(arrays["baseline"])
            if not (0 <= depth <= MOST_DEPTH and calibration):
                raise ValueError(f"trees of depth {in_short(depth)}, {len(calibration)} calibrations")
            verifier = Verifier(**trees, depth=depth, baseline=baseline, calibration=calibration)
            verifier.log_odds(np.zeros((1, len(names))))  # of trees that fit together
    except Exception as error:
        raise ReorientError(
            f"cannot read the verifier {str(path)!r} ({reason_of(error)}): expected the package's verifier.npz"
        ) from error
    if names != expected:
        raise ReorientError(f"the verifier {str(path)!r} was trained on the features of another version: train it anew")
    return verifier
