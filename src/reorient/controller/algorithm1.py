"""The paper's Algorithm 1."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from reorient import so3
from reorient.controller.base import Decision, Reachable, Step, degrees
from reorient.errors import ReorientError
from reorient.imaging import DepthImage, Goal


@dataclass(frozen=True, eq=False)
class LatestStep:
    """The belief of Algorithm 1, which has no memory."""

    step: Step | None = None

    def updated(self, step: Step) -> "LatestStep":
        """The given step replaces the one before."""
        return LatestStep(step)


@dataclass(frozen=True, kw_only=True)
class Algorithm1:
    """The paper's Algorithm 1: rotate by the share eta of the estimated rotation until the estimate is small.

    The defaults are those of the paper's experiments in simulation ("Controller Experiments on Simulated Objects").
    Raises ReorientError for values out of range.
    """

    max_images: int = 100
    """K, largest number of images."""
    eta: float = 0.2
    """Share of the estimated rotation to rotate by, in (0, 1]."""
    delta_rad: float = float(np.radians(0.5))
    """Converged once the estimated angle is at most this, radians."""
    patience: int = 0
    """Number of consecutive errors that the loop survives; none in the paper."""
    undoes_moves: ClassVar[bool] = False
    history: bool = True
    """Whether the estimator receives earlier images."""

    def __post_init__(self) -> None:
        if not (self.max_images >= 1 and 0 < self.eta <= 1 and self.delta_rad >= 0 and self.patience >= 0):
            raise ReorientError(
                f"K={self.max_images}, eta={self.eta}, delta={self.delta_rad}, patience={self.patience}: expected "
                "K >= 1, 0 < eta <= 1, delta >= 0, patience >= 0"
            )

    def start(self, goal: DepthImage | Goal) -> LatestStep:
        """No step yet; the estimator has the goal."""
        return LatestStep()

    def decide(self, belief: LatestStep, reachable: Reachable) -> Decision:
        """Slerp from no rotation towards the estimate.

        The estimate is in camera axes, so it multiplies on the left, by the definition R_g = R_sg R_s; the paper's
        listing has q(k-1) q_hat, which would be the object's own axes.
        """
        assert belief.step is not None
        estimate = belief.step.estimate
        message = f"estimate {degrees(estimate.angle_rad, 2)}"
        if estimate.angle_rad <= self.delta_rad:
            return Decision(f"{message}: converged", status="converged", confidence=estimate.confidence)
        identity = np.array([1.0, 0.0, 0.0, 0.0])
        R_step = so3.matrix_from_quat(so3.slerp(identity, estimate.quat_wxyz, self.eta))
        return Decision(f"{message}: rotating by {self.eta:.0%} of it", R_step)
