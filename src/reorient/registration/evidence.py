"""Scores of hypotheses, and the evidence for one: each image's points warped into the other's view, depths compared."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Float

from reorient.registration.depth_view import DepthView, Warped
from reorient.registration.hypotheses import Hypotheses

INLIER_TOLERANCE = 0.015  # depth difference of an inlier, relative to the object diameter
EVIDENCE_POINTS = 400  # of each image
_AT_ONCE = 30_000  # points moved in one batch, which fits the cache; changes speed alone, not tuned


@dataclass(frozen=True)
class Evidence:
    """How one motion fits both images: shares of the points of both, and residuals.

    The four shares of points (``Warped`` defines them) sum to one.
    """

    inlier_ratio: float
    """Share of points within the tolerance of the other surface."""
    free_space_violation: float
    """Share in front of the other surface, which the other camera saw."""
    silhouette_violation: float
    """Share where the other camera saw nothing of the object."""
    occluded: float
    """Share behind the other surface."""
    residual_m: float
    """Root mean square depth difference of the inliers; NaN if there is none."""
    converged: bool | None = None
    """Whether the registration met its own stopping rule; None for an estimator without one."""
    iterations: int | None = None
    """Iterations of the registration that led to the answer; None for an estimator without any."""

    @property
    def covisible_inlier_ratio(self) -> float:
        """Inliers among the points that are not occluded; NaN if all are."""
        visible = 1 - self.occluded
        return self.inlier_ratio / visible if visible > 0 else float("nan")

    @property
    def score(self) -> float:
        """Inliers less violations, in [-1, 1]."""
        return self.inlier_ratio - self.free_space_violation - self.silhouette_violation


def inlier_tolerance_m(current: DepthView, goal: DepthView) -> float:
    """The depth difference of an inlier, metres, for the evidence of a pair."""
    return INLIER_TOLERANCE * max(current.diameter_m, goal.diameter_m)


def measure_evidence(
    current: DepthView,
    goal: DepthView,
    R_goal_current: Float[np.ndarray, "3 3"],
    t_goal_current_m: Float[np.ndarray, "3"],
    tolerance_m: float,
    points: int = EVIDENCE_POINTS,
) -> Evidence:
    """The evidence for one motion, from at most so many points of each image."""
    return evidence_of(warp_both(current, goal, R_goal_current, t_goal_current_m, points), tolerance_m)


def evidence_of(warped: Sequence[Warped], tolerance_m: float) -> Evidence:
    """The evidence of warped points, each of which counts alike."""
    difference_m = np.concatenate([each.difference_m for each in warped])
    inlier = np.concatenate([each.inlier(tolerance_m) for each in warped])

    def share(of: str, *tolerance: float) -> float:
        return float(np.concatenate([getattr(each, of)(*tolerance) for each in warped]).mean())

    return Evidence(
        inlier_ratio=float(inlier.mean()),
        free_space_violation=share("free_space_violation", tolerance_m),
        silhouette_violation=share("silhouette_violation"),
        occluded=share("occluded", tolerance_m),
        residual_m=float(np.sqrt(np.mean(difference_m[inlier] ** 2))) if inlier.any() else float("nan"),
    )


def warp_both(
    current: DepthView,
    goal: DepthView,
    R_goal_current: Float[np.ndarray, "3 3"],
    t_goal_current_m: Float[np.ndarray, "3"],
    points: int,
) -> tuple[Warped, Warped]:
    """The points of current in the goal's view, and those of the goal in current's."""
    forward = R_goal_current @ current.sample(points) + t_goal_current_m[:, None]
    backward = R_goal_current.T @ (goal.sample(points) - t_goal_current_m[:, None])
    return goal.warp(forward), current.warp(backward)


def score(
    current: DepthView, goal: DepthView, hypotheses: Hypotheses, tolerance_m: float, points: int
) -> Float[np.ndarray, " k"]:
    """Mean over both directions of inlier less violation shares, of many hypotheses at once; equals ``Evidence.score``
    where both images give equally many points (``points`` at most)."""
    forward, backward = current.sample(points), goal.sample(points)
    total = np.zeros(len(hypotheses), np.float32)
    for batch in batches(len(total), max(forward.shape[1], backward.shape[1])):
        motion = hypotheses[batch].single()
        for view, x in ((goal, motion.move(forward)), (current, motion.inverse.move(backward))):
            warped = view.warp(x)
            # per direction, inliers count +1/2 and violations -1/2, which is +1/2 - 1; a matrix product counts fastest
            half = np.full(x.shape[2], 0.5 / x.shape[2], np.float32)
            total[batch] += (warped.difference_m <= tolerance_m).astype(np.float32) @ half  # inliers and violations
            total[batch] -= warped.violation(tolerance_m).astype(np.float32) @ (2 * half)  # violations alone
    return total


def batches(k: int, points: int) -> Iterator[slice]:
    """Slices of k hypotheses that each move so many points, about equally long."""
    step = max(ceil(k / max(ceil(k * points / _AT_ONCE), 1)), 1)
    return (slice(begin, begin + step) for begin in range(0, k, step))
