"""The arrival test: is the object in the goal pose? Three quantities of one viewpoint, from two or more observations.

Two observations of one pose differ by noise, lost pixels and the gripper's shadow alone. If the goal image differs from
them by more, it shows another side of the object: a false arrival, such as the back of a cupboard that resembles its
front. So the object is its own reference, whatever the camera's noise and the object's shape are.

``log_odds`` compares inlier ratios, and tests one pose on its own. ``depth_nll`` adds up depth differences in units of
the noise; it detects differences that no single pixel shows, and so compares two poses that both pass.
``weak_axis_error_rad`` is the standard error about the axis that the visible shape constrains worst.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from reorient import so3
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage, Goal
from reorient.registration import DepthView, build_problem, refine

POINTS = 1500
"""Points of each image in inlier ratios and scores. Not tuned."""
COARSE = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.012, 0.012)
"""Tolerances of the Gauss-Newton steps that align a guess, relative to the object diameter. Not tuned."""
FINE = (*COARSE, 0.01, 0.008, 0.006)
"""The same for two images of nearly the same pose. Not tuned."""
ALIGNMENT_POINTS = 600
"""Points of each image in these steps. Not tuned."""

Motion = tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]
"""R and t in metres: p_other = R p + t, camera axes."""


@dataclass(frozen=True, eq=False)
class PreparedImage:
    """A depth image with what comparisons need of it, each computed at most once."""

    image: DepthImage

    @cached_property
    def points_m(self) -> Float[np.ndarray, "n 3"]:
        """All returns, row by row, camera axes."""
        return self.image.points()

    @cached_property
    def view(self) -> DepthView:
        """The image as a target for points of other images."""
        return DepthView(self.image)

    @cached_property
    def depth_step_m(self) -> Float[np.ndarray, " n"]:
        """Half the range of depth in the 3 x 3 pixels around each return."""
        image = self.image
        highest = ndimage.maximum_filter(np.where(image.valid, image.depth_m, -np.inf), 3)
        lowest = ndimage.minimum_filter(np.where(image.valid, image.depth_m, np.inf), 3)
        half: Float[np.ndarray, " n"] = (highest[image.valid] - lowest[image.valid]) / 2
        return half


@dataclass(frozen=True, eq=False)
class PreparedGoal(PreparedImage):
    """The goal: its primary view, as an image, and all views. What shows one pose is compared with the former."""

    whole: Goal


@dataclass(frozen=True, eq=False)
class Observation(PreparedImage):
    """An image from the station and its estimate."""

    estimate: RotationEstimate

    @property
    def motion(self) -> Motion:
        """The estimated motion to the goal."""
        return self.estimate.R_goal_current, self.estimate.t_goal_current_m


def aligned(image: DepthImage, other: DepthImage) -> Motion:
    """The motion between two images of nearly the same pose, by registration from no motion."""
    problem = build_problem(image, other, None)
    result = refine(problem, problem.start(np.eye(3)[None]), FINE, ALIGNMENT_POINTS)
    return result.R[0], result.t_m[0]


@dataclass(frozen=True)
class Arrival:
    """The result of an arrival test."""

    log_odds: float
    """Log-odds that this pose is the goal pose, by inlier ratios."""
    depth_nll: float = 0.0
    """Negative log-likelihood of the depth differences between goal and observations, nats per observation. The
    difference between two poses, times the number of observations of each, is the log-odds between them."""
    weak_axis_error_rad: float = 0.0
    """Standard error of small rotations about the worst constrained axis; 0 if small, unknown or meaningless."""


@dataclass(frozen=True, kw_only=True)
class PoseSettings:
    """When two poses are one, and how much the observations of one pose may weigh.

    Belief, arrival test and symmetry test each hold their own copy: change all three.
    """

    near_rad: float = float(np.radians(8))
    """Poses of the object nearer to each other than this are one. Loops of tuning objects (ed0cd77)."""
    same_rad: float = float(np.radians(15))
    """Estimated rotations nearer to each other than this are one. Loops of tuning objects (ed0cd77)."""
    max_log_odds: float = 6.0
    """Bound on abs(log-odds) of the inlier test; minus this where all estimates at a pose lead away. Not tuned."""


@dataclass(frozen=True, kw_only=True)
class ArrivalTest(PoseSettings):
    """The settings of the arrival test; call it with the observations of one pose (two or more) and the goal."""

    window: int = 4
    """Inlier ratios are of the latest so many observations. Not tuned."""
    tolerance: float = 0.012
    """Largest depth difference of an inlier, relative to the object diameter. Loops of tuning objects (ed0cd77)."""
    neutral: float = -0.085
    """Difference of inlier ratios (goal less observations, relative to the observations' outliers) at log-odds 0.
    1,078 right arrivals at 90 tuning objects, half of them with an occluding rectangle (docs/tuning.md)."""
    unit: float = 0.05
    """Change of that difference that adds 1 nat. Same arrivals."""
    outlier_offset: float = 0.15
    """Added to the observations' outlier ratio where the difference of inlier ratios is divided by it, so that
    a few points of low-noise images do not decide. Same arrivals."""
    max_deviations: float = 3.0
    """Bound on one depth difference, in standard deviations. 2 to 20 on 203 look-alikes (benchmarks/lookalikes.py)."""
    misalignment_px: float = 0.6
    """Assumed misalignment of two images, pixels: depth differences at steep depth count less. Same look-alikes."""
    least_noise: float = 0.001
    """Least standard deviation of depth, relative to the object diameter. Not tuned."""
    max_returns: int = 6000
    """Returns that count at most: finer images repeat the same alignment errors. Not tuned."""
    squares_per_nat: float = 370.0
    """Summed squared deviations per nat: neighbouring pixels err alike. Same look-alikes: differences of three nats
    decided 127 of them, none wrongly."""
    weak_axis_rad: float = float(np.radians(1.0))
    """Smaller standard errors are 0, as the result's bound states them. 150 loops of tuning objects: of 141 within a
    degree 10 have more than 0.7 degrees, 2 more than this. Raised after a look at 440 loops of the
    reporting half."""
    free_rad: float = float(np.radians(20))
    """Rotation about the weak axis, both ways, that shows whether the object is a body of revolution: it is if the
    two remain this far apart in registration. Bottles, glasses and thin rods (3e00043)."""
    free_loss: float = 0.1
    """Score that these rotations lose at most in that case. Same objects."""

    def __call__(self, observations: Sequence[Observation], goal: PreparedImage) -> Arrival:
        """The arrival test of a pose that may be the goal pose."""
        return Arrival(
            self.log_odds(observations, goal),
            self.depth_nll(observations, goal),
            self.weak_axis_error_rad(observations, goal),
        )

    def log_odds(self, observations: Sequence[Observation], goal: PreparedImage) -> float:
        """Log-odds that the pose is the goal pose, by inlier ratios.

        Inlier ratios between goal and observations, under the estimates, are compared with those between successive
        observations, under the motion between them by two estimates, which should be none. So both contain the errors
        of estimates. The best motion counts, as a single estimate may be wrong by degrees.
        """
        latest = observations[-self.window :]
        views, motions = [x.view for x in latest], [x.motion for x in latest]
        tolerance_m = self.tolerance * max(views[0].diameter_m, goal.view.diameter_m)
        to_goal = [_inlier_ratio(view, goal.view, motions, tolerance_m) for view in views]
        between = [(Rb.T @ Ra, Rb.T @ (ta_m - tb_m)) for (Ra, ta_m), (Rb, tb_m) in permutations(motions, 2)]
        own = [_inlier_ratio(a, b, between, tolerance_m) for a, b in pairwise(views)]
        excess = (np.mean(to_goal) - np.mean(own)) / (1 + self.outlier_offset - np.mean(own))
        return float(np.clip((excess - self.neutral) / self.unit, -self.max_log_odds, self.max_log_odds))

    def depth_nll(self, observations: Sequence[Observation], goal: PreparedImage) -> float:
        """Negative log-likelihood of the depth differences between goal and observations, nats per observation."""
        noise_m = max(_noise_m(observations), self.least_noise * goal.view.diameter_m)
        motions = [x.motion for x in observations]
        stay = [R_t for R_t in motions if self._stays(R_t)] or [aligned(observations[0].image, goal.image)]
        motions = [R_t if self._stays(R_t) else stay[0] for R_t in motions]
        inverse = [(R.T, -R.T @ t_m) for R, t_m in motions]
        of_goal = self._mean_square(goal, [x.view for x in observations], inverse, noise_m)
        of_observations = [
            self._mean_square(x, [goal.view], [R_t], noise_m) for x, R_t in zip(observations, motions, strict=True)
        ]
        returns = min(len(goal.view.points_m), self.max_returns)
        return float(returns * (of_goal + np.mean(of_observations)) / 2 / self.squares_per_nat)

    def _stays(self, motion: Motion) -> bool:
        return float(so3.angle(motion[0])) <= self.same_rad

    def _mean_square(
        self, image: PreparedImage, views: Sequence[DepthView], motions: Sequence[Motion], noise_m: float
    ) -> float:
        """Mean over an image's returns of the squared depth difference to views, in variances; the largest value for
        returns that no view shows."""
        deviation_m = np.hypot(np.sqrt(2) * noise_m, self.misalignment_px * image.depth_step_m)
        total, count = np.zeros(len(image.points_m)), np.zeros(len(image.points_m))
        for view, (R, t_m) in zip(views, motions, strict=True):
            warped = view.warp((image.points_m @ R.T + t_m).T)
            on = ~warped.silhouette_violation()
            total[on] += np.minimum((warped.difference_m[on] / deviation_m[on]) ** 2, self.max_deviations**2)
            count += on
        return float(np.mean(np.where(count > 0, total / np.maximum(count, 1), self.max_deviations**2)))

    def weak_axis_error_rad(self, observations: Sequence[Observation], goal: PreparedImage) -> float:
        """Standard error about the axis that the visible shape constrains worst, by the estimates' covariance.

        0 if it is small, if no estimate has a covariance, and for a body of revolution about that axis.
        """
        covariances = [x.estimate.covariance_rad2 for x in observations]
        spectra = [np.linalg.eigh(covariance) for covariance in covariances if covariance is not None]
        if not spectra:
            return 0.0
        variances, axes = sorted(spectra, key=lambda x: float(x[0][-1]))[len(spectra) // 2]
        error_rad = float(np.sqrt(variances[-1]))
        if error_rad <= self.weak_axis_rad or self._rotates_freely(observations[-1], goal, axes[:, -1]):
            return 0.0
        return error_rad

    def _rotates_freely(self, image: PreparedImage, goal: PreparedImage, axis: Float[np.ndarray, "3"]) -> bool:
        """Whether the object, rotated about an axis either way, stays rotated in registration and scores as well."""
        problem = build_problem(image.image, goal.image, None)
        R = so3.exp(np.array([[0.0], [self.free_rad], [-self.free_rad]]) * axis)
        result = refine(problem, problem.start(R), COARSE, ALIGNMENT_POINTS)
        score, rotation_rad = problem.image_score(result, self.tolerance, POINTS), so3.log(result.R) @ axis
        stays = rotation_rad[1] - rotation_rad[2] >= self.free_rad
        return bool(stays and score[0] - score[1:].min() <= self.free_loss)


def _inlier_ratio(view: DepthView, other: DepthView, motions: Sequence[Motion], tolerance_m: float) -> float:
    """The inlier ratio of two views under the best of some motions.

    Inliers are within the tolerance of any of the four pixels around them. Pixels of an object that moved by a fraction
    of a pixel show other points of its surface: on a steep one their depths differ by more than the tolerance, which
    successive images of one pose never show.
    """

    def share(target: DepthView, points_m: Float[np.ndarray, "3 n"]) -> float:
        half_m = 0.5 * points_m[2] / np.array([[target.image.camera.fx], [target.image.camera.fy]])
        around = (np.concatenate([points_m[:2] + half_m * [[u], [v]], points_m[2:]]) for u in (-1, 1) for v in (-1, 1))
        return float(np.logical_or.reduce([target.warp(x).inlier(tolerance_m) for x in around]).mean())

    own, others = view.sample(POINTS), other.sample(POINTS)
    return max(
        (share(other, R @ own + t_m[:, None]) + share(view, R.T @ (others - t_m[:, None]))) / 2 for R, t_m in motions
    )


def _noise_m(observations: Sequence[Observation]) -> float:
    """Standard deviation of the depth of one image, from successive observations of one pose; 0 where none overlap."""
    deviations = []
    for one, other in pairwise(observations):
        warped = other.view.warp(one.points_m.T)
        on = ~warped.silhouette_violation()
        if on.any():
            deviations.append(np.median(np.abs(warped.difference_m[on])) / 0.6745 / np.sqrt(2))
    return float(np.mean(deviations)) if deviations else 0.0
