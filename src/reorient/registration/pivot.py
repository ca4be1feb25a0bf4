"""The prior of a pair: the scale of the object, and the point about which it rotates."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.registration.depth_view import DepthView

PIVOT_ERROR_M = 0.007  # standard deviation of a known pivot along each axis (it is uniform within 1 cm)
USELESS_BELOW_M = 0.01 / 0.15  # diameter of an object against which an error of 1 cm is not small
SLACK = 0.01  # relative to the object diameter: how far a motion may miss an exact pivot
BEHIND = 0.12  # relative to the object diameter: the unknown centre lies this far behind the middle of the returns


@dataclass(frozen=True, eq=False)
class PivotPrior:
    """Scale and rotation centre that all hypotheses of a pair share.

    A motion takes ``current_m`` (current's camera axes) near ``goal_m`` (the goal's).
    """

    diameter_m: float
    """Diameter of the object, as far as it is visible."""
    current_m: Float[np.ndarray, "3"]
    goal_m: Float[np.ndarray, "3"]
    known: bool
    """Whether the two are one known pivot, which a motion must leave in place; else both are guesses."""

    def translations(self, R: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3"]:
        """The translations (metres) that take the one centre to the other."""
        return np.asarray(self.goal_m - R @ self.current_m)

    def information(
        self, R: Float[np.ndarray, "k 3 3"], t_m: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, "k 3 3"], Float[np.ndarray, "k 3"]]:
        """Information (inverse covariance, 1/m^2) about how far each motion moves the known pivot, and how far it does.

        A pivot wrong by d makes the motion appear to move it by (I - R) d: not at all along the axis of the rotation.
        """
        away = np.eye(3) - R
        covariance = PIVOT_ERROR_M**2 * away @ np.swapaxes(away, 1, 2) + (SLACK * self.diameter_m) ** 2 * np.eye(3)
        return np.linalg.inv(covariance), R @ self.current_m + t_m - self.goal_m

    def error_m(self, R: Float[np.ndarray, "3 3"], t_m: Float[np.ndarray, "3"]) -> float:
        """The least distance of the known pivot from one that a motion would leave in place; inf for no rotation."""
        moved_m = float(np.linalg.norm(R @ self.current_m + t_m - self.goal_m))
        return moved_m / float(np.maximum(2 * np.sin(so3.angle(R) / 2), 1e-9))

    def mahalanobis2(self, R: Float[np.ndarray, "k 3 3"], t_m: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Squared Mahalanobis distance of each motion from leaving the pivot in place; 0 where none is known."""
        if not self.known:
            return np.zeros(len(R))
        information, moved_m = self.information(R, t_m)
        return np.asarray(np.einsum("ki,kij,kj->k", moved_m, information, moved_m))


def pivot_prior(
    current: DepthView, goal: DepthView, pivot_m: Float[np.ndarray, "3"] | None, diameter_m: float | None = None
) -> PivotPrior:
    """The prior of a pair, with a known pivot (camera axes) where that is of use, else with guesses.

    ``diameter_m``: of the object; None: as far as these two show it.
    """
    diameter_m = max(current.diameter_m, goal.diameter_m) if diameter_m is None else diameter_m
    if pivot_m is not None and diameter_m > USELESS_BELOW_M:
        pivot = np.asarray(pivot_m, float)
        return PivotPrior(diameter_m, pivot, pivot, True)
    behind = np.array([0.0, 0.0, BEHIND * diameter_m])
    return PivotPrior(diameter_m, current.points_m.mean(axis=0) + behind, goal.points_m.mean(axis=0) + behind, False)
