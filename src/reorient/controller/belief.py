"""What a loop knows so far: the poses it stood in, and the orientations that the goal may have.

Every estimate, and every alternative that it names, is a claim about the rotation that is still missing. Known moves
carry claims along to now, where those that agree are one candidate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.arrival import half_turns, likeness, looseness_rad, misfit, repeats
from reorient.controller.base import Step, rotations_since
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage

NEAR_RAD = float(np.radians(8))  # so near, a pose stands for the candidate
SAME_RAD = float(np.radians(15))  # claims so near each other are one candidate
NEW_VIEW_RAD = float(np.radians(10))  # poses turned by less show the same, and err alike
LEAST, RIVALS = 0.02, 10  # a claim that is not named: its share, one in so many, of what is left, at the least this
DENIED = -6.0  # log odds of a pose from which all estimates want to be off
FAR_AGAINST = -4.0  # log odds, at the most, that views from elsewhere hold against a candidate: they err alike
LEAST_AGAINST = -1.0  # the same, once it has been examined
COUNTED = 4  # captures of a pose: more make the misfit steadier, but err alike with the one goal image
ELSEWHERE_RAD = float(np.radians(80))  # so far apart, views show other sides
QUARTER = np.pi / 2 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
OTHER_SIDES = so3.exp(np.concatenate([2 * QUARTER[::2], QUARTER]))
DRIFT = 0.05  # radians of error that a claim may gain per radian turned
SPREAD_RAD = float(np.radians(0.3))  # of one estimate near the goal


@dataclass(frozen=True, eq=False)
class Stand:
    """The captures of one pose."""

    images: tuple[DepthImage, ...]
    estimates: tuple[RotationEstimate, ...]
    R_now_then: Float[np.ndarray, "3 3"]
    """What has turned the object since."""
    likeness: float | None
    """Log odds that this pose is the goal's; None unless its estimates stay near it, and it was captured twice."""
    misfit: float | None = None
    """Where there is a likeness: what tells this pose from others that have one, too (``recognition.misfit``)."""
    looseness_rad: float = 0.0
    """The same: the error of turns that the shape here hardly tells (``recognition.looseness_rad``)."""
    half_turns: Sequence[tuple[Float[np.ndarray, "3 3"], float]] = ()
    """Where there is a likeness for the first time: turns that may lead to what looks the same, each with the agreement
    that it loses by the captures up to here."""

    @property
    def confidence(self) -> float:
        """What the estimates give this pose, or one that looks like it, on average."""
        return float(np.mean([_given_here(estimate) for estimate in self.estimates]))


@dataclass(eq=False)
class Candidate:
    """One orientation that the goal may have."""

    R_goal_now: Float[np.ndarray, "3 3"]
    guessed: bool = False
    """Whether no estimate names it."""
    loss: float = float("inf")
    """The least agreement that it loses against the arrivals that it is a half turn of."""
    from_start_rad: float = 0.0
    """How far it is from the first pose."""
    named: dict[int, list[float]] = field(default_factory=dict)
    """By stand, what each of its estimates gives it."""
    visits: int = 0
    """How many poses stood for it."""
    likeness: float = float("-inf")
    """The most that one of them had (``Stand.likeness``)."""
    from_views: float = 0.0
    """Log odds that all views give it."""
    log_weight: float = 0.0
    """The same, less extreme, and what standing there adds; of those examined, what tells them from each other."""

    @property
    def examined(self) -> bool:
        """Whether one of them was looked at twice."""
        return self.likeness > float("-inf")

    @property
    def support(self) -> float:
        """The most that an estimate from elsewhere gives it."""
        return max((max(given) for given in self.named.values()), default=0.0)

    @property
    def angle_rad(self) -> float:
        """How far it is from here."""
        return float(so3.angle(self.R_goal_now))


def stands(steps: Sequence[Step], goal: DepthImage) -> list[Stand]:
    """The poses of a chain of known rotations, in order."""
    groups: list[list[int]] = []
    for k, _ in enumerate(steps):
        if k == 0 or steps[k - 1].R_executed is not None:
            groups.append([])
        groups[-1].append(k)
    R_now_then = rotations_since(steps)
    found: list[Stand] = []
    for group in groups:
        images = tuple(steps[k].image for k in group)
        estimates = tuple(steps[k].estimate for k in group)
        near = float(np.median([nearest(estimate, np.eye(3))[1] for estimate in estimates])) <= NEAR_RAD
        examined = near and len(group) >= 2
        alike = _likeness(images, goal, estimates) if examined else None
        off = _misfit(images, goal, estimates) if examined else None
        loose = _looseness_rad(images, goal, estimates) if examined else 0.0
        R_last = R_now_then[group[0]]
        before = tuple((stand.images[0], _plain(R_last.T @ stand.R_now_then)) for stand in found)
        known = [stand for stand in found if stand.half_turns and _same_pose(stand.R_now_then, R_last)]
        turns = () if alike is None or known else _half_turns(images[0], goal, before)
        found.append(Stand(images, estimates, R_last, alike, off, loose, turns))
    return found


_likeness = lru_cache(maxsize=64)(likeness)  # by identity: the same captures are asked about at every decision
_misfit = lru_cache(maxsize=64)(misfit)
_looseness_rad = lru_cache(maxsize=64)(looseness_rad)
_repeats = lru_cache(maxsize=64)(repeats)


@lru_cache(maxsize=64)
def _half_turns(
    capture: DepthImage, goal: DepthImage, before: tuple[tuple[DepthImage, tuple[float, ...]], ...]
) -> Sequence[tuple[Float[np.ndarray, "3 3"], float]]:
    return half_turns(capture, goal, [(image, np.reshape(R, (3, 3))) for image, R in before])


def _plain(R: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    return tuple(R.ravel().tolist())


def claims(estimate: RotationEstimate) -> list[tuple[Float[np.ndarray, "3 3"], float]]:
    """The rotations that an estimate names, each with its probability: the answer, then the alternatives."""
    rest = sum(probability for _, probability in estimate.alternatives)
    first = 0.5 if estimate.confidence is None else estimate.confidence
    return [(estimate.R_goal_current, min(first, max(1 - rest, LEAST))), *estimate.alternatives]


def _given_here(estimate: RotationEstimate) -> float:
    """The confidence of an estimate, if its answer is to stay, or if staying is as likely as its answer; else less."""
    named = claims(estimate)
    here = max((p for R, p in named if float(so3.angle(R)) <= SAME_RAD), default=0.0)
    whole = named[0][1] if estimate.confidence is None else estimate.confidence
    return whole * min(1.0, here / max(named[0][1], 1e-9))  # an estimator may be sure that it is wrong


def nearest(estimate: RotationEstimate, R: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Of the rotations that an estimate names the one nearest to R, and how far it is."""
    named = np.stack([R_named for R_named, _ in claims(estimate)])
    away = so3.angle_difference(named, R)
    return named[np.argmin(away)], float(away.min())


def candidates(seen: Sequence[Stand]) -> list[Candidate]:
    """All orientations that estimates name or half turns of arrivals suggest, the likeliest first."""
    found: list[Candidate] = []
    for k in range(len(seen) - 1, -1, -1):  # the latest first: its rotations have drifted least
        for estimate in seen[k].estimates:
            for R, probability in claims(estimate):
                _claim(found, R @ seen[k].R_now_then.T).named.setdefault(k, []).append(probability)
    for stand in seen:
        for R, loss in stand.half_turns:
            guess = _claim(found, R @ stand.R_now_then.T)
            guess.guessed, guess.loss = not guess.named, min(guess.loss, loss)
    for view in _views(seen):
        for candidate in found:
            candidate.from_views += float(np.mean(np.log(_given(candidate, seen, view))))
    most = max(candidate.from_views for candidate in found)
    for candidate in found:
        visits = [stand for stand in seen if at(candidate, stand)]
        candidate.from_start_rad = float(so3.angle(candidate.R_goal_now @ seen[0].R_now_then))
        candidate.visits = len(visits)
        candidate.likeness = max([x.likeness for x in visits if x.likeness is not None], default=candidate.likeness)
        against = LEAST_AGAINST if candidate.examined else FAR_AGAINST
        far = against if candidate.guessed else max(candidate.from_views - most, against)
        candidate.log_weight = far + _standing_there(visits)
    _tell_apart([candidate for candidate in found if candidate.examined], seen)
    return sorted(found, key=lambda candidate: (-candidate.log_weight, -candidate.from_views))


def _standing_there(visits: Sequence[Stand]) -> float:
    """What poses add to the log odds of the candidate that they stand for: the mean of those looked at twice, as they
    err alike; where no estimate stays, a denial."""
    looked = [stand for stand in visits if stand.likeness is not None]
    if looked:
        odds = [arrival_log_odds(stand) for stand in looked]
        return float(np.average(odds, weights=[len(stand.images) for stand in looked]))
    denied = [min(nearest(e, np.eye(3))[1] for e in stand.estimates) > NEAR_RAD for stand in visits]
    return DENIED if any(denied) else 0.0


def _tell_apart(examined: Sequence[Candidate], seen: Sequence[Stand]) -> None:
    """Weigh the candidates that were looked at twice against each other by how far depths are off at each: of two that
    both fit, the share that fits says little. The likeliest so keeps the most that any had."""
    if len(examined) < 2:
        return
    looked = [[s for s in seen if s.misfit is not None and at(candidate, s)] for candidate in examined]
    captures = [sum(len(stand.images) for stand in stands_there) for stands_there in looked]
    off = [float(np.average([s.misfit for s in there], weights=[len(s.images) for s in there])) for there in looked]
    most, least = max(candidate.log_weight for candidate in examined), int(np.argmin(off))
    for candidate, each, count in zip(examined, off, captures, strict=True):
        candidate.log_weight = most - (each - off[least]) * min(count, captures[least], COUNTED)


def at(candidate: Candidate, stand: Stand) -> bool:
    """Whether a pose stands for a candidate."""
    return float(so3.angle(candidate.R_goal_now @ stand.R_now_then)) <= NEAR_RAD


def is_symmetry(
    best: Candidate, twin: Candidate, seen: Sequence[Stand]
) -> tuple[bool | None, Float[np.ndarray, "3 3"]]:
    """Of an arrival and another orientation that matches the goal equally: whether what turns one into the other makes
    views from elsewhere repeat, too, as a symmetry does and a likeness from one side does not. None where no two poses
    tell yet; then with the turn from here to one that helps to."""
    S = best.R_goal_now.T @ twin.R_goal_now
    here = next(stand.images for stand in reversed(seen) if stand.likeness is not None)
    elsewhere = [stand for stand in seen if _away_rad(stand.R_now_then.T, S) >= ELSEWHERE_RAD]
    for stand in elsewhere:
        for other in seen:
            if other is not stand and float(so3.angle(other.R_now_then @ stand.R_now_then.T @ S)) <= NEAR_RAD:
                return _repeats(stand.images[0], other.images[0], here[:2]), np.eye(3)
    if elsewhere:
        return None, max((stand.R_now_then.T for stand in elsewhere), key=lambda R: _away_rad(R, S)) @ S
    return None, max(OTHER_SIDES, key=lambda R: _away_rad(R, S))


def _away_rad(R: Float[np.ndarray, "3 3"], S: Float[np.ndarray, "3 3"]) -> float:
    """How far the view of a pose, by the turn to it from here, is from the view here and from that where S turns to;
    turns about the optical axis show the same."""
    return float(np.arccos(np.clip(max(R[2, 2], (R @ S.T)[2, 2]), -1, 1)))


def arrival_log_odds(here: Stand) -> float:
    """That a pose is the goal's: the estimator's own confidence there, and the likeness."""
    own = np.clip(here.confidence, LEAST, 1 - LEAST / 2)
    return float(np.log(own / (1 - own))) + (here.likeness or 0.0)


def _claim(found: list[Candidate], R_goal_now: Float[np.ndarray, "3 3"]) -> Candidate:
    """The candidate that a claim belongs to, a new one if none is near."""
    away = [float(so3.angle_difference(candidate.R_goal_now, R_goal_now)) for candidate in found]
    if not away or min(away) > SAME_RAD:
        found.append(Candidate(R_goal_now))
        return found[-1]
    return found[int(np.argmin(away))]


def _views(seen: Sequence[Stand]) -> list[list[int]]:
    """The stands, those together whose poses are nearly the same."""
    views: list[list[int]] = []
    for k, stand in enumerate(seen):
        for view in views:
            if _same_pose(seen[view[0]].R_now_then, stand.R_now_then):
                view.append(k)
                break
        else:
            views.append([k])
    return views


def _same_pose(R_now_then: Float[np.ndarray, "3 3"], R_now_other: Float[np.ndarray, "3 3"]) -> bool:
    return float(so3.angle_difference(R_now_then, R_now_other)) < NEW_VIEW_RAD


def _given(candidate: Candidate, seen: Sequence[Stand], view: Sequence[int]) -> list[float]:
    """What each estimate of a view gives a candidate; where it does not name it, a share of what it leaves."""
    given = []
    for k in view:
        named = candidate.named.get(k, [])
        silent = len(seen[k].estimates) - len(named)
        left = max(1 - float(np.mean([sum(p for _, p in claims(e)) for e in seen[k].estimates])), LEAST)
        given += [max(p, LEAST) for p in named] + [left / RIVALS] * max(silent, 0)
    return given


def average(steps: Sequence[Step], R_goal_now: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"], float]:
    """The missing rotation by all captures near a candidate, and its standard error in radians.

    A geometric median, as single estimates may be off by degrees; what was seen before larger turns counts less.
    """
    R, turned = [], []
    since = 0.0
    for step, R_now_then in zip(reversed(steps), reversed(rotations_since(steps)), strict=True):
        since += 0.0 if step.R_executed is None else float(so3.angle(step.R_executed))
        claim, _ = nearest(step.estimate, R_goal_now @ R_now_then)
        claim_now = claim @ R_now_then.T
        if float(so3.angle(claim)) <= NEAR_RAD and float(so3.angle_difference(claim_now, R_goal_now)) <= SAME_RAD:
            R.append(claim_now)
            turned.append(since)
    if not R:
        return R_goal_now, float("inf")
    known = 1 / (SPREAD_RAD**2 + (DRIFT * np.array(turned)) ** 2)
    weights, middle = known, so3.mean(np.stack(R), known)
    for _ in range(20):
        away = so3.angle_difference(np.stack(R), middle)
        weights = known / np.maximum(away, SPREAD_RAD / 10)
        middle = so3.mean(np.stack(R), weights)
    away = so3.angle_difference(np.stack(R), middle)
    spread = np.sqrt(np.sum(weights * away**2) / weights.sum())
    effective = known.sum() * SPREAD_RAD**2
    return middle, float(max(spread, SPREAD_RAD if len(R) < 3 else 0.0) / np.sqrt(effective))
