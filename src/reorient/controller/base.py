"""The record of a loop, and the protocol of a strategy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient.estimators.base import History, RotationEstimate
from reorient.formatting import format_number
from reorient.imaging import DepthImage

Reachable = Callable[[Float[np.ndarray, "3 3"]], bool]
"""Whether the station can make a rotation (camera axes, left) from its present pose."""

Status = Literal[
    "converged",  # the goal is reached within the strategy's tolerance
    "unsure",  # the strategy ended at its best hypothesis, or without one, and does not state that it is the goal
    "unreachable",  # the station cannot make the next move, nor one that comes near it
    "max_moves",  # the strategy's limit of moves
    "max_images",  # the strategy's limit of images
    "station_failed",
    "estimator_failed",
    "strategy_failed",
    "inconsistent_motion",  # images contradict the motion that the station reported
    "max_rotation",  # the next move would exceed Limits.max_rotation_rad
    "declined",  # the first move was not confirmed
    "interrupted",  # by the keyboard
    "dry_run",  # the first decision is made, nothing was moved
]


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the loop: an observation and the move after it."""

    index: int
    """From 0."""
    image: DepthImage
    """The observation before the move."""
    estimate: RotationEstimate
    """The remaining rotation, by the estimator."""
    R_step: Float[np.ndarray, "3 3"] | None = None
    """The commanded move (camera axes, left); None where the loop re-captured, or ended."""
    R_executed: Float[np.ndarray, "3 3"] | None = None
    """The move as the station reported it; None where there was none, or where it is unknown."""
    message: str = ""
    """The decision in words."""
    error: str = ""
    """The error of the move, in words; with it, ``R_executed`` None means an unknown motion."""
    undone: bool = False
    """Whether the move was undone, as no observation was possible after it; ``R_executed`` is then of both moves."""
    phase: str = ""
    """The strategy's phase that made the decision."""
    hypotheses: tuple[tuple[Float[np.ndarray, "3 3"], float], ...] = ()
    """What the strategy believes by now: remaining rotations to the goal, the likeliest first, each with its log-odds;
    empty for a strategy without such a belief."""

    @property
    def moves(self) -> int:
        """Number of known moves after this observation: 0, 1 or, where the move was undone, 2."""
        return 0 if self.R_executed is None else 1 + self.undone

    @property
    def motion_unknown(self) -> bool:
        """Whether the object was moved by an unknown rotation after this observation."""
        return self.R_step is not None and self.R_executed is None and bool(self.error)


@dataclass(frozen=True, eq=False)
class Decision:
    """The next act of a strategy: a move, a further observation from the same pose, or the end."""

    message: str
    """The reason, in words."""
    R_step: Float[np.ndarray, "3 3"] | None = None
    """The next rotation (camera axes, left); None: none."""
    status: Status | None = None
    """How the loop ends; None: it goes on."""
    confidence: float | None = None
    """At the end: the probability that the goal is reached; None where unknown."""
    phase: str = ""
    """The phase that made the decision."""
    bound_rad: float | None = None
    """At the end: the remaining angle is at most this in 95% of the cases, if the goal is reached; None if unknown."""


@dataclass(frozen=True, eq=False)
class OrientResult:
    """The record of a loop."""

    steps: tuple[Step, ...]
    status: Status
    """How it ended."""
    reason: str
    """The same as a sentence; for people, not for programs."""
    confidence: float | None = None
    """Probability that the object is within 5 degrees of the goal; at most one half where another orientation matches
    equally, unless the object appears symmetric; None where unknown."""
    errors: tuple[str, ...] = ()
    """Errors that the loop survived, and the last one, in words."""
    bound_rad: float | None = None
    """The remaining angle is at most this in 95% of the cases, if the pose is the goal's and no flip of it; None where
    unknown."""
    expected_rad: float | None = None
    """The root mean square of that angle that was expected before the first move; None where unknown."""
    distance_m: float | None = None
    """Distance from the goal's place that ``orient(translation=True)`` left, by the last estimates; else None."""

    @property
    def converged(self) -> bool:
        """Whether the goal is reached within the strategy's tolerance."""
        return self.status == "converged"

    @property
    def moves(self) -> int:
        """Number of known moves."""
        return sum(step.moves for step in self.steps)


@runtime_checkable
class AnyBelief(Protocol):
    """What a strategy infers from the steps; immutable."""

    def updated(self, step: Step) -> "AnyBelief":
        """The belief after one more step.

        The loop adds each step as soon as it is observed, without a move, and again, with the same index, as often as
        its move becomes known: after the move, and where that is undone. The last one counts.
        """
        ...


@runtime_checkable
class Strategy(Protocol):
    """Decides on each move. All that it remembers is in the belief that the loop folds over the steps:
    ``belief = strategy.start(goal)``, then ``belief = belief.updated(step)``."""

    @property
    def max_images(self) -> int:
        """Largest number of images."""
        ...

    @property
    def patience(self) -> int:
        """Number of consecutive errors of station or estimator that the loop survives."""
        ...

    @property
    def undoes_moves(self) -> bool:
        """Whether, once ``patience`` is exceeded after a large move, that move is undone and the loop goes on. The
        belief receives the step anew, with ``undone`` set."""
        ...

    @property
    def history(self) -> bool:
        """Whether the estimator receives earlier images."""
        ...

    def start(self, goal: Any) -> AnyBelief:
        """The belief before the first step. ``goal``: a DepthImage; of a goal of several views, the Goal, aligned."""
        ...

    def decide(self, belief: Any, reachable: Reachable) -> Decision:
        """The next act; the latest step of the belief is the present one, still without a move."""
        ...


def history_of(steps: Sequence[Step]) -> History:
    """All images since the last unknown motion, each with R_now_then, in order; for ``Estimator.estimate``."""
    R_now_then = np.eye(3)
    found = []
    for step in reversed(steps):
        if step.motion_unknown:
            break
        if step.R_executed is not None:
            R_now_then = R_now_then @ step.R_executed
        found.append((step.image, R_now_then))
    return found[::-1]


def degrees(angle_rad: float, decimals: int = 0) -> str:
    """An angle in words: 0.42 deg."""
    return f"{format_number(float(np.degrees(angle_rad)), decimals)} deg"
