"""The few-moves strategy: full moves to the likeliest hypothesis, verified on arrival.

The strategy approaches the likeliest hypothesis of the belief. There it captures at least twice and tests the arrival;
a hypothesis whose test fails loses log-odds. Competing hypotheses are visited, too: alternatives that an estimate
names, and the flips of the arrival that no image contradicts; the likelihood of the depth differences decides between
them, as only the goal image can decide. Where two match equally, views from other sides show whether they are one
orientation of a symmetric object. Last, the estimates are averaged and the final small moves made.
"""

from dataclasses import dataclass, replace
from math import erfc, sqrt
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.arrival import PreparedGoal
from reorient.controller.base import Decision, Reachable, Status, degrees
from reorient.controller.belief import Belief
from reorient.controller.remaining import bound_rad
from reorient.controller.situation import FusingSettings, Situation
from reorient.formatting import format_number, format_probability
from reorient.imaging import DepthImage, Goal, as_goal


@dataclass(frozen=True, kw_only=True)
class Fusing(FusingSettings):
    """The few-moves strategy, from any start. The phases are asked in turn; the first with something to do decides."""

    undoes_moves: ClassVar[bool] = True

    def start(self, goal: DepthImage | Goal) -> Belief:
        """The belief before the first observation."""
        whole = as_goal(goal)
        return Belief(PreparedGoal(whole.image, whole), self.belief_settings)

    def decide(self, belief: Belief, reachable: Reachable) -> Decision:
        """The next act, from the belief right after an observation."""
        situation = Situation(self, belief, reachable)
        for phase in (verify, compare, approach, probe_symmetry, settle):
            decision = phase(situation)
            if decision is not None:
                return replace(decision, phase=phase.__name__)
        return replace(done(situation), phase="done")


def verify(s: Situation) -> Decision | None:
    """After the first observation near a hypothesis: move closer once, then capture again for the arrival test."""
    if s.hypothesis_here is None or s.captures > 1 or s.images_left <= 0:
        return None
    R_goal_now, _ = s.belief.fused(s.hypothesis_here)
    angle_rad = float(so3.angle(R_goal_now))
    paths_rad = [x.path_rad for x in s.belief.viewpoints[-2:]]
    came_far = len(paths_rad) < 2 or paths_rad[1] - paths_rad[0] > s.belief.settings.near_rad
    if angle_rad > s.settings.approach_rad and s.moves_left > 0 and came_far:
        return Decision(f"near goal ({degrees(angle_rad, 2)}): rotating closer", R_goal_now)
    return Decision(f"near goal ({degrees(angle_rad, 2)}): re-capturing to verify")


def compare(s: Situation) -> Decision | None:
    """Visit what competes with the best hypothesis; compare poses by equally many observations."""
    visit = s.competing
    if visit is None:
        if s.exploring and s.captures < s.settings.max_captures and s.is_equal(s.hypothesis_here, s.best):
            return Decision("near goal, an earlier pose matches equally: re-capturing to compare them")
        return None
    enough = s.images_left > s.settings.reserve + s.settings.max_captures
    if s.best is s.hypothesis_here and s.captures < s.settings.max_captures and enough:
        return Decision("near goal, a competing hypothesis is open: re-capturing to compare it later")
    kind = "180-degree flip" if visit.guessed else f"competing ({format_probability(visit.support)})"
    message = f"checking {kind} hypothesis: rotating {degrees(s.angle_rad(visit))}"
    return Decision(message, s.belief.R_goal_now(visit))


def approach(s: Situation) -> Decision | None:
    """The full move to the best hypothesis, from elsewhere. Ends the loop where no hypothesis is left, or no move or
    image is."""
    best = s.best
    if best is None:
        return Decision("no hypothesis is left to try, none matched the goal", status="unsure", confidence=0.0)
    if best is s.hypothesis_here:
        return None
    angle = degrees(s.angle_rad(best))
    if min(s.moves_left, s.images_left) <= 0:
        status: Status = "max_moves" if s.moves_left <= 0 else "max_images"
        message = f"no hypothesis is verified within the limits; the likeliest one is {angle} away"
        return Decision(message, status=status, confidence=0.0)
    if best.guessed:
        message = "approaching 180-degree flip hypothesis"
    elif best.visits:
        message = "returning to the best match"
    else:
        message = f"approaching likeliest hypothesis ({format_probability(best.support)})"
    return Decision(f"{message}: rotating {angle}", s.belief.R_goal_now(best))


def probe_symmetry(s: Situation) -> Decision | None:
    """At the best hypothesis with equals: capture often enough, then look from other sides."""
    belief, best = s.belief, s.best
    if not s.equals or best is None:
        return None
    compared = sum(len(x.observations) for x in belief.tested_viewpoints_at(best))
    if max(compared, s.captures) < s.settings.max_captures and s.images_left > 0:
        return Decision("another orientation matches equally: re-capturing to compare them")
    symmetric, R_elsewhere = s.symmetry
    if symmetric is None and s.exploring and s.reachable(R_elsewhere) and not belief.times_hidden(R_elsewhere):
        angle = degrees(float(so3.angle(R_elsewhere)))
        return Decision(f"another orientation matches equally: rotating {angle} to probe symmetry", R_elsewhere)
    return None


def settle(s: Situation) -> Decision | None:
    """Capture until the fused estimate is steady, then make the last small move."""
    fused = _Fused.of(s)
    if s.may_capture and fused.error_rad > s.settings.steady_rad:
        return Decision(f"{fused}: re-capturing")
    if not fused.settled and s.moves_left > 0 and s.images_left > 0:
        return Decision(f"{fused}: rotating by it", fused.R_goal_now)
    return None


def done(s: Situation) -> Decision:
    """The end: converged if the remaining rotation is small, the pose passed the arrival test at least once, the shape
    constrains the rotation, the last estimate agrees, and the confidence suffices."""
    assert s.best is not None
    fused, viewpoint = _Fused.of(s), s.belief.viewpoint_now
    passed = s.best.arrival_log_odds >= s.settings.min_arrival_log_odds
    weak_axis_rad = viewpoint.arrival.weak_axis_error_rad if viewpoint.arrival else 0.0
    confidence = _confidence(s, fused.angle_rad, passed)
    estimate = viewpoint.observations[-1].estimate
    leads_away = not s.equals and estimate.angle_rad > s.belief.settings.same_rad
    status: Status = "unsure"
    if not fused.settled and fused.angle_rad > s.settings.enough_rad:
        status = "max_moves" if s.moves_left <= 0 else "max_images"
    elif passed and not weak_axis_rad and not leads_away and confidence >= s.settings.min_confidence:
        status = "converged"
    parts = [
        f"estimate {degrees(estimate.angle_rad, 2)}, {fused}: {status.replace('_', ' ')}",
        *([] if fused.bound_rad is None else [f"within {degrees(fused.bound_rad, 2)} of the goal (95%)"]),
        *([] if status == "converged" else [f"confidence {format_probability(confidence)}"]),
        *([] if passed else ["no arrival test passed"]),
        *(["the last estimate leads away"] if leads_away else []),
        *([f"the shape constrains one axis only to {degrees(weak_axis_rad, 1)}"] if weak_axis_rad else []),
        *([f"another orientation matches equally, {_SYMMETRY[s.symmetry[0]]}"] if s.equals else []),
    ]
    return Decision("; ".join(parts), status=status, confidence=confidence, bound_rad=fused.bound_rad)


_SYMMETRY = {
    True: "from another side, too: the object appears symmetric",
    False: "but not from another side: the object is not symmetric",
    None: "no two other sides were seen to test symmetry",
}


def _confidence(s: Situation, angle_rad: float, passed: bool) -> float:
    """Probability that the present pose is within 5 degrees of the goal: by the pose's log-odds, shared with all that
    match equally unless these are one by symmetry, and by the remaining rotation."""
    assert s.best is not None
    log_odds = s.belief.viewpoint_now.log_odds(s.belief.settings)
    if not passed:
        log_odds = min(log_odds, s.best.arrival_log_odds)
    shared = 1 if not s.equals or s.symmetry[0] else 1 + len(s.equals)
    within = 0.5 * erfc((angle_rad - s.settings.within_rad) / s.settings.fused_error_rad / sqrt(2))
    return float(1 / (1 + np.exp(-log_odds))) / shared * within


@dataclass(frozen=True, eq=False)
class _Fused:
    """The fused estimate of the remaining rotation to the best hypothesis."""

    R_goal_now: Float[np.ndarray, "3 3"]
    angle_rad: float
    error_rad: float
    """Standard error by the scatter of the estimates, which more of them lower."""
    settled: bool
    """Whether it is small, or not clearly above that."""
    covariance_rad2: Float[np.ndarray, "3 3"] | None
    """Of all its error; None where no estimate has one."""

    @property
    def bound_rad(self) -> float | None:
        """The remaining angle is at most this in 95% of the cases, if the hypothesis is the goal; None if unknown."""
        if self.covariance_rad2 is None:
            return None
        return bound_rad(self.covariance_rad2, so3.log(self.R_goal_now))

    @classmethod
    def of(cls, s: Situation) -> "_Fused":
        assert s.best is not None
        R_goal_now, error_rad = s.belief.fused(s.best)
        angle_rad = float(so3.angle(R_goal_now))
        settled = angle_rad <= max(s.settings.tolerance_rad, s.settings.significance * error_rad)
        return cls(R_goal_now, angle_rad, error_rad, settled, s.belief.error_covariance(s.best))

    def __str__(self) -> str:
        whole = self.covariance_rad2
        error_rad = self.error_rad if whole is None else float(np.sqrt(np.trace(whole)))
        return f"fused {format_number(float(np.degrees(self.angle_rad)))} +- {degrees(error_rad, 2)}"
