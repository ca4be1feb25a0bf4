"""What an estimator is and what it answers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.depth import DepthImage, is_scene, require_isolated
from reorient.errors import ReorientError
from reorient.estimators.evidence import Evidence

History = Sequence[tuple[DepthImage, Float[np.ndarray, "3 3"]]]
"""Earlier captures of the same held object, each with R_now_then."""


@dataclass(frozen=True, eq=False)
class RotationEstimate:
    """How the object must turn: p_goal = R_goal_current p_current + t_goal_current_m, camera axes."""

    R_goal_current: Float[np.ndarray, "3 3"]
    """R_goal = R_goal_current @ R_current (left multiplication)."""
    t_goal_current_m: Float[np.ndarray, "3"]
    evidence: Evidence
    """What the two images say about the answer."""
    confidence: float | None = None
    """Calibrated probability that the symmetry-aware error is below 5 degrees; None where not calibrated."""
    alternatives: tuple[tuple[Float[np.ndarray, "3 3"], float], ...] = ()
    """Other rotations that fit, each with its probability."""
    covariance_rad2: Float[np.ndarray, "3 3"] | None = None
    """Of the rotation vector of a left perturbation, given that the answer is near the truth; or None."""

    @property
    def quat_wxyz(self) -> Float[np.ndarray, "4"]:
        """The rotation as a unit quaternion with q_r >= 0."""
        return so3.quat_from_matrix(self.R_goal_current)

    @property
    def angle_rad(self) -> float:
        """How far the object still has to turn."""
        return float(so3.angle(self.R_goal_current))


@runtime_checkable
class Estimator(Protocol):
    """Anything with this method; see ``reorient.load_estimator`` for those in the package."""

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """The rotation from current to goal. ``pivot_m``: rotation centre in camera axes, good to about 1 cm, if known.

        Raises ReorientError for images that cannot be compared.
        """
        ...


def check_pair(
    current: DepthImage, goal: DepthImage, pivot_m: Float[np.ndarray, "3"] | None = None, fewest: int = 20
) -> None:
    """Raise ReorientError for what no estimator can use: too few returns, no isolated object, a bad pivot."""
    for name, image in (("current", current), ("goal", goal)):
        if not isinstance(image, DepthImage):
            raise ReorientError(f"{name} is a {type(image).__name__}: expected DepthImage(depth_m, camera)")
        if (returns := np.count_nonzero(image.depth_m)) < fewest:
            raise ReorientError(f"{name} image has {returns} returns: expected at least {fewest} on the object")
        if is_scene(image):  # a tight crop of an object may fill its frame
            require_isolated(image)
    if pivot_m is not None:
        try:
            pivot = np.asarray(pivot_m, float)
        except (TypeError, ValueError):
            pivot = np.empty(0)
        if pivot.shape != (3,) or not np.all(np.isfinite(pivot)) or pivot[2] <= 0:
            raise ReorientError(f"pivot {pivot_m}: expected three finite metres in camera axes, in front of the camera")
