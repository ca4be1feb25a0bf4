"""The last steps of an estimate: Gauss-Newton on all returns, generalised ICP, and the covariance of the answer."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import small_gicp
from jaxtyping import Float

from reorient import se3, so3
from reorient.estimators.calibration import load_calibration
from reorient.registration import EVIDENCE_POINTS, DepthView, Hypotheses, PosedView, Problem, normal_equations, refine

WHOLE = np.eye(6)
FEWEST_POINTS = 11  # of a cloud at its resolution; small_gicp warns of fewer; not tuned


@dataclass(frozen=True, kw_only=True)
class Polish:
    """Settings; lengths relative to the object diameter.

    The gain of the polish is in docs/ablations.md. The trials of the fields without a reference are not recorded.
    """

    tolerances: tuple[float, ...] = (0.008, 0.006, 0.004, 0.003)
    """Of the Gauss-Newton steps, unless noise forbids. Four or two of them: docs/tuning.md."""
    points: int = 4000
    """Of each image."""
    noise_factor: float = 4.0
    """The tolerances are at least this many residuals of the inliers."""
    inlier_tolerance: float = 0.012
    """Depth difference of the inliers that measure the noise. Against 0.015: docs/tuning.md."""
    quiet: float = 0.0045
    """Residual of depth with next to no noise; also the tolerance of the scores that choose the answer. What exact
    depth leaves (7d3071c); 1.5 residuals, if larger, chose no better."""
    voxel: float = 0.009
    """Of ICP's clouds. Finer voxels, and one size for both: docs/tuning.md."""
    noisy_voxel: float = 0.02
    """The same for noisy depth (docs/tuning.md); also the largest distance of ICP's correspondences."""
    least_noise: float = 0.001
    """Residual of exact depth, which comes from interpolation between pixels."""
    spread_weight: float = 1.6
    """Of the differences between the motions that the polish tried, in the covariance, beside the curvature at the
    noise that the images show. Generated objects (docs/tuning.md, "Covariance")."""
    isotropic_weight: float = 1.0
    """Of the squared length of these differences, in every direction. Same objects: without it 68% ellipsoids hold as
    often as they state where 95% ones hold in 82 to 91%."""
    expected_factor: float = 1.4
    """From the curvature alone to the covariance at the goal pose, before there are differences: 24 generated objects.
    """


POLISH = Polish()


@dataclass(frozen=True, eq=False)
class Polished:
    """A polished hypothesis."""

    hypothesis: Hypotheses
    """One motion."""
    iterations: int
    """Of ICP; 0 where the clouds are too small for it."""
    tried: Hypotheses | None = None
    """The motions after the Gauss-Newton steps and after ICP, of which it may be one."""


def polish(problem: Problem, answer: Hypotheses, *others: Problem) -> Polished:
    """The best of the answer, Gauss-Newton steps from it on all returns, and ICP from there, by score.

    Either step may drag an answer away where the views hardly overlap. ``others``: problems of the same views whose
    steps are tried, too.
    """
    noise = _residual(problem, answer)
    tolerances = [max(x, POLISH.noise_factor * noise) for x in POLISH.tolerances]
    stepped = [refine(each, answer, tolerances, POLISH.points) for each in (problem, *others)]
    registered = register(problem, stepped[0], POLISH.voxel if noise < POLISH.quiet else POLISH.noisy_voxel)
    tried = [answer, *stepped, *([] if registered is None else [registered.hypothesis])]
    score = [problem.score(x, POLISH.quiet, POLISH.points)[0] for x in tried]
    ends = stepped[0] if registered is None else stepped[0].and_also(registered.hypothesis)
    return Polished(tried[int(np.argmax(score))], 0 if registered is None else registered.iterations, ends)


def register(
    problem: Problem, answer: Hypotheses, voxel: float, farthest: float = POLISH.noisy_voxel
) -> Polished | None:
    """Generalised ICP from an answer; voxels and farthest correspondences relative to the object diameter. None for
    clouds too small for it."""
    diameter_m = problem.diameter_m
    current_m = problem.current.points_m.astype(float)
    clouds = (current_m, np.concatenate([x.points_m for x in problem.goal_views]))
    (source, _), (target, tree) = (small_gicp.preprocess_points(x, voxel * diameter_m, 10) for x in clouds)
    if min(source.size(), target.size()) < FEWEST_POINTS:
        return None
    result = small_gicp.align(
        target,
        source,
        tree,
        se3.transform(answer.R[0], answer.t_m[0]),
        registration_type="GICP",
        max_correspondence_distance=farthest * diameter_m,
        max_iterations=20,
        rotation_epsilon=1e-5,
        translation_epsilon=1e-5 * diameter_m,
    )
    T = result.T_target_source
    R = so3.matrix_from_quat(so3.quat_from_matrix(T[:3, :3]))  # small_gicp's products drift from SO(3)
    return Polished(Hypotheses(R[None], T[None, :3, 3]), int(result.iterations))


def uncertainty(
    problem: Problem, answer: Polished, projection: Float[np.ndarray, "6 6"] = WHOLE
) -> tuple[Float[np.ndarray, "6 6"], bool]:
    """Covariance of a left perturbation, rotation vector (rad) and shift (m), if the answer is near the truth; and
    whether the answer has converged: one more Gauss-Newton step would rotate it by less than its standard error.

    The inverse of the curvature at the answer, at the noise that the images show, does not know of errors that
    neighbouring pixels share, of edges and of occluders. Where these matter, Gauss-Newton steps and ICP end apart: the
    squares of their differences are added. Scale and floor of the sum were calibrated on generated objects with exact
    intrinsics (``reorient verifier calibrate``), so that 68 and 95% of the true rotations are within the ellipsoids.
    ``projection``: of motions about the goal's centre, in half diameters, that takes out what is no error.
    """
    motion = answer.hypothesis
    residual = max(_residual(problem, motion), POLISH.least_noise)
    H, g = normal_equations(problem, motion, POLISH.noise_factor * residual, POLISH.points)
    inverse = np.linalg.inv(H[0] + 1e-9 * np.eye(6))
    goal_noise2 = np.mean([x.view.noise_m**2 for x in problem.goal_views])
    noise2 = (problem.current.noise_m**2 + goal_noise2) / problem.diameter_m**2
    apart = _differences(problem, motion, motion if answer.tried is None else answer.tried)
    calibration = load_calibration()
    covariance = calibration.scale * (inverse * noise2 / residual**2 + _spread(apart @ projection.T))
    covariance += calibration.floor_rad**2 * np.eye(6)
    covariance = projection @ covariance @ projection.T
    to_origin = np.eye(6)  # the steps rotate about the goal's centre, and shift relative to half the diameter
    to_origin[3:, 3:] *= problem.diameter_m / 2
    to_origin[3:, :3] = np.cross(problem.prior.goal_m, np.eye(3)).T
    covariance = to_origin @ covariance @ to_origin.T
    step_rad = float(np.linalg.norm((inverse @ g[0])[:3]))
    return covariance, step_rad <= float(np.sqrt(np.trace(covariance[:3, :3])))


def expected_covariance(current: DepthView, goal: Sequence[PosedView]) -> Float[np.ndarray, "3 3"]:
    """Covariance (rad^2) of the rotation vector that ``uncertainty`` is likely to give at the goal pose: that of the
    primary goal view against those of its side, with the noise of a current one."""
    problem = Problem.of((PosedView.first(goal[0].view),), tuple(goal), None).nearest_views(np.eye(3))
    noise2 = (current.noise_m**2 + np.mean([x.view.noise_m**2 for x in problem.goal_views])) / problem.diameter_m**2
    residual = max(float(np.sqrt(noise2)), POLISH.quiet)
    still = Hypotheses(np.eye(3)[None], np.zeros((1, 3)))
    H, _ = normal_equations(problem, still, POLISH.noise_factor * residual, POLISH.points)
    inverse = np.linalg.inv(H[0] + 1e-9 * np.eye(6))[:3, :3]
    calibration = load_calibration()
    shape = inverse * noise2 / residual**2
    return np.asarray(calibration.scale * POLISH.expected_factor * shape + calibration.floor_rad**2 * np.eye(3))


def _spread(apart: Float[np.ndarray, "k 6"]) -> Float[np.ndarray, "6 6"]:
    """The sum of the squares of differences, and their squared lengths in every direction; rotation, then shift."""
    lengths2 = np.repeat([np.sum(apart[:, :3] ** 2), np.sum(apart[:, 3:] ** 2)], 3)
    return np.asarray(POLISH.spread_weight * apart.T @ apart + POLISH.isotropic_weight * np.diag(lengths2))


def _differences(problem: Problem, answer: Hypotheses, others: Hypotheses) -> Float[np.ndarray, "k 6"]:
    """The perturbations that lead from an answer to others: rotation vectors about the goal's centre, and shifts
    relative to half the object diameter."""
    center_m = problem.prior.goal_m
    R = others.R @ answer.R[0].T
    shift_m = others.t_m - center_m - R @ (answer.t_m[0] - center_m)
    return np.concatenate([so3.log(R), shift_m / (problem.diameter_m / 2)], axis=1)


def _residual(problem: Problem, answer: Hypotheses) -> float:
    """Root mean square depth difference of the inliers, relative to the object diameter; 0 where there is none."""
    tolerance_m = POLISH.inlier_tolerance * problem.diameter_m
    evidence = problem.evidence(answer.R[0], answer.t_m[0], tolerance_m, EVIDENCE_POINTS)
    return float(np.nan_to_num(evidence.residual_m)) / problem.diameter_m
