"""The closed loop: capture, estimate, decide, turn, until the object looks like the goal.

It knows only what an estimator, a station and a strategy are. Recording, drawing and printing are subscribers.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from numbers import Integral

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.algorithm1 import Proportional
from reorient.controller.base import Decision, OrientResult, Step, Strategy
from reorient.controller.fusing import Fusing
from reorient.controller.limits import Limits, nearest_reachable
from reorient.controller.station import Station, captured, lacking, pivot_of
from reorient.errors import ReorientError, StationError
from reorient.estimators.base import Estimator, RotationEstimate, as_estimate, check_pair
from reorient.imaging import DepthImage

LEAST_GAIN_RAD = float(np.radians(0.5))  # a way round an unreachable move is taken if it comes nearer by this
LEAST_HIDING_RAD = float(np.radians(5))  # smaller moves do not hide an object that was seen before


def orient(
    station: Station,
    goal: DepthImage,
    estimator: Estimator,
    strategy: Strategy | None = None,
    pivot_m: Float[np.ndarray, "3"] | None = None,
    subscribers: Sequence[Callable[[Step], None]] = (),
    limits: Limits | None = None,
    max_steps: int | None = None,
) -> OrientResult:
    """Turn the object at the station until it looks like the goal.

    ``strategy`` None: ``Fusing`` for an estimator with a calibrated confidence, Algorithm 1 for any other; with at most
    ``max_steps`` images, or as many as suits each. ``pivot_m``: rotation centre, camera axes; None: the station's own.
    Subscribers are called with each step, after its move. A failing station or estimator is asked again as often as the
    strategy bears; then a large last move is taken back, if the strategy wants that, or else the loop ends with the
    record kept and the reason said. Bad arguments raise ReorientError before anything moves.
    """
    if not isinstance(goal, DepthImage):
        raise ReorientError(f"goal is a {type(goal).__name__}: expected DepthImage(depth_m, camera)")
    for thing, members in (
        (station, ("capture", "rotate", "pivot_m")),
        (estimator, ("estimate",)),
        (strategy, () if strategy is None else ("max_steps", "patience", "takes_back", "recalled", "decide")),
    ):
        if isinstance(thing, type) or lacking(thing, members):
            raise ReorientError(f"{thing!r} given: expected an object with {', '.join(members)}")
    if not isinstance(limits, Limits | None):
        raise ReorientError(f"limits {limits!r}: expected reorient.Limits, or None")
    if max_steps is not None and (strategy is not None or not isinstance(max_steps, Integral) or max_steps < 2):
        raise ReorientError(f"max_steps {max_steps}: expected at least 2, and no strategy, which has its own")
    pivot_m = pivot_of(station) if pivot_m is None else pivot_m
    check_pair(goal, goal, pivot_m)
    return _Loop(station, goal, estimator, strategy, pivot_m, subscribers, limits or Limits(), max_steps).run()


class _Ended(Exception):
    """The loop is over; why."""


class _Loop:
    """One run: the record so far, and the acts that add to it."""

    def __init__(
        self,
        station: Station,
        goal: DepthImage,
        estimator: Estimator,
        strategy: Strategy | None,
        pivot_m: Float[np.ndarray, "3"] | None,
        subscribers: Sequence[Callable[[Step], None]],
        limits: Limits,
        max_steps: int | None,
    ) -> None:
        self.station, self.goal, self.estimator, self.strategy = station, goal, estimator, strategy
        self.pivot_m, self.subscribers, self.limits = pivot_m, subscribers, limits
        self.max_steps = max_steps
        self.steps: list[Step] = []
        self.faults: list[str] = []
        self.failures = 0
        """In a row."""
        self.turned_rad = 0.0
        self.last_s = -np.inf
        """Stamp of the last frame that was taken."""
        self.oldest_s = -np.inf
        """What is stamped with less shows the object before its last move."""
        self.asked = False
        """Whether the first move has been confirmed."""

    def run(self) -> OrientResult:
        try:
            while True:
                if self.strategy is not None and len(self.steps) >= self.strategy.max_steps:
                    raise _Ended(f"limit of {self.strategy.max_steps} images")
                seen = self.look()
                if seen is None:
                    continue
                decision = self.decide(*seen)
                self.act(decision)
                if decision.ends:
                    return self.result(decision.said, decision.converged, decision.confidence)
        except _Ended as ended:
            return self.result(str(ended), False, None)

    def look(self) -> tuple[DepthImage, RotationEstimate] | None:
        """Capture and estimate; None where that failed and is to be tried again."""
        try:
            image = captured(self.station.capture())
            self.refuse_stale(image)
        except Exception as error:  # a driver may raise anything; the record must survive it
            self.failed(f"the station failed to capture: {_said(error)}")
            return None
        try:
            history = self.strategy.recalled(self.steps) if self.strategy else []
            answer = self.estimator.estimate(image, self.goal, self.pivot_m, history)
            estimate = as_estimate(answer, image, self.goal)
        except Exception as error:
            self.failed(f"the estimator failed: {_said(error)}")
            return None
        if self.strategy is None:
            suited = Proportional if estimate.confidence is None else Fusing
            self.strategy = suited() if self.max_steps is None else suited(max_steps=self.max_steps)
        return image, estimate

    def refuse_stale(self, image: DepthImage) -> None:
        """Raise StationError for a frame that shows the object before its last move."""
        if image.stamp_s is None:
            return
        if image.stamp_s < self.oldest_s:
            raise StationError(
                f"stale frame: captured at {image.stamp_s:.3f} s, before the last move ended ({self.oldest_s:.3f} s)"
            )
        self.last_s = image.stamp_s

    def moved(self) -> None:
        """Whatever was captured up to now is out of date: by the station's clock, or, where it shows none, as old as
        the last frame."""
        clock_s = _clock_s(self.station)
        self.oldest_s = float(np.nextafter(self.last_s, np.inf)) if clock_s is None else clock_s

    def decide(self, image: DepthImage, estimate: RotationEstimate) -> Decision:
        """Add the step to the record, as yet without a move, and ask the strategy."""
        assert self.strategy is not None
        self.steps.append(Step(len(self.steps), image, estimate, None, None))
        try:
            decision = self.strategy.decide(self.steps, self.goal, self.reachable)
        except Exception as error:  # it may be the user's own; the record must survive it
            raise _Ended(f"the strategy failed: {_said(error)}") from error
        self.steps[-1] = replace(self.steps[-1], said=decision.said)
        return decision

    def act(self, decision: Decision) -> None:
        """Make the move, if there is one, and tell the subscribers."""
        R_step, R_executed, ending, fault = decision.R_step, None, "", ""
        if R_step is not None and not self.reachable(R_step):
            ending, R_step = self.way_round(R_step)
        if R_step is not None and not ending:
            ending = self.forbidden(R_step)
        if self.limits.dry_run and not decision.ends:
            ending = f"dry run: {ending or decision.said}; nothing moved"
        if ending:
            R_step = None
        if R_step is not None:
            R_executed, fault = self.turn(R_step)
        self.steps[-1] = replace(self.steps[-1], R_step=R_step, R_executed=R_executed, fault=fault)
        for subscriber in self.subscribers:
            subscriber(self.steps[-1])
        if ending:
            raise _Ended(ending)
        if fault:
            self.failed(fault)
        else:
            self.failures = 0

    def forbidden(self, R_step: Float[np.ndarray, "3 3"]) -> str:
        """Why the limits forbid a move, the one that would really be made; nothing where they do not."""
        degrees = f"{np.degrees(so3.angle(R_step)):.1f} degrees"
        if self.limits.dry_run:
            rotvec = " ".join(f"{x:.4f}" for x in so3.log(R_step))
            return f"would turn by {degrees} (rotation vector [{rotvec}], camera axes)"
        if self.turned_rad + float(so3.angle(R_step)) > self.limits.largest_total_rad:
            return f"the next move of {degrees} would exceed the largest total rotation"
        if not self.asked and self.limits.confirm is not None and not self.limits.confirm(R_step):
            return f"the first move of {degrees} was not confirmed"
        self.asked = True
        return ""

    def way_round(self, R_step: Float[np.ndarray, "3 3"]) -> tuple[str, Float[np.ndarray, "3 3"]]:
        """For a move that the station cannot make the nearest that it can, or why the loop ends."""
        nearest = nearest_reachable(R_step, self.reachable)
        wanted_rad = float(so3.angle(R_step))
        left_rad = wanted_rad if nearest is None else float(so3.angle_difference(nearest, R_step))
        said = (
            f"the station cannot turn by {np.degrees(wanted_rad):.1f} degrees as wanted; the nearest reachable "
            f"orientation leaves {np.degrees(left_rad):.1f}"
        )
        if nearest is None or wanted_rad - left_rad < LEAST_GAIN_RAD:
            return said, R_step
        self.faults.append(said)
        return "", nearest

    def turn(self, R_step: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"] | None, str]:
        """Turn in parts that keep to the largest step; what was really done (None: unknown), and what went wrong."""
        R_done: Float[np.ndarray, "3 3"] = np.eye(3)
        for part in self.limits.parts(R_step):
            try:
                done = _executed(self.station.rotate(part))
            except Exception as error:
                self.turned_rad += float(so3.angle(part))  # it may have been made before it failed
                return None, f"the station failed to rotate: {_said(error)}"
            finally:
                self.moved()
            R_done = done @ R_done
            self.turned_rad += float(so3.angle(done))
        return R_done, ""

    def reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """Whether the station can make a move, if it has a way to tell; asked of the whole, though the limits may have
        it made in parts."""
        ask = getattr(self.station, "reachable", None)
        if ask is None:
            return True
        try:
            return bool(ask(R_step))
        except Exception:  # a station that cannot tell is asked to move, and may refuse then
            return True

    def failed(self, said: str) -> None:
        """Note a failure; where the strategy has no more patience take the last move back, or raise _Ended."""
        self.faults.append(said)
        self.failures += 1
        if self.failures > (self.strategy.patience if self.strategy else Fusing().patience) and not self.take_back():
            raise _Ended(said)
        time.sleep(self.limits.wait_s)

    def take_back(self) -> bool:
        """Undo the last move, if it is a large one that may have hidden the object; whether that was done."""
        step = self.steps[-1] if self.steps else None
        if step is None or step.R_executed is None or step.undone or not (self.strategy and self.strategy.takes_back):
            return False
        R_back = step.R_executed.T
        if float(so3.angle(R_back)) < LEAST_HIDING_RAD or self.forbidden(R_back):
            return False
        R_done, fault = self.turn(R_back)
        degrees = f"{np.degrees(so3.angle(R_back)):.0f} degrees"
        self.faults.append(fault or f"nothing could be seen after the move of {degrees}: it was taken back")
        R_both = None if R_done is None else R_done @ step.R_executed
        self.steps[-1] = replace(step, R_executed=R_both, fault=fault, undone=True)
        self.failures = 0
        return not fault

    def result(self, reason: str, converged: bool, confidence: float | None) -> OrientResult:
        return OrientResult(tuple(self.steps), converged, reason, confidence, tuple(self.faults))


def _clock_s(station: Station) -> float | None:
    """The station's clock now, on which frames are stamped; None where it has none to show."""
    try:
        clock_s = float(station.clock_s())  # type: ignore[attr-defined]
    except Exception:  # without one, or with one that fails
        return None
    return clock_s if np.isfinite(clock_s) else None


def _executed(R: object) -> Float[np.ndarray, "3 3"]:
    if not so3.is_rotation(np.asarray(R, float) if R is not None else np.empty(0)):
        raise StationError("rotate() returned no rotation: expected the (3, 3) matrix of what was really done")
    return np.asarray(R, float)


def _said(error: Exception) -> str:
    return str(error) if isinstance(error, ReorientError) else f"{type(error).__name__}: {error}"
