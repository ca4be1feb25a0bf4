"""Gauss-Newton on depth and silhouettes both ways, for many hypotheses at once.

For a hypothesis, the points of each image are moved into the other's view. A point on the object is drawn onto the
surface's plane there: less the farther it is, and hardly if it lies behind, where it may be occluded. A free-space
violation is pushed back and a silhouette violation is pushed in, from any distance but with bounded force. All
hypotheses take the step together, in float32, and their 6 x 6 systems are solved in one call.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.registration.depth_view import DepthView
from reorient.registration.evidence import batches
from reorient.registration.hypotheses import Hypotheses
from reorient.registration.problem import Problem, ViewPair


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the residuals and of a step; lengths relative to the object diameter.

    Of the trials that chose them only one is recorded: Gauss-Newton against a random search (docs/tuning.md,
    "Refinement and speed").
    """

    free_space: float = 0.25
    """Of a free-space violation, beside 1 for an inlier."""
    silhouette: float = 0.5
    """Of a silhouette violation."""
    images: float = 60.0
    """What all points of an image count beside the prior: neighbours share their errors."""
    damping: float = 0.02
    """Share of the diagonal added to it."""
    longest_step: float = 0.25
    """Largest rotation (rad), and largest shift (relative to half the object diameter), of one step."""


WEIGHTS = Weights()


def refine(
    problem: Problem, hypotheses: Hypotheses, tolerances: Sequence[float], points: int, rotate: bool = True
) -> Hypotheses:
    """One Gauss-Newton step for each tolerance (relative to the object diameter), on so many points of each image.

    ``rotate``: False keeps the rotations.
    """
    for tolerance in tolerances:
        H, g = normal_equations(problem, hypotheses, tolerance, points)
        if not rotate:
            H[:, :3], H[:, :, :3], g[:, :3] = 0, 0, 0
        hypotheses = stepped(problem, hypotheses, H, g)
    return hypotheses


def stepped(
    problem: Problem, hypotheses: Hypotheses, H: Float[np.ndarray, "k 6 6"], g: Float[np.ndarray, "k 6"]
) -> Hypotheses:
    """The hypotheses after the damped and limited step that normal equations ask for."""
    diagonal = np.einsum("kii->ki", H)
    damping = WEIGHTS.damping * diagonal + 1e-3 * diagonal.mean(axis=1, keepdims=True) + 1e-12
    step = -np.linalg.solve(H + damping[:, :, None] * np.eye(6), g[:, :, None])[:, :, 0]
    rotvec, shift = (
        part * np.minimum(1, WEIGHTS.longest_step / np.maximum(np.linalg.norm(part, axis=1, keepdims=True), 1e-12))
        for part in (step[:, :3], step[:, 3:])
    )
    return hypotheses.perturbed(problem.prior.goal_m, so3.exp(rotvec), shift * (problem.diameter_m / 2))


def normal_equations(
    problem: Problem, hypotheses: Hypotheses, tolerance: float, points: int
) -> tuple[Float[np.ndarray, "k 6 6"], Float[np.ndarray, "k 6"]]:
    """H and g of the robust squares and the prior, for a perturbation on the left.

    Its parameters are a rotation about the goal's centre (rad) and a shift (relative to half the object diameter).
    """
    prior, tolerance_m = problem.prior, tolerance * problem.diameter_m
    total = np.zeros((len(hypotheses), 7, 7))
    shared = problem.share(points)
    for pair in problem.pairs(hypotheses):
        goal = pair.goal
        center_m = (prior.goal_m - goal.t_first_view_m) @ goal.R_first_view
        to_view = np.eye(7)  # a perturbation in the axes of the primary view, in those of another one
        to_view[:3, :3] = to_view[3:6, 3:6] = goal.R_first_view.T
        for batch in batches(len(hypotheses), 2 * shared):
            moments = _moments(pair, pair.motions[batch], center_m, prior.diameter_m, tolerance_m, shared)
            total[batch] += to_view.T @ moments @ to_view
    total *= WEIGHTS.images / len(problem.views_now) / tolerance_m**2
    H, g = total[:, :6, :6].copy(), total[:, :6, 6].copy()
    if prior.known:
        information, moved_m = prior.information(hypotheses.R, hypotheses.t_m)
        half = problem.diameter_m / 2
        H[:, 3:, 3:] += information * half**2
        g[:, 3:] += (information @ moved_m[:, :, None])[:, :, 0] * half
    return H, g


def _moments(
    pair: ViewPair,
    hypotheses: Hypotheses,
    center_m: Float[np.ndarray, "3"],
    diameter_m: float,
    tolerance_m: float,
    points: int,
) -> Float[np.ndarray, "k 7 7"]:
    """Weighted products of the Jacobian's columns and the residual, averaged over the points of each image and summed
    over both images of a pair, for some motions between them.

    Rows of ``J``: 0-2 the rotation, 3-5 the shift, 6 the residual. So the product holds H and, in its last column, g.
    """
    motion, now, goal = hypotheses.single(), pair.now.view, pair.goal.view
    source, target = now.sample(points), goal.sample(points)
    n, m = source.shape[1], target.shape[1]
    forward, backward = motion.move(source), motion.inverse.move(target)
    J = np.empty((len(motion), 7, n + m), np.float32)
    weight = np.empty((len(motion), n + m), np.float32)
    J[:, 6, :n], weight[:, :n], J[:, 3:6, :n] = _residuals(goal, forward, tolerance_m)
    J[:, 6, n:], weight[:, n:], normal = _residuals(now, backward, tolerance_m)
    J[:, 3:6, n:] = -(motion.R @ normal)  # moving the goal's point back is moving the plane forward
    lever = np.concatenate([forward, np.broadcast_to(target, (len(motion), 3, m))], axis=2)
    lever -= center_m.astype(np.float32)[:, None]
    x, y, z = np.moveaxis(lever, 1, 0)
    nx, ny, nz = J[:, 3], J[:, 4], J[:, 5]
    J[:, 0], J[:, 1], J[:, 2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
    J[:, 3:6] *= np.float32(diameter_m / 2)
    weight[:, :n] /= n
    weight[:, n:] /= m
    return (J * weight[:, None]) @ np.swapaxes(J, 1, 2)


def _residuals(
    view: DepthView, x: Float[np.ndarray, "k 3 n"], tolerance_m: float
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"], Float[np.ndarray, "k 3 n"]]:
    """Distances of moved points from the planes they fall on, their weights, and the planes' normals."""
    warped = view.warp(x)
    nx, ny, nz, offset_m = view.planes(warped.pixel)
    residual = nx * x[:, 0]
    residual += ny * x[:, 1]
    residual += nz * x[:, 2]
    residual -= offset_m
    square = (residual / tolerance_m) ** 2
    bounded = 1 / (1 + square)  # Geman and McClure's weight is its square; its root bounds the force, as Huber's does
    occluded = 1 / (1 + (np.maximum(warped.difference_m, 0) / tolerance_m) ** 2)  # half, a tolerance behind
    violation = np.where(
        warped.silhouette_violation(), np.float32(WEIGHTS.silhouette), np.float32(WEIGHTS.free_space)
    ) * np.sqrt(bounded)
    inlier = bounded**2 * occluded
    weight: np.ndarray = np.where(warped.violation(tolerance_m), violation, inlier)
    return residual, weight, np.stack([nx, ny, nz], axis=1)
