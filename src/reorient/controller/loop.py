"""The closed loop: capture, estimate, decide, rotate, until the object matches the goal.

It knows only the protocols of estimator, station and strategy. Recording, drawing and printing are subscribers.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.algorithm1 import Algorithm1
from reorient.controller.base import Decision, OrientResult, Status, Step, Strategy, degrees, history_of
from reorient.controller.ending import Ended, plan, rotation_error
from reorient.controller.fusing import Fusing
from reorient.controller.limits import Limits, nearest_reachable
from reorient.controller.motion import MotionRecord
from reorient.controller.positioning import Positioning
from reorient.controller.remaining import expected_error_rad
from reorient.controller.session import Session, StationHangs
from reorient.controller.station import Station, missing_members, pivot_of
from reorient.errors import ReorientError
from reorient.estimators.base import Estimator, RotationEstimate, as_estimate, check_pair, for_any_goal
from reorient.imaging import DepthImage, Goal, as_goal
from reorient.plugins import PROGRAMMING_ERRORS, USER_ERRORS, in_words
from reorient.registration import aligned_goal

MIN_GAIN_RAD = float(np.radians(0.5))
"""An alternative to an unreachable move is made if it comes nearer by this. Not tuned."""
MIN_UNDONE_RAD = float(np.radians(5))
"""Smaller moves do not hide an object that was visible before. Not tuned."""
INTERRUPTED = "interrupted by the keyboard"
_FINAL = (*PROGRAMMING_ERRORS, StationHangs)
"""Errors that no repetition avoids."""
_STRATEGY = ("max_images", "patience", "undoes_moves", "history", "start", "decide")


def orient(
    station: Station,
    goal: DepthImage | Goal,
    estimator: Estimator,
    strategy: Strategy | None = None,
    pivot_m: Float[np.ndarray, "3"] | None = None,
    limits: Limits | None = None,
    subscribers: Sequence[Callable[[Step], None]] = (),
    translation: bool = False,
) -> OrientResult:
    """Rotate the object at the station until it matches the goal.

    An estimator that knows one goal view (see ``load_estimator``) receives the primary view of a ``Goal``.
    ``strategy`` None: ``Fusing`` for an estimator with a calibrated confidence, Algorithm 1 for any other. ``pivot_m``:
    rotation centre, camera axes; None: the station's own. Subscribers are called with each step, after its move; where
    one has a method ``decided``, this is called with the step before the move, too.

    An error of station or estimator is retried as often as the strategy's patience allows, but a programming error is
    not. After that a large last move is undone, if the strategy wants that, or else the loop ends with the record kept.
    It also ends with the record kept at a KeyboardInterrupt, where a call of the station does not end in time, and
    where the images of two moves contradict the rotations that the station reported. ``translation``: bring the object
    to the place of the goal, too, by ``station.move``: roughly before the loop, exactly once it has converged. Raises
    ReorientError for bad arguments, before anything moves.
    """
    goal = as_goal(goal)
    for thing, members in (
        (station, ("capture", "rotate", "pivot_m", *(["move"] * translation))),
        (estimator, ("estimate",)),
        (strategy, () if strategy is None else _STRATEGY),
    ):
        if isinstance(thing, type) or missing_members(thing, members):
            raise ReorientError(f"{thing!r} given: expected an object with {', '.join(members)}")
    if not isinstance(limits, Limits | None):
        raise ReorientError(f"limits {limits!r}: expected reorient.Limits, or None")
    pivot_m = pivot_of(station) if pivot_m is None else pivot_m
    check_pair(goal.image, goal, pivot_m)
    limits = limits or Limits()
    loop = _Loop(Session(station, limits), goal, for_any_goal(estimator), strategy, pivot_m, limits, subscribers)
    try:
        return loop.run_in_place() if translation else loop.run()
    finally:
        loop.session.close()


@dataclass(eq=False)
class _Loop:
    """One run: the record so far, and the acts that add to it."""

    session: Session
    goal: Goal
    estimator: Estimator
    strategy: Strategy | None
    pivot_m: Float[np.ndarray, "3"] | None
    limits: Limits
    subscribers: Sequence[Callable[[Step], None]]
    steps: list[Step] = field(default_factory=list)
    belief: Any = None
    """The strategy's; None before the first step."""
    errors: list[str] = field(default_factory=list)
    consecutive_errors: int = 0
    motion: MotionRecord | None = None
    """How the reported rotations compare with the images; None before the first image."""
    expected_rad: float | None = None
    """The error to expect at the end; None before the first image, and where it is unknown."""
    confirmed: bool = False
    """Whether the first move has been confirmed."""

    def run(self) -> OrientResult:
        try:
            while True:
                observation = self.observe()
                if observation is not None:
                    self.act(self.decide(*observation))
        except Ended as end:
            return replace(self.result(end.status, end.reason, end.confidence), bound_rad=end.bound_rad)
        except KeyboardInterrupt:
            return self.result("interrupted", INTERRUPTED)

    def run_in_place(self) -> OrientResult:
        """Run between translations to the goal's place."""

        def run(moved_m: Float[np.ndarray, "3"]) -> OrientResult:
            self.pivot_m = None if self.pivot_m is None else self.pivot_m + moved_m
            self.confirmed = bool(np.any(moved_m))
            return self.run()

        return Positioning(self.session, self.goal, self.estimator, self.limits).around(run)

    def result(self, status: Status, reason: str, confidence: float | None = None) -> OrientResult:
        """The record, and how the loop ended."""
        return OrientResult(
            tuple(self.steps), status, reason, confidence, tuple(self.errors), expected_rad=self.expected_rad
        )

    def observe(self) -> tuple[DepthImage, RotationEstimate] | None:
        """Capture and estimate; None where one failed and is to be retried."""
        if self.strategy is not None and len(self.steps) >= self.strategy.max_images:
            raise Ended("max_images", f"limit of {self.strategy.max_images} images")
        try:
            image = self.session.capture()
        except USER_ERRORS as error:  # a driver may raise anything; the record must survive it
            self.failed("station_failed", f"the station failed to capture: {in_words(error)}", error)
            return None
        try:
            history = history_of(self.steps) if self.strategy is not None and self.strategy.history else ()
            answer = self.estimator.estimate(image, self.goal, self.pivot_m, history)
            return image, as_estimate(answer, image, self.goal.image)
        except USER_ERRORS as error:
            self.failed("estimator_failed", f"the estimator failed: {in_words(error)}", error)
            return None

    def decide(self, image: DepthImage, estimate: RotationEstimate) -> Decision:
        """Add the step to the record, still without a move, check the motion before it, and ask the strategy."""
        if self.strategy is None:
            self.strategy = Algorithm1() if estimate.confidence is None else Fusing()
        self.steps.append(Step(len(self.steps), image, estimate))
        self.check_motion()
        try:
            if self.belief is None:
                aligned, _ = aligned_goal(self.goal, self.pivot_m)  # the estimates carry its warnings
                self.belief = self.strategy.start(aligned if aligned.views else aligned.image)
            self.belief = self.belief.updated(self.steps[-1])
            decision = self.strategy.decide(self.belief, self.session.reachable)
        except USER_ERRORS as error:  # it may be the user's own; the record must survive it
            raise Ended("strategy_failed", f"the strategy failed: {in_words(error)}") from error
        believed = getattr(self.belief, "hypotheses_now", ())
        message = decision.message
        if len(self.steps) == 1:
            self.expected_rad = expected_error_rad(self.estimator, image, self.goal)
            message += "" if self.expected_rad is None else f"; expected final error {degrees(self.expected_rad, 2)}"
        self.steps[-1] = replace(self.steps[-1], message=message, phase=decision.phase, hypotheses=believed)
        return decision

    def check_motion(self) -> None:
        """Raise Ended where the images contradict the rotations that the station reported."""
        now = self.steps[-1]
        self.motion = MotionRecord.start(now.image) if self.motion is None else self.motion.updated(self.steps[-2], now)
        if message := self.motion.contradiction:
            self.steps[-1] = replace(self.steps[-1], message=message)
            raise Ended("inconsistent_motion", message)

    def act(self, decision: Decision) -> None:
        """Make the move, if there is one, and call the subscribers; raise Ended where the loop ends."""
        for subscriber in self.subscribers:
            getattr(subscriber, "decided", lambda _: None)(self.steps[-1])
        R_step, end = self.planned(decision)
        error = None if R_step is None else self.move(R_step)
        step = self.steps[-1]
        for subscriber in self.subscribers:
            subscriber(step)
        if end is not None:
            raise end
        if error is not None:
            self.failed("station_failed", step.error, error)
        else:
            self.consecutive_errors = 0

    def planned(self, decision: Decision) -> tuple[Float[np.ndarray, "3 3"] | None, Ended | None]:
        """The move that will be made, and how the loop ends, if it does."""
        if decision.status is not None:
            return None, Ended(decision.status, decision.message, decision.confidence, decision.bound_rad)
        R_step, end = (None, None) if decision.R_step is None else self.nearest_move(decision.R_step)
        if self.limits.dry_run:
            return None, Ended("dry_run", f"dry run: {plan(R_step, end) or decision.message}; nothing moved")
        if R_step is not None:
            end = self.refusal(R_step)
        return (R_step if end is None else None), end

    def nearest_move(self, R_step: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"] | None, Ended | None]:
        """A move, or the nearest one that the station can make instead, or how the loop ends."""
        if self.session.reachable(R_step):
            return R_step, None
        nearest = nearest_reachable(R_step, self.session.reachable)
        wanted_rad = float(so3.angle(R_step))
        left_rad = wanted_rad if nearest is None else float(so3.angle_difference(nearest, R_step))
        message = (
            f"the station cannot rotate by {degrees(wanted_rad, 1)}; the nearest reachable orientation leaves "
            f"{degrees(left_rad, 1)}"
        )
        if nearest is None or wanted_rad - left_rad < MIN_GAIN_RAD:
            return None, Ended("unreachable", message)
        self.errors.append(message)
        return nearest, None

    def refusal(self, R_step: Float[np.ndarray, "3 3"]) -> Ended | None:
        """How the loop ends if the limits forbid a move."""
        angle = degrees(float(so3.angle(R_step)), 1)
        if self.session.rotated_rad + float(so3.angle(R_step)) > self.limits.max_rotation_rad:
            return Ended("max_rotation", f"the next move of {angle} would exceed the largest total rotation")
        if not self.confirmed and self.limits.confirm is not None and not self.limits.confirm(R_step):
            return Ended("declined", f"the first move of {angle} was not confirmed")
        self.confirmed = True
        return None

    def move(self, R_step: Float[np.ndarray, "3 3"]) -> BaseException | None:
        """Make a move and record it; returns its error."""
        self.steps[-1] = replace(self.steps[-1], R_step=R_step)
        R_executed, error = self.rotate(R_step)
        self.record(replace(self.steps[-1], R_executed=R_executed, error=rotation_error(error)))
        return error

    def record(self, step: Step) -> None:
        """Replace the latest step, whose move is known by now, in the record and in the belief."""
        self.steps[-1] = step
        try:
            self.belief = self.belief.updated(step)
        except USER_ERRORS as error:
            raise Ended("strategy_failed", f"the strategy failed: {in_words(error)}") from error

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"] | None, BaseException | None]:
        """The executed rotation (None: unknown) and the error."""
        try:
            return self.session.rotate(R_step), None
        except USER_ERRORS as error:
            return None, error
        except KeyboardInterrupt:
            self.steps[-1] = replace(self.steps[-1], R_executed=None, error=INTERRUPTED)
            raise

    def failed(self, status: Status, message: str, error: BaseException) -> None:
        """Record an error. Beyond the strategy's patience undo the last move; raise Ended where that is not done, and
        for an error that no repetition avoids."""
        self.errors.append(message)
        self.consecutive_errors += 1
        if isinstance(error, _FINAL):
            raise Ended(status, message)
        patience = Fusing().patience if self.strategy is None else self.strategy.patience
        if self.consecutive_errors > patience and not self.undo():
            raise Ended(status, message)
        time.sleep(self.limits.wait_s)

    def undo(self) -> bool:
        """Undo the last move, if it is a large one that may have hidden the object; returns whether that was done."""
        step = self.steps[-1] if self.steps else None
        if step is None or step.R_executed is None or step.undone:
            return False
        R_back = step.R_executed.T
        if self.strategy is None or not self.strategy.undoes_moves or float(so3.angle(R_back)) < MIN_UNDONE_RAD:
            return False
        if self.refusal(R_back) is not None:
            return False
        R_done, error = self.rotate(R_back)
        angle = degrees(float(so3.angle(R_back)))
        message = rotation_error(error)
        self.errors.append(message or f"no observation was possible after the move of {angle}: it was undone")
        R_both = None if R_done is None else R_done @ step.R_executed
        self.record(replace(step, R_executed=R_both, error=message, undone=True))
        self.consecutive_errors = 0
        return error is None
