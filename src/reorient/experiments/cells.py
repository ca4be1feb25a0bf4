"""The cells of a row of an evaluation: what an estimator answers, what it costs, and how it compares with the truth."""

import time
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.estimators.base import Estimator, RotationEstimate, as_estimate, for_any_goal
from reorient.imaging import DepthImage
from reorient.imaging.goal import Goal, as_goal
from reorient.plugins import USER_ERRORS, in_words
from reorient.registration import aligned_goal
from reorient.world.pairs import Pair
from reorient.world.symmetry import SymmetryGroup, nearest_equivalent, symmetric_error

COLUMNS = [
    "object",
    "pair",
    "world",
    "noise_mm",
    "low_deg",
    "high_deg",
    "estimator",
    "angle_deg",
    "error_deg",
    "error_sym_deg",
    "qw",
    "qx",
    "qy",
    "qz",
    "seconds",
    "score",
    "inlier_ratio",
    "free_space_violation",
    "silhouette_violation",
    "occluded",
    "residual_mm",
    "converged",
    "iterations",
    "confidence",
    "message",
    "overlap",
    "goal_views",
    "set_size",
    "set_covers",
    "distance2",
]
"""Of a row; rows of earlier versions lack the last ones. ``set_size``: number of rotations in the 95% confidence set, 0
where there is none, empty for an estimator without sets; ``set_covers``: whether one of them is within 5 degrees of the
truth, up to symmetry; ``distance2``: squared Mahalanobis distance of the answer from the truth, by its covariance."""
RIGHT_DEG = 5.0
SET_LEVEL = 0.95


def estimate_cells(
    estimator: Estimator,
    pair: Pair,
    group: SymmetryGroup,
    pivot_m: Float[np.ndarray, "3"] | None,
    goal: Goal | None = None,
) -> dict[str, Any]:
    """Cells of one row. ``goal``: None for that of one view. Its views are aligned once: not in ``seconds``."""
    goal = Goal(pair.goal) if goal is None else goal
    aligned_goal(goal, pivot_m)
    estimate, cells = measured(estimator, pair.current, goal, pivot_m)
    R = np.eye(3) if estimate is None else estimate.R_goal_current
    return cells | answer_cells(R, pair, group) | ({} if estimate is None else trust_cells(estimate, pair, group))


def measured(
    estimator: Estimator, current: DepthImage, goal: DepthImage | Goal, pivot_m: Float[np.ndarray, "3"] | None = None
) -> tuple[RotationEstimate | None, dict[str, str]]:
    """The estimate of an estimator, and the cells of a row that need no truth.

    None for one that raises an error, which counts as "no rotation"; ``message`` is the error.
    """
    begin = time.process_time()
    try:
        answer = for_any_goal(estimator).estimate(current, goal, pivot_m)
        estimate = as_estimate(answer, current, as_goal(goal).image)
    except USER_ERRORS as error:
        return None, {"seconds": f"{time.process_time() - begin:.5f}", "message": in_words(error)}
    evidence = estimate.evidence
    names = ("score", "inlier_ratio", "free_space_violation", "silhouette_violation", "occluded")
    return estimate, {name: f"{getattr(evidence, name):.4f}" for name in names} | {
        "residual_mm": f"{1000 * evidence.residual_m:.4f}",
        "converged": "" if evidence.converged is None else str(int(evidence.converged)),
        "iterations": "" if evidence.iterations is None else str(evidence.iterations),
        "confidence": "" if estimate.confidence is None else f"{estimate.confidence:.4f}",
        "seconds": f"{time.process_time() - begin:.5f}",
        "message": "",
    }


def answer_cells(R: Float[np.ndarray, "3 3"], pair: Pair, group: SymmetryGroup) -> dict[str, str]:
    """The cells of a row that an answer and the truth give: the errors, and the answer itself."""
    return {
        "error_deg": f"{np.degrees(so3.angle_difference(R, pair.R_goal_current)):.5f}",
        "error_sym_deg": f"{np.degrees(symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object)):.5f}",
    } | {f"q{part}": f"{x:.9f}" for part, x in zip("wxyz", so3.quat_from_matrix(R), strict=True)}


def trust_cells(estimate: RotationEstimate, pair: Pair, group: SymmetryGroup) -> dict[str, str]:
    """The cells of a row that compare confidence set and covariance with the truth; none for an estimator without."""
    true = pair.R_goal_current, pair.R_camera_object
    cells = {}
    if estimate.candidates:
        among = estimate.confidence_set(SET_LEVEL) or []
        covers = any(np.degrees(symmetric_error(group, R, *true)) < RIGHT_DEG for R, _ in among)
        cells = {"set_size": str(len(among)), "set_covers": str(int(covers))}
    nearest = nearest_equivalent(group, estimate.R_goal_current, *true)
    if estimate.covariance_rad2 is not None and nearest is not None:
        rotvec = so3.log(nearest @ estimate.R_goal_current.T)
        distance2 = float(rotvec @ np.linalg.pinv(estimate.covariance_rad2) @ rotvec)
        cells["distance2"] = f"{distance2:.4f}"
    return cells
