"""What the loop records, and what a strategy is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage

Reachable = Callable[[Float[np.ndarray, "3 3"]], bool]
"""Whether the station can make a rotation (camera axes, left) from where it is."""


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the loop."""

    index: int
    """From 0."""
    image: DepthImage
    """What the station saw before the move."""
    estimate: RotationEstimate
    """What is still missing, by the estimator."""
    R_step: Float[np.ndarray, "3 3"] | None
    """The move that was asked for; None where the loop looked again, or ended."""
    R_executed: Float[np.ndarray, "3 3"] | None
    """The move that was really made; None where there was none, or where nobody knows."""
    said: str = ""
    """The decision in words."""
    fault: str = ""
    """What went wrong in the move."""
    undone: bool = False
    """Whether the move was taken back, as nothing could be seen after it; ``R_executed`` is then of both moves."""

    @property
    def moves(self) -> int:
        """How often the object was turned after this image, as far as is known."""
        return 0 if self.R_executed is None else 1 + self.undone


@dataclass(frozen=True, eq=False)
class Decision:
    """What a strategy wants: a move, another look from here, or the end."""

    said: str
    """Why, in words."""
    R_step: Float[np.ndarray, "3 3"] | None = None
    """The next rotation (camera axes, left); None: none."""
    ends: bool = False
    """Whether the loop ends here."""
    converged: bool = False
    """Whether the goal is reached, where it ends."""
    confidence: float | None = None
    """How likely the goal is reached, where it ends; None where that is not known."""


@dataclass(frozen=True, eq=False)
class OrientResult:
    """The record of a loop."""

    steps: tuple[Step, ...]
    converged: bool
    """Whether the strategy's own tolerance was met, as far as the shape of what is seen tells."""
    reason: str
    """Why it ended, in words."""
    confidence: float | None = None
    """How likely the object is now within 5 degrees of the goal; at most one half where another orientation was seen
    to match as well, unless the object looks symmetric; None where not known."""
    faults: tuple[str, ...] = ()
    """What went wrong on the way, in words."""

    @property
    def moves(self) -> int:
        """How often the object was turned."""
        return sum(step.moves for step in self.steps)


@runtime_checkable
class Strategy(Protocol):
    """Decides each move from the record. It holds no state: the same record makes the same decision."""

    @property
    def max_steps(self) -> int:
        """Largest number of images."""
        ...

    @property
    def patience(self) -> int:
        """How many failures of camera, gripper or estimator in a row it bears."""
        ...

    @property
    def takes_back(self) -> bool:
        """Whether a large move after which that many are exceeded is taken back, and the loop goes on from there. The
        strategy finds it in the record as ``undone``."""
        ...

    def recalled(self, steps: Sequence[Step]) -> list[tuple[DepthImage, Float[np.ndarray, "3 3"]]]:
        """Of the captures so far, those that the estimator is given as history, each with R_now_then."""
        ...

    def decide(self, steps: Sequence[Step], goal: DepthImage, reachable: Reachable) -> Decision:
        """What to do; the last of the steps is the present one, with neither a move nor words yet."""
        ...


def known_part(steps: Sequence[Step]) -> Sequence[Step]:
    """The steps since the last move of which nobody knows what it did: only these are one chain of known rotations."""
    lost = [k for k, step in enumerate(steps) if step.R_step is not None and step.R_executed is None and step.fault]
    return steps[lost[-1] + 1 :] if lost else steps


def rotations_since(steps: Sequence[Step]) -> list[Float[np.ndarray, "3 3"]]:
    """R_now_then of each step: what turned the object from its image to now."""
    R_now_then = np.eye(3)
    found = []
    for step in reversed(steps):
        if step.R_executed is not None:
            R_now_then = R_now_then @ step.R_executed
        found.append(R_now_then)
    return found[::-1]
