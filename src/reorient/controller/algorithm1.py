"""The paper's Algorithm 1."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.base import Decision, Reachable, Step, known_part, rotations_since
from reorient.errors import ReorientError
from reorient.imaging import DepthImage


@dataclass(frozen=True)
class Proportional:
    """The paper's Algorithm 1: turn the share eta of the predicted rotation until the prediction is small."""

    max_steps: int = 100
    """K, largest number of images."""
    eta: float = 0.2
    """Share of the predicted rotation to turn at once, in (0, 1]."""
    delta_rad: float = float(np.radians(0.5))
    """Done when the predicted angle is at most this."""
    patience: int = 0
    """How many failures in a row it bears; the paper's none."""
    takes_back: ClassVar[bool] = False
    memory: bool = True
    """Whether the estimator is given the earlier captures."""

    def __post_init__(self) -> None:
        if not (self.max_steps >= 1 and 0 < self.eta <= 1 and self.delta_rad >= 0 and self.patience >= 0):
            raise ReorientError(
                f"K={self.max_steps}, eta={self.eta}, delta={self.delta_rad}: expected K >= 1, 0 < eta <= 1, delta >= 0"
            )

    def recalled(self, steps: Sequence[Step]) -> list[tuple[DepthImage, Float[np.ndarray, "3 3"]]]:
        """All captures that are turned to now by known rotations, or none."""
        known = known_part(steps) if self.memory else []
        return [(step.image, R) for step, R in zip(known, rotations_since(known), strict=True)]

    def decide(self, steps: Sequence[Step], goal: DepthImage, reachable: Reachable) -> Decision:
        """Slerp from no rotation towards the prediction.

        The prediction is in camera axes, so it multiplies on the left, by the definition R_g = R_sg R_s; the paper's
        listing writes q(k-1) q_hat, which would be the object's own axes.
        """
        estimate = steps[-1].estimate
        said = f"the predicted angle is {np.degrees(estimate.angle_rad):.2f} degrees"
        if estimate.angle_rad <= self.delta_rad:
            return Decision(said, ends=True, converged=True, confidence=estimate.confidence)
        identity = np.array([1.0, 0.0, 0.0, 0.0])
        R_step = so3.matrix_from_quat(so3.slerp(identity, estimate.quat_wxyz, self.eta))
        return Decision(f"{said}: turns {self.eta:.0%} of it", R_step)
