"""The belief of the few-moves strategy: what all observations so far imply about the goal's orientation.

A belief is immutable and folded over the steps: ``belief = belief.updated(step)``. It holds the viewpoints of a chain
of known motions, each with its observations and their arrival test. An unknown motion begins a new chain: nothing that
was observed before it counts any more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.agreed_symmetry import AgreedSymmetry
from reorient.controller.arrival import Observation, PreparedGoal, PreparedImage
from reorient.controller.base import Step
from reorient.controller.hypotheses import (
    BeliefSettings,
    Hypothesis,
    Viewpoint,
    hypotheses_of,
    is_at,
    near_viewpoints,
    nearest,
)
from reorient.controller.remaining import fused_covariance
from reorient.controller.symmetry import Flip


@dataclass(frozen=True, eq=False)
class Hidden:
    """An orientation at which no observation was possible: the move to it was undone."""

    R_hidden_start: Float[np.ndarray, "3 3"]
    radius_rad: float
    """A move that ends this near counts as a move there."""


@dataclass(frozen=True, eq=False)
class Belief:
    """What the steps so far imply."""

    goal: PreparedGoal
    settings: BeliefSettings
    viewpoints: tuple[Viewpoint, ...] = ()
    """Since the last unknown motion, in order; the object may have moved on since the last one."""
    hidden: tuple[Hidden, ...] = ()
    images: int = 0
    """Observations so far, in all chains."""
    moves_before: int = 0
    """Commanded moves before the latest step."""
    latest: Step | None = None

    @property
    def commanded_moves(self) -> int:
        """Commanded moves in all; one that was undone counts twice."""
        return self.moves_before + (_moves(self.latest) if self.latest else 0)

    @property
    def viewpoint_now(self) -> Viewpoint:
        """The present viewpoint, right after an observation. IndexError where there is no viewpoint."""
        return self.viewpoints[-1]

    def updated(self, step: Step) -> "Belief":
        """The belief after one more step, or after the move of the latest one became known (see ``AnyBelief``)."""
        if self.latest is not None and step.index == self.latest.index:
            return replace(self, latest=step)
        moved = self._moved() if self.latest is not None else self
        return replace(moved, latest=step, images=self.images + 1)._observed(Observation(step.image, step.estimate))

    def _moved(self) -> "Belief":
        """The belief with the latest move folded in; a motion begins a viewpoint, still without observations."""
        step = self.latest
        assert step is not None
        moves = self.moves_before + _moves(step)
        if step.motion_unknown:
            return replace(self, viewpoints=(), hidden=(), moves_before=moves)
        if step.R_executed is None:
            return replace(self, moves_before=moves)
        then, hidden = self.viewpoint_now, self.hidden
        if step.undone and step.R_step is not None:
            radius_rad = min(self.settings.same_rad, float(so3.angle(step.R_step)) / 2)
            hidden += (Hidden(step.R_step @ then.R_then_start, radius_rad),)
        path_rad = then.path_rad + float(so3.angle(step.R_executed))
        new = Viewpoint((), step.R_executed @ then.R_then_start, path_rad)
        return replace(self, viewpoints=(*self.viewpoints, new), hidden=hidden, moves_before=moves)

    def _observed(self, observation: Observation) -> "Belief":
        """The belief with one more observation at the present viewpoint, whose tests are made anew."""
        *before, now = self.viewpoints or (Viewpoint((), np.eye(3)),)
        observations = (*now.observations, observation)
        estimates = [x.estimate for viewpoint in before for x in viewpoint.observations]
        symmetry = AgreedSymmetry.of([*estimates, *(x.estimate for x in observations)])
        away_rad = [nearest(x.estimate, np.eye(3), symmetry)[1] for x in observations]
        arrival, flips = None, now.flips
        if len(observations) >= 2 and float(np.median(away_rad)) <= self.settings.near_rad:
            arrival = self.settings.arrival_test(observations, self.goal)
            flips = flips or self._flips(observations[0], now, before)
        now = replace(now, observations=observations, arrival=arrival, flips=flips if arrival else ())
        return replace(self, viewpoints=(*before, now))

    def _flips(self, image: PreparedImage, now: Viewpoint, before: Sequence[Viewpoint]) -> tuple[Flip, ...]:
        """The flips of a pose, by the images of the viewpoints before; none where one of these has them."""
        if any(x.flips and near_viewpoints(x, now, self.settings) for x in before):
            return ()
        history = [(x.observations[0].image, now.R_then_start @ x.R_then_start.T) for x in before]
        return self.settings.symmetry_test.flips(image, self.goal.whole, history)

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """All hypotheses, the likeliest first."""
        return hypotheses_of(self.viewpoints, self.settings)

    @property
    def hypotheses_now(self) -> tuple[tuple[Float[np.ndarray, "3 3"], float], ...]:
        """The remaining rotation to each hypothesis from the present viewpoint, and its log-odds."""
        return tuple((self.R_goal_now(x), x.log_odds) for x in self.hypotheses)

    def tested_viewpoints_at(self, hypothesis: Hypothesis) -> list[Viewpoint]:
        """The viewpoints at a hypothesis that have an arrival test."""
        return [x for x in self.viewpoints if x.arrival is not None and is_at(hypothesis, x, self.settings)]

    def R_goal_now(self, hypothesis: Hypothesis) -> Float[np.ndarray, "3 3"]:
        """The remaining rotation to a hypothesis, from the present viewpoint."""
        return hypothesis.R_goal_then(self.viewpoint_now.R_then_start)

    def times_hidden(self, R_step: Float[np.ndarray, "3 3"]) -> int:
        """How often a move from the present viewpoint to where this one leads was undone."""
        R = R_step @ self.viewpoint_now.R_then_start
        return sum(float(so3.angle_difference(R, x.R_hidden_start)) <= x.radius_rad for x in self.hidden)

    def error_covariance(self, hypothesis: Hypothesis) -> Float[np.ndarray, "3 3"] | None:
        """The covariance (rad^2) of the error of ``fused``, by those of the estimates; None where none has one.

        What all observations of a pose have in common does not average out.
        """
        stated = [x.estimate.covariance_rad2 for x, _, _ in self._near(hypothesis)]
        known = [x for x in stated if x is not None]
        return fused_covariance(np.mean(known, axis=0), len(known)) if known else None

    def _near(self, hypothesis: Hypothesis) -> list[tuple[Observation, Float[np.ndarray, "3 3"], float]]:
        """The observations made within ``near_rad`` of a hypothesis that name it, the latest first, each with the
        remaining rotation now and the path since. None of a pose that is only the same as the present one by symmetry,
        as a symmetry is known less well than a pose."""
        s, symmetry, found = self.settings, hypothesis.symmetry, []
        now = self.viewpoint_now.R_then_start
        R_goal_start = hypothesis.R_goal_then(now) @ now
        for viewpoint in reversed(self.viewpoints):
            R_goal_then = hypothesis.R_goal_then(viewpoint.R_then_start)
            for observation in reversed(viewpoint.observations):
                answer, away_rad = nearest(observation.estimate, R_goal_then, symmetry)
                R = answer @ viewpoint.R_then_start
                here = float(so3.angle_difference(R, R_goal_start)) <= s.same_rad
                if here and float(so3.angle(answer)) <= s.near_rad and away_rad <= s.same_rad:
                    R_goal_now = symmetry.nearest(R[None], R_goal_start)[0] @ now.T
                    found.append((observation, R_goal_now, self.viewpoint_now.path_rad - viewpoint.path_rad))
        return found

    def fused(self, hypothesis: Hypothesis) -> tuple[Float[np.ndarray, "3 3"], float]:
        """The remaining rotation to a hypothesis by the estimates made within ``near_rad`` of it, and its standard
        error in radians by their scatter, without what they have in common: infinite where there is none, with the
        spread at least ``spread_rad`` for fewer than three.

        A geometric median, as single estimates may be wrong by degrees; estimates from before larger motions have less
        weight.
        """
        s, near = self.settings, self._near(hypothesis)
        if not near:
            return self.R_goal_now(hypothesis), float("inf")
        found = [R for _, R, _ in near]
        information = 1 / (s.spread_rad**2 + (s.drift * np.array([since for _, _, since in near])) ** 2)
        median, spread_rad = _geometric_median(np.stack(found), information, s.spread_rad / 10)
        if len(found) < 3:
            spread_rad = max(spread_rad, s.spread_rad)
        return median, float(spread_rad / np.sqrt(information.sum() * s.spread_rad**2))


def _geometric_median(
    R: Float[np.ndarray, "n 3 3"], information: Float[np.ndarray, " n"], least_rad: float
) -> tuple[Float[np.ndarray, "3 3"], float]:
    """The weighted geometric median of rotations (Weiszfeld's algorithm), and their weighted spread in radians."""
    median, weights = so3.mean(R, information), information
    for _ in range(20):
        weights = information / np.maximum(so3.angle_difference(R, median), least_rad)
        median = so3.mean(R, weights)
    return median, float(np.sqrt(np.sum(weights * so3.angle_difference(R, median) ** 2) / weights.sum()))


def _moves(step: Step) -> int:
    return (step.R_step is not None) + step.undone
