"""The closed loop: capture, estimate, turn, until the object looks like the goal.

It knows only what an estimator and a station are. Recording, drawing and printing are subscribers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.depth import DepthImage
from reorient.errors import ReorientError, StationError
from reorient.estimators.base import Estimator, RotationEstimate, check_pair
from reorient.stations.base import Station


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
    """The move that was asked for; None where the loop ended instead."""
    R_executed: Float[np.ndarray, "3 3"] | None
    """The move that was really made; None where there was none."""


@dataclass(frozen=True, eq=False)
class OrientResult:
    """The record of a loop."""

    steps: tuple[Step, ...]
    converged: bool
    """Whether the strategy's own tolerance was met."""
    reason: str
    """Why it ended, in words."""

    @property
    def moves(self) -> int:
        """How often the object was turned."""
        return sum(step.R_executed is not None for step in self.steps)


@runtime_checkable
class Strategy(Protocol):
    """Decides each move from the latest estimate."""

    @property
    def max_steps(self) -> int:
        """Largest number of images."""
        ...

    def move(self, estimate: RotationEstimate) -> Float[np.ndarray, "3 3"] | None:
        """The next rotation (camera axes, left), or None when done."""
        ...


@dataclass(frozen=True)
class Proportional:
    """The paper's Algorithm 1: turn the share eta of the predicted rotation until the prediction is small."""

    max_steps: int = 100
    """K, largest number of images."""
    eta: float = 0.2
    """Share of the predicted rotation to turn at once, in (0, 1]."""
    delta_rad: float = float(np.radians(0.5))
    """Done when the predicted angle is at most this."""

    def __post_init__(self) -> None:
        if not (self.max_steps >= 1 and 0 < self.eta <= 1 and self.delta_rad >= 0):
            raise ReorientError(
                f"K={self.max_steps}, eta={self.eta}, delta={self.delta_rad}: expected K >= 1, 0 < eta <= 1, delta >= 0"
            )

    def move(self, estimate: RotationEstimate) -> Float[np.ndarray, "3 3"] | None:
        """Slerp from no rotation towards the prediction.

        The prediction is in camera axes, so it multiplies on the left, by the definition R_g = R_sg R_s; the paper's
        listing writes q(k-1) q_hat, which would be the object's own axes.
        """
        if estimate.angle_rad <= self.delta_rad:
            return None
        identity = np.array([1.0, 0.0, 0.0, 0.0])
        return so3.matrix_from_quat(so3.slerp(identity, estimate.quat_wxyz, self.eta))


def orient(
    station: Station,
    goal: DepthImage,
    estimator: Estimator,
    strategy: Strategy | None = None,
    pivot_m: Float[np.ndarray, "3"] | None = None,
    subscribers: Sequence[Callable[[Step], None]] = (),
) -> OrientResult:
    """Turn the object at the station until it looks like the goal (Algorithm 1 unless another strategy is given).

    ``pivot_m``: rotation centre in camera axes; None: the station's own. Subscribers are called with each step, after
    its move. Each estimate gets the earlier images as history. A failing station or estimator ends the loop with the
    record kept and the reason said; bad arguments raise ReorientError before anything moves.
    """
    if not isinstance(goal, DepthImage):
        raise ReorientError(f"goal is a {type(goal).__name__}: expected DepthImage(depth_m, camera)")
    for thing, members in ((station, ("capture", "rotate", "pivot_m")), (estimator, ("estimate",))):
        if isinstance(thing, type) or not all(hasattr(thing, member) for member in members):
            raise ReorientError(f"{thing!r} given: expected an object with {', '.join(members)}")
    strategy = strategy or Proportional()
    pivot_m = station.pivot_m if pivot_m is None else pivot_m
    check_pair(goal, goal, pivot_m)
    steps: list[Step] = []
    history: list[tuple[DepthImage, Float[np.ndarray, "3 3"]]] = []

    def ended(reason: str, converged: bool = False) -> OrientResult:
        return OrientResult(tuple(steps), converged, reason)

    for index in range(strategy.max_steps):
        try:
            image = station.capture()
        except Exception as error:  # a driver may raise anything; the record must survive it
            return ended(f"the station failed to capture: {_said(error)}")
        try:
            estimate = estimator.estimate(image, goal, pivot_m, history)
        except Exception as error:
            return ended(f"the estimator failed: {_said(error)}")
        R_step = strategy.move(estimate)
        R_executed = None
        failure = ""
        if R_step is not None:
            try:
                R_executed = _executed(station.rotate(R_step))
            except Exception as error:
                failure = f"the station failed to rotate: {_said(error)}"
        steps.append(Step(index, image, estimate, R_step, R_executed))
        if R_executed is not None:
            history = [(seen, R_executed @ R_now_then) for seen, R_now_then in [*history, (image, np.eye(3))]]
        for subscriber in subscribers:
            subscriber(steps[-1])
        if R_step is None:
            return ended(f"the predicted angle is {np.degrees(estimate.angle_rad):.2f} degrees", converged=True)
        if failure:
            return ended(failure)
    return ended(f"limit of {strategy.max_steps} images")


def _executed(R: object) -> Float[np.ndarray, "3 3"]:
    if not so3.is_rotation(np.asarray(R, float) if R is not None else np.empty(0)):
        raise StationError("rotate() returned no rotation: expected the (3, 3) matrix of what was really done")
    return np.asarray(R, float)


def _said(error: Exception) -> str:
    return str(error) if isinstance(error, ReorientError) else f"{type(error).__name__}: {error}"
