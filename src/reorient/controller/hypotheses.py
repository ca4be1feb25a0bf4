"""Hypotheses about the goal's orientation, from the observations of all viewpoints.

Rotations are relative to the start of a chain of known motions: R_then_start takes the object from there to a
viewpoint, R_goal_start to the goal. Each estimate gives a probability to its answer and to its alternatives. All these
rotations are clustered into hypotheses, and so are the flips of arrivals. The log-odds of a hypothesis are those by the
estimates (naive Bayes within bounds) and those of the viewpoints at it, by their arrival tests. Hypotheses with a test
are compared with each other by the likelihood of the depth differences.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.agreed_symmetry import AgreedSymmetry
from reorient.controller.arrival import Arrival, ArrivalTest, Observation, PoseSettings, PreparedImage
from reorient.controller.symmetry import Flip, SymmetryTest
from reorient.estimators.base import RotationEstimate

LEAST_PROBABILITY = 0.02
"""Of a rotation by one estimate. Not tuned."""


@dataclass(frozen=True, kw_only=True)
class BeliefSettings(PoseSettings):
    """How observations become hypotheses and their log-odds."""

    arrival_test: Callable[[Sequence[Observation], PreparedImage], Arrival] = field(default_factory=ArrivalTest)
    symmetry_test: SymmetryTest = field(default_factory=SymmetryTest)
    new_view_rad: float = float(np.radians(10))
    """Viewpoints nearer to each other than this show the same and err alike; they count once. Not tuned."""
    unnamed: float = 0.1
    """Fraction of an estimate's unassigned probability given to each hypothesis that it does not name. Not tuned."""
    views_against: float = -4.0
    """Lower bound on a hypothesis's log-odds by the estimates of all viewpoints, relative to the likeliest hypothesis
    (<= 0), as viewpoints err alike. Loops of tuning objects (61a9af1)."""
    views_against_tested: float = -1.0
    """The same for a hypothesis with an arrival test. Loops of tuning objects (61a9af1)."""
    max_compared: int = 4
    """Observations of one pose that count in comparisons: all err alike with the one goal image. Chosen after a look at
    failed loops of the reporting half (277b42b)."""
    spread_rad: float = float(np.radians(0.3))
    """Typical error of one estimate near the goal. Loops of tuning objects (ed0cd77)."""
    drift: float = 0.05
    """Error that an estimate gains by later motions, radians per radian. Not tuned."""


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """All observations of one pose."""

    observations: tuple[Observation, ...]
    R_then_start: Float[np.ndarray, "3 3"]
    path_rad: float = 0.0
    """Sum of the angles of all motions from the start."""
    arrival: Arrival | None = None
    """The arrival test; None unless the estimates stay near this pose, and there are two observations."""
    flips: tuple[Flip, ...] = ()
    """With an arrival test: the flips of this pose, unless an earlier viewpoint has them."""

    def log_odds(self, settings: BeliefSettings) -> float:
        """That this pose is the goal pose: by the estimates' own confidence, and by the arrival test."""
        own = np.mean([_confidence_here(x.estimate, settings.same_rad) for x in self.observations])
        own = np.clip(own, LEAST_PROBABILITY, 0.99)
        return float(np.log(own / (1 - own))) + (self.arrival.log_odds if self.arrival else 0.0)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One orientation that the goal may have, and those that are the same to the object."""

    R_goal_start: Float[np.ndarray, "3 3"]
    """Of these, the one nearest the start."""
    probabilities: Mapping[int, Sequence[float]] = field(default_factory=dict)
    """By viewpoint (its index), the probability by each estimate that names it."""
    flip_loss: float = float("inf")
    """Least score loss as a flip of an arrival."""
    visits: int = 0
    """Number of viewpoints at it."""
    arrival_log_odds: float = float("-inf")
    """The largest log-odds of their arrival tests; minus infinity without one."""
    view_log_probability: float = 0.0
    """Sum over distinct views of the mean log-probability that their estimates give it; unbounded, unnormalised."""
    log_odds: float = 0.0
    """Log-odds in all."""
    symmetry: AgreedSymmetry = field(default_factory=AgreedSymmetry)
    """What makes rotations the same."""

    def R_goal_then(self, R_then_start: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The remaining rotation from a viewpoint, the smallest of those that are the same."""
        R: Float[np.ndarray, "3 3"] = self.symmetry.nearest(self.R_goal_start[None], R_then_start)[0] @ R_then_start.T
        return R

    @property
    def tested(self) -> bool:
        """Whether there is an arrival test at it."""
        return self.arrival_log_odds > float("-inf")

    @property
    def guessed(self) -> bool:
        """Whether no estimate names it."""
        return not self.probabilities

    @property
    def support(self) -> float:
        """The largest probability by an estimate."""
        return max((max(given) for given in self.probabilities.values()), default=0.0)

    @property
    def from_start_rad(self) -> float:
        """Angle from the start."""
        return float(so3.angle(self.R_goal_start))


def answers(estimate: RotationEstimate) -> list[tuple[Float[np.ndarray, "3 3"], float]]:
    """The rotations that an estimate names, each with its probability: the answer, then the alternatives."""
    rest = sum(probability for _, probability in estimate.alternatives)
    first = 0.5 if estimate.confidence is None else estimate.confidence
    return [(estimate.R_goal_current, min(first, max(1 - rest, LEAST_PROBABILITY))), *estimate.alternatives]


def nearest(
    estimate: RotationEstimate, R: Float[np.ndarray, "3 3"], symmetry: AgreedSymmetry
) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Of the rotations that an estimate names, and those that are the same to the object, the one nearest to R, and
    their difference in radians."""
    return symmetry.nearest(np.stack([answer for answer, _ in answers(estimate)]), R)


def _confidence_here(estimate: RotationEstimate, same_rad: float) -> float:
    """The confidence of an estimate if its answer is to stay, or if staying is as likely; else less."""
    named = answers(estimate)
    staying = max((p for R, p in named if float(so3.angle(R)) <= same_rad), default=0.0)
    whole = named[0][1] if estimate.confidence is None else estimate.confidence
    return whole * min(1.0, staying / max(named[0][1], 1e-9))  # the likeliest answer may lead away


def is_at(hypothesis: Hypothesis, viewpoint: Viewpoint, settings: BeliefSettings) -> bool:
    """Whether a viewpoint is at a hypothesis."""
    return float(so3.angle(hypothesis.R_goal_then(viewpoint.R_then_start))) <= settings.near_rad


def stays(viewpoint: Viewpoint, symmetry: AgreedSymmetry, settings: BeliefSettings) -> bool:
    """Whether one of a viewpoint's estimates names a rotation that stays at it."""
    return min(nearest(x.estimate, np.eye(3), symmetry)[1] for x in viewpoint.observations) <= settings.near_rad


def near_viewpoints(one: Viewpoint, other: Viewpoint, settings: BeliefSettings) -> bool:
    """Whether two viewpoints show nearly the same."""
    return float(so3.angle_difference(one.R_then_start, other.R_then_start)) < settings.new_view_rad


def hypotheses_of(viewpoints: Sequence[Viewpoint], settings: BeliefSettings) -> tuple[Hypothesis, ...]:
    """All orientations that estimates name or flips of arrivals suggest, the likeliest first."""
    found, views = _clusters(viewpoints, settings), _views(viewpoints, settings)
    by_views = [sum(_log_probability(x, viewpoints, view, settings) for view in views) for x in found]
    largest = max(by_views)
    weighed = [_weighed(x, viewpoints, one, one - largest, settings) for x, one in zip(found, by_views, strict=True)]
    compared = _compared([x for x in weighed if x.tested], viewpoints, settings)
    untested = [x for x in weighed if not x.tested]
    return tuple(sorted([*compared, *untested], key=lambda x: (-x.log_odds, -x.view_log_probability)))


def _clusters(viewpoints: Sequence[Viewpoint], settings: BeliefSettings) -> list[Hypothesis]:
    """The hypotheses without their log-odds; the latest estimates first, which have drifted least."""
    symmetry = AgreedSymmetry.of([x.estimate for viewpoint in viewpoints for x in viewpoint.observations])
    centres: list[Float[np.ndarray, "3 3"]] = []
    named: list[dict[int, list[float]]] = []
    losses: list[float] = []

    def cluster(R_goal_start: Float[np.ndarray, "3 3"]) -> int:
        away_rad = [symmetry.nearest(R_goal_start[None], centre)[1] for centre in centres]
        if away_rad and min(away_rad) <= settings.same_rad:
            return int(np.argmin(away_rad))
        centres.append(symmetry.nearest(R_goal_start[None], np.eye(3))[0])
        named.append({})
        losses.append(float("inf"))
        return len(centres) - 1

    for index in range(len(viewpoints) - 1, -1, -1):
        for observation in viewpoints[index].observations:
            for R, probability in answers(observation.estimate):
                k = cluster(R @ viewpoints[index].R_then_start)
                named[k].setdefault(index, []).append(probability)
    for viewpoint in viewpoints:
        for flip in viewpoint.flips:
            k = cluster(flip.R_goal_current @ viewpoint.R_then_start)
            losses[k] = min(losses[k], flip.score_loss)
    return [Hypothesis(*x, symmetry=symmetry) for x in zip(centres, named, losses, strict=True)]


def _views(viewpoints: Sequence[Viewpoint], settings: BeliefSettings) -> list[list[int]]:
    """The viewpoints by index, those together that show nearly the same."""
    views: list[list[int]] = []
    for index, viewpoint in enumerate(viewpoints):
        same = (view for view in views if near_viewpoints(viewpoints[view[0]], viewpoint, settings))
        view = next(same, None)
        if view is None:
            views.append([index])
        else:
            view.append(index)
    return views


def _log_probability(
    hypothesis: Hypothesis, viewpoints: Sequence[Viewpoint], view: Sequence[int], settings: BeliefSettings
) -> float:
    """Mean log-probability of a hypothesis by the estimates of a view; one that does not name it gives it a share of
    the rest."""
    given: list[float] = []
    for index in view:
        estimates = [x.estimate for x in viewpoints[index].observations]
        named = hypothesis.probabilities.get(index, [])
        rest = max(1 - float(np.mean([sum(p for _, p in answers(x)) for x in estimates])), LEAST_PROBABILITY)
        unnamed = max(len(estimates) - len(named), 0)
        given += [max(p, LEAST_PROBABILITY) for p in named] + [rest * settings.unnamed] * unnamed
    return float(np.mean(np.log(given)))


def _weighed(
    hypothesis: Hypothesis,
    viewpoints: Sequence[Viewpoint],
    view_log_probability: float,
    to_largest: float,
    settings: BeliefSettings,
) -> Hypothesis:
    """A hypothesis with its log-odds, not yet compared with others."""
    there = [x for x in viewpoints if is_at(hypothesis, x, settings)]
    tests = [x.arrival.log_odds for x in there if x.arrival is not None]
    least = settings.views_against_tested if tests else settings.views_against
    by_estimates = least if hypothesis.guessed else max(to_largest, least)
    return replace(
        hypothesis,
        visits=len(there),
        arrival_log_odds=max(tests, default=float("-inf")),
        view_log_probability=view_log_probability,
        log_odds=by_estimates + _log_odds_at(there, hypothesis.symmetry, settings),
    )


def _log_odds_at(there: Sequence[Viewpoint], symmetry: AgreedSymmetry, settings: BeliefSettings) -> float:
    """What the viewpoints at a hypothesis add to its log-odds: the mean of those with an arrival test, as they err
    alike; a rejection where no estimate stays."""
    if tested := [x for x in there if x.arrival is not None]:
        return float(np.average([x.log_odds(settings) for x in tested], weights=[len(x.observations) for x in tested]))
    return -settings.max_log_odds if any(not stays(x, symmetry, settings) for x in there) else 0.0


def _compared(
    tested: Sequence[Hypothesis], viewpoints: Sequence[Viewpoint], settings: BeliefSettings
) -> list[Hypothesis]:
    """The tested hypotheses with the log-odds between them, by the likelihood of the depth differences: inlier ratios
    do not tell two apart that both pass. The likeliest one gets the largest log-odds of all."""
    if len(tested) < 2:
        return list(tested)
    largest = max(x.log_odds for x in tested)
    nll, counts = [], []
    for hypothesis in tested:
        there = [x for x in viewpoints if x.arrival is not None and is_at(hypothesis, x, settings)]
        sizes = [len(x.observations) for x in there]
        nll.append(float(np.average([x.arrival.depth_nll for x in there if x.arrival], weights=sizes)))
        counts.append(sum(sizes))
    best = int(np.argmin(nll))
    observations = [min(n, counts[best], settings.max_compared) for n in counts]
    return [
        replace(hypothesis, log_odds=largest - (one - nll[best]) * n)
        for hypothesis, one, n in zip(tested, nll, observations, strict=True)
    ]
