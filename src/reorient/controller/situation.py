"""What the phases of the few-moves strategy decide on: its settings, and what follows from a belief."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.base import Reachable
from reorient.controller.belief import Belief
from reorient.controller.hypotheses import BeliefSettings, Hypothesis, Viewpoint, is_at, stays
from reorient.errors import ReorientError


@dataclass(frozen=True, kw_only=True)
class FusingSettings:
    """The settings of ``Fusing``.

    docs/tuning.md states which objects are tuning objects, and what was changed after a look at the reporting half.

    Raises ReorientError for limits that allow nothing.
    """

    max_images: int = 40
    """Largest number of images."""
    max_moves: int = 12
    """Largest number of commanded moves; an undone one counts twice."""
    tolerance_rad: float = float(np.radians(0.08))
    """Converged once the fused estimate is at most this, or not clearly above its standard error."""
    patience: int = 3
    """Number of consecutive errors of station or estimator that the loop survives."""
    history: bool = False
    """Whether the estimator receives earlier images. No better on 100 loops of tuning objects (docs/ablations.md)."""
    belief_settings: BeliefSettings = field(default_factory=BeliefSettings)

    approach_rad: float = float(np.radians(1))
    """With more left, the first observation of a pose is enough to move closer. Not tuned."""
    max_captures: int = 6
    """Observations of one pose at most. Loops of tuning objects (ed0cd77)."""
    steady_rad: float = float(np.radians(0.09))
    """Standard error of the fused estimate that needs no more observations. Loops of tuning objects (ed0cd77)."""
    significance: float = 1.5
    """Standard errors above which the fused estimate is a rotation worth a move. Loops of tuning objects (e22ae9f)."""
    reserve: int = 3
    """Moves kept for the way back to the best hypothesis and the last small ones. Loops of tuning objects (6780065)."""

    equivalent: float = 0.9
    """An untested hypothesis less than this many nats below the likeliest counts as equally likely; the one nearest the
    start is taken. Loops of tuning objects (a1edc20)."""
    tie: float = 3.0
    """Difference of log-odds between tested hypotheses that is noise. 203 look-alikes (benchmarks/lookalikes.py): 0 of
    127 decided by three nats was wrong, 1 of 140 by two; chosen after a look at loops of the reporting half."""
    better: float = 0.5
    """Log-odds by which a tied hypothesis must exceed the present one for a move back. Loops of tuning objects."""
    near_start_rad: float = float(np.radians(60))
    """A tied hypothesis this near to the start is preferred, as most requested rotations are small: of uniform ones 1
    in 17. Without it 1 of 90 loops from 30 degrees ended at a flip (docs/tuning.md)."""

    sure_elsewhere: float = 0.95
    """Probability by an estimate from elsewhere with which competing alternatives need no visit. Loops of tuning
    objects (6780065)."""
    sure_arrival: float = 6.5
    """Log-odds of an arrival with the same effect; 1 in 10 right ones has less. Chosen after a look at failed loops of
    the reporting half (564b394)."""
    alternative: float = 0.2
    """Probability by one estimate that makes an alternative a competing hypothesis. Loops of tuning objects."""
    flip_loss: float = 0.3
    """Score loss with which a flip is a competing hypothesis: those from false arrivals to the goal lost up to 0.26 on
    tuning objects (61a9af1)."""
    flip_loss_in_doubt: float = 0.6
    """The same for an arrival in doubt. Loops of tuning objects (61a9af1)."""

    within_rad: float = float(np.radians(5))
    """The confidence is the probability of a smaller error. By definition."""
    fused_error_rad: float = float(np.radians(0.5))
    """Typical error of the fused estimate, as its observations err alike. Not tuned."""
    enough_rad: float = float(np.radians(0.5))
    """Remaining rotation that may converge where no more moves are allowed: a servo's play may forbid the tolerance.
    Loops in the simulated cell (42b3e2e)."""
    min_confidence: float = 0.5
    """With less the loop ends unsure. By definition."""
    min_arrival_log_odds: float = 0.5
    """With less at the pose's best arrival test the loop ends unsure, however confident the estimator is. 298 loops of
    tuning objects with faults; made after a look at 10 loops of the reporting half (17d560d)."""

    def __post_init__(self) -> None:
        if not (self.max_images >= 2 and self.max_moves >= 1 and self.tolerance_rad >= 0 and self.patience >= 0):
            raise ReorientError(
                f"{self.max_images} images, {self.max_moves} moves, tolerance {self.tolerance_rad}, patience "
                f"{self.patience}: expected at least 2 images, 1 move, and no negative number"
            )


@dataclass(frozen=True, eq=False)
class Situation:
    """What the phases decide on: a belief right after an observation, and what follows from it."""

    settings: FusingSettings
    belief: Belief
    reachable: Reachable

    @property
    def moves_left(self) -> int:
        """Moves that the settings still allow."""
        return self.settings.max_moves - self.belief.commanded_moves

    @property
    def images_left(self) -> int:
        """Images that the settings still allow."""
        return self.settings.max_images - self.belief.images

    @property
    def captures(self) -> int:
        """Observations of the present pose."""
        return len(self.belief.viewpoint_now.observations)

    @property
    def may_capture(self) -> bool:
        """Whether one more observation of the present pose is allowed."""
        return self.images_left > 0 and self.captures < self.settings.max_captures

    @cached_property
    def exploring(self) -> bool:
        """Whether moves and images are left for more than the way back to the best hypothesis."""
        return min(self.moves_left, self.images_left - self.settings.max_captures) > self.settings.reserve

    @cached_property
    def hypotheses(self) -> list[Hypothesis]:
        """The hypotheses, the likeliest first, but for those at which no observation was possible. These are tried once
        more where nothing else is left, as the camera may have failed."""
        belief = self.belief
        hidden = [0 if x.visits else belief.times_hidden(belief.R_goal_now(x)) for x in belief.hypotheses]
        by_times = ([x for x, n in zip(belief.hypotheses, hidden, strict=True) if n == times] for times in (0, 1))
        return next((found for found in by_times if found), [])

    @cached_property
    def hypothesis_here(self) -> Hypothesis | None:
        """The hypothesis of the present pose, if an estimate stays at it."""
        belief, found = self.belief, self.hypotheses
        if not found or not stays(belief.viewpoint_now, found[0].symmetry, belief.settings):
            return None
        return min(self.hypotheses, key=self.angle_rad)

    @cached_property
    def best(self) -> Hypothesis | None:
        """The hypothesis to be at; None where none is left. Once no longer exploring: of the tested ones, else of those
        that an estimate names."""
        candidates = [x for x in self.hypotheses if x is self.hypothesis_here or not self.is_near(x)]
        if not self.exploring:
            candidates = [x for x in candidates if x.tested] or [x for x in candidates if not x.guessed]
        return self._best(candidates) if candidates else None

    def _best(self, found: list[Hypothesis]) -> Hypothesis:
        """The best of some hypotheses, the likeliest first.

        Tested hypotheses within ``tie`` of the top: the one nearest the start, if within ``near_start_rad``, even if an
        untested one is likelier. Else a tested top, or the present one if tied and less than ``better`` below. Else, of
        about equally likely ones, the nearest to the start that can be reached.
        """
        top, s = found[0], self.settings
        tied = [x for x in found if x.tested and top.log_odds - x.log_odds < s.tie]
        if near := [x for x in tied if x.from_start_rad <= s.near_start_rad]:
            return min(near, key=lambda x: x.from_start_rad)
        if top.tested:
            here = self.hypothesis_here
            return here if here in tied and top.log_odds - here.log_odds < s.better else top
        good = [
            x
            for x in found
            if max(top.log_odds - x.log_odds, top.view_log_probability - x.view_log_probability) < s.equivalent
        ]
        good.sort(key=lambda x: x.from_start_rad)
        return next((x for x in good if self.is_near(x) or self.can_reach(x)), good[0])

    @cached_property
    def competing(self) -> Hypothesis | None:
        """Hypothesis to visit before the tested best one is accepted, or None.

        If the arrival leaves doubt: a named alternative, or a flip of at most ``flip_loss_in_doubt``. If it leaves
        none: only a flip of at most ``flip_loss``.
        """
        best = self.best
        if best is None or not self.exploring:
            return None
        there = self.belief.tested_viewpoints_at(best)
        if not there:
            return None
        sure, s = self._is_sure(best, there), self.settings
        flip_loss = s.flip_loss if sure else s.flip_loss_in_doubt
        found = [
            x
            for x in self.hypotheses
            if not x.visits
            and (x.flip_loss <= flip_loss or (x.support >= s.alternative and not sure))
            and self.can_reach(x)
        ]
        return max(found, key=lambda x: (x.support >= s.alternative, -x.flip_loss, x.support), default=None)

    def _is_sure(self, best: Hypothesis, there: list[Viewpoint]) -> bool:
        """Whether the arrivals at the best hypothesis, or they and estimates from elsewhere, leave no doubt."""
        log_odds = np.mean([x.log_odds(self.belief.settings) for x in there])
        if log_odds >= self.settings.sure_arrival:
            return True
        away = [k for k, x in enumerate(self.belief.viewpoints) if not is_at(best, x, self.belief.settings)]
        elsewhere = [max(best.probabilities[k]) for k in away if k in best.probabilities]
        return bool(log_odds > 0 and max(elsewhere, default=1.0) >= self.settings.sure_elsewhere)

    @cached_property
    def equals(self) -> list[Hypothesis]:
        """The other tested hypotheses that match the goal as well as the best one, but for noise."""
        return [x for x in self.hypotheses if self.is_equal(x, self.best)]

    @cached_property
    def symmetry(self) -> tuple[bool | None, Float[np.ndarray, "3 3"]]:
        """Whether the best hypothesis and its equals are one orientation of a symmetric object.

        True: symmetric. False: not. None: undecided; the rotation (camera axes, left) then leads to a pose to observe
        next.
        """
        belief, best = self.belief, self.best
        assert best is not None
        R_best_now = belief.R_goal_now(best)
        reference = next(x.observations for x in reversed(belief.viewpoints) if x.arrival is not None)
        now = belief.viewpoint_now.R_then_start
        views = [(x.observations[0], x.R_then_start @ now.T) for x in belief.viewpoints]
        test = belief.settings.symmetry_test
        known = [test.symmetric(R_best_now.T @ belief.R_goal_now(x), reference[:2], views) for x in self.equals]
        by_answer = {symmetric: (symmetric, R) for symmetric, R in reversed(known)}
        return by_answer.get(False) or by_answer.get(None) or (True, np.eye(3))  # one that is no symmetry is enough

    def angle_rad(self, hypothesis: Hypothesis) -> float:
        """Angle of the remaining rotation to a hypothesis."""
        return float(so3.angle(self.belief.R_goal_now(hypothesis)))

    def is_near(self, hypothesis: Hypothesis) -> bool:
        """Whether the present pose is at a hypothesis."""
        return self.angle_rad(hypothesis) <= self.belief.settings.near_rad

    def can_reach(self, hypothesis: Hypothesis) -> bool:
        """Whether the station can make the move to a hypothesis."""
        return self.reachable(self.belief.R_goal_now(hypothesis))

    def is_equal(self, one: Hypothesis | None, other: Hypothesis | None) -> bool:
        """Whether two different hypotheses were tested and match the goal equally, but for noise."""
        if one is None or other is None or one is other or not (one.tested and other.tested):
            return False
        return abs(one.log_odds - other.log_odds) < self.settings.tie
