"""The judge: how likely each hypothesis is right, from what the two images say about it.

Some hundred figures of evidence for each hypothesis, absolute and against the rest of its set, go through boosted trees
that were trained on hypotheses of known error (``reorient.learning.verifier``). The trees are plain arrays in
``verifier.npz``; its card is ``verifier.md``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError
from reorient.registration.evidence import moved
from reorient.registration.refine import Hypotheses, Look, Problem, normal_equations
from reorient.registration.surface import Surface

WEIGHTS = Path(__file__).with_name("verifier.npz")
TOLERANCES = (0.00375, 0.0075, 0.015, 0.03)  # of the size: what still fits, finely to coarsely
MIDDLE = 0.015
POINTS = 1000  # of each image

_ONE_WAY = (
    *(f"fit {tolerance}" for tolerance in TOLERANCES),
    *(f"in front {tolerance}" for tolerance in TOLERANCES[1:]),
    *(f"explained {tolerance}" for tolerance in TOLERANCES[1:3]),
    *("outside", "far outside", "behind", "behind and facing", "depth behind", "mean residual", "median residual"),
    *("normals agree", "normals differ", "relief across", "relief along"),
)
_OWN = ("angle", "turn uncertainty", "shift uncertainty", "surprise", "shift of centre", "pivot known", "returns")
_OF_SET = ("agreement", "less than best", "lead over next", "place", "near a better one", "rivals")
_BOTH_WAYS = (*(f"least {x}" for x in _ONE_WAY), *(f"most {x}" for x in _ONE_WAY))
FEATURES = (
    *_BOTH_WAYS,
    *(f"{x} beyond the best" for x in _BOTH_WAYS),
    *(f"{x} beyond the mean" for x in _BOTH_WAYS),
    *_OWN,
    *_OF_SET,
)


def features(problem: Problem, look: Look, hypotheses: Hypotheses) -> Float[np.ndarray, "k f"]:
    """The figures, one column for each of ``FEATURES``, of all hypotheses of a pair as one look sees them."""
    alone = Problem((look,), problem.goal, problem.frame)
    then = hypotheses.after(look.R_now_then, look.t_now_then_m)
    ways = np.stack(
        [
            _one_way(look.surface, problem.goal, then.R, then.t_m, problem.frame.size_m),
            _one_way(problem.goal, look.surface, *_inverse(then), problem.frame.size_m),
        ]
    )
    fit, front, outside = (
        ways[:, :, _ONE_WAY.index(name)] for name in (f"fit {MIDDLE}", f"in front {MIDDLE}", "outside")
    )
    agreement = (fit - front - outside).mean(axis=0)
    both = np.concatenate([ways.min(axis=0), ways.max(axis=0)], axis=1)
    against_set = both - both[np.argmax(agreement)], both - both.mean(axis=0)
    return np.concatenate([both, *against_set, _own(alone, hypotheses), _of_set(then.R, agreement)], axis=1)


def _inverse(hypotheses: Hypotheses) -> tuple[Float[np.ndarray, "k 3 3"], Float[np.ndarray, "k 3"]]:
    R = np.swapaxes(hypotheses.R, 1, 2)
    return R, -(R @ hypotheses.t_m[:, :, None])[:, :, 0]


def _one_way(
    source: Surface, target: Surface, R: Float[np.ndarray, "k 3 3"], t_m: Float[np.ndarray, "k 3"], size_m: float
) -> Float[np.ndarray, "k f"]:
    """One image's points in the other's view."""
    points = source.sample(POINTS)
    x = moved(R.astype(np.float32), t_m.astype(np.float32), points)
    place = target.pixels(x[:, 0], x[:, 1], x[:, 2])
    gap_px = target.gap_px(place)
    on = gap_px <= 0
    beyond = (x[:, 2] - target.depth_m(place)) / np.float32(size_m)
    normals = np.stack(target.planes(place)[:3], axis=1)
    own = moved(R.astype(np.float32), np.zeros((len(R), 3), np.float32), source.sampled_normals(POINTS))
    cosine = np.sum(normals * own, axis=1)
    fits = on & (np.abs(beyond) <= TOLERANCES[-1])
    residual = np.where(fits, np.abs(beyond), np.nan)
    empty = ~fits.any(axis=1)
    residual[empty] = TOLERANCES[-1]
    count = np.maximum(fits.sum(axis=1), 1)
    outside = (~on).mean(axis=1)
    fit = [(on & (np.abs(beyond) <= tolerance)).mean(axis=1) for tolerance in TOLERANCES]
    front = [(on & (beyond < -tolerance)).mean(axis=1) for tolerance in TOLERANCES[1:]]
    behind = on & (beyond > MIDDLE)
    spread = (own * fits[:, None]) @ np.swapaxes(own, 1, 2) / count[:, None, None]  # flat faces say little: small
    relief = np.linalg.eigvalsh(spread)
    columns = [
        *fit,
        *front,
        *(x / np.maximum(x + y + outside, 1e-3) for x, y in zip(fit[1:3], front[:2], strict=True)),
        outside,
        (gap_px > 3).mean(axis=1),
        behind.mean(axis=1),
        (behind & (np.sum(own * x, axis=1) < 0)).mean(axis=1),
        np.where(behind, beyond, 0).sum(axis=1) / np.maximum(behind.sum(axis=1), 1),
        np.nanmean(residual, axis=1),
        np.nanmedian(residual, axis=1),
        np.where(fits, cosine, 0).sum(axis=1) / count,
        (fits & (cosine < 0.7)).sum(axis=1) / count,
        relief[:, 0],
        relief[:, 1],
    ]
    return np.stack(columns, axis=1).astype(float)


def _own(problem: Problem, hypotheses: Hypotheses) -> Float[np.ndarray, "k f"]:
    """Figures of the motion itself, and of how well the evidence pins it down."""
    frame = problem.frame
    H, _ = normal_equations(problem, hypotheses, MIDDLE, POINTS // 2)
    covariance = np.linalg.inv(H + 1e-6 * np.eye(6))
    turn, shift = (np.linalg.eigvalsh(covariance[:, part, part])[:, -1] for part in (slice(3), slice(3, 6)))
    center_m = (hypotheses.R @ frame.turning_m) + hypotheses.t_m - frame.center_m
    k = len(hypotheses)
    columns = [
        so3.angle(hypotheses.R),
        np.log(np.maximum(turn, 1e-12)) / 2,
        np.log(np.maximum(shift, 1e-12)) / 2,
        np.minimum(frame.surprise(hypotheses.R, hypotheses.t_m), 100.0),
        np.linalg.norm(center_m, axis=1) / frame.size_m,
        np.full(k, float(frame.pivot_known)),
        np.full(k, np.log(min(len(x.all_points_m) for x in (problem.looks[0].surface, problem.goal)))),
    ]
    return np.stack(columns, axis=1)


def _of_set(R: Float[np.ndarray, "k 3 3"], agreement: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k f"]:
    """Figures against the other hypotheses."""
    k = len(R)
    between = so3.angle_difference(R[:, None], R[None])
    better = agreement[None] > agreement[:, None]
    others = np.where(np.eye(k, dtype=bool), -np.inf, agreement[None])
    next_best = others.max(axis=1) if k > 1 else np.full(k, -1.0)
    columns = [
        agreement,
        agreement.max() - agreement,
        agreement - np.maximum(next_best, -1.0),
        better.sum(axis=1),
        np.where(better, between, np.pi).min(axis=1),
        np.sum((others > agreement[:, None] - 0.05) & (between > np.radians(10)), axis=1),
    ]
    return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class Judge:
    """Boosted trees as arrays: every tree padded to the same number of nodes, a leaf pointing to itself."""

    feature: np.ndarray
    """(trees, nodes) which figure a node asks about."""
    threshold: np.ndarray
    """(trees, nodes) go left where the figure is at most this."""
    left: np.ndarray
    right: np.ndarray
    value: np.ndarray
    """(trees, nodes) log odds that a leaf adds."""
    depth: int
    baseline: float
    calibration: Mapping[str, tuple[float, float]]
    """By effort, scale and shift of the log odds of the chosen hypothesis, from held-out objects."""

    def log_odds(self, figures: Float[np.ndarray, "k f"]) -> Float[np.ndarray, " k"]:
        """That the symmetry-aware error of each hypothesis is below 5 degrees, as the trees say."""
        trees = np.arange(len(self.feature))[None]
        node = np.zeros((len(figures), len(self.feature)), int)
        rows = np.arange(len(figures))[:, None]
        for _ in range(self.depth):
            goes_left = figures[rows, self.feature[trees, node]] <= self.threshold[trees, node]
            node = np.where(goes_left, self.left[trees, node], self.right[trees, node])
        return self.value[trees, node].sum(axis=1) + self.baseline

    def probability(self, log_odds: Float[np.ndarray, " k"], effort: str) -> Float[np.ndarray, " k"]:
        """Calibrated: a longer search leaves more that looks right and is not."""
        scale, shift = self.calibration[effort]
        return 1 / (1 + np.exp(-(scale * log_odds + shift)))


@cache
def load_judge(path: Path = WEIGHTS) -> Judge:
    """The judge of the package. Raises ReorientError for a file that is none, or one of other figures."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            names = tuple(arrays["features"].tolist())
            trees = {name: arrays[name] for name in ("feature", "threshold", "left", "right", "value")}
            calibration = dict(zip(arrays["efforts"].tolist(), map(tuple, arrays["calibration"].tolist()), strict=True))
            depth, baseline = int(arrays["depth"]), float(arrays["baseline"])
            judge = Judge(**trees, depth=depth, baseline=baseline, calibration=calibration)
    except (OSError, ValueError, KeyError) as error:
        raise ReorientError(
            f"cannot read the judge {str(path)!r} ({error}): expected the package's verifier.npz"
        ) from error
    if names != FEATURES:
        raise ReorientError(f"the judge {str(path)!r} was trained on figures of another version: train it anew")
    return judge
