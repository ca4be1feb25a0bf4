"""Generalised ICP (small_gicp), coarse to fine, from several starts where one is not enough.

1. Align from "no rotation", coarse then fine. If its score is high, that is the answer.
2. Else score a grid of rotations up to 80 degrees (free space and silhouettes included). Those left after non-maximum
   suppression that could beat the first answer, and that answer, climb to a higher score by random steps: planes slide
   over each other unhindered, but not past an outline. Then align the best, and keep the one of the highest score.

All lengths are relative to the object diameter, so that a screw and a chair are treated alike.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import small_gicp
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.estimators.base import History, RotationEstimate, check_pair, with_evidence
from reorient.estimators.polish import FEWEST_POINTS
from reorient.imaging import DepthImage
from reorient.registration import DepthView, Hypotheses, measure_evidence, non_maximum_suppression, pivot_prior
from reorient.registration.evidence import score
from reorient.se3 import Transform

_GRID = so3.grid(3000)
_GRID = _GRID[so3.angle(_GRID) <= np.radians(80)]

ROUNDS, STEPS = 5, 24  # of the climb; every round's steps are shorter than the last's
_NUDGES = np.random.default_rng(0).standard_normal((2, STEPS, ROUNDS, 3)) * 0.65 ** np.arange(ROUNDS)[:, None]
_NUDGES[:, 0] = 0  # staying is a step, too
_ROTATIONS = so3.exp(0.15 * _NUDGES[0])
_SHIFTS = 0.03 * _NUDGES[1]  # relative to the object diameter


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the search for other starts; lengths relative to the object diameter."""

    enough: float = 0.7
    """Score of the first alignment that needs no further starts."""
    margin: float = 0.6
    """A start may have a score lower than the first answer's by this much, and still win once aligned."""
    starts: int = 8
    finalists: int = 3
    search_tolerance: float = 0.04
    """Depth difference of an inlier in the search."""
    tolerance: float = 0.012
    """Depth difference of an inlier in the choice among aligned hypotheses."""
    pivot_shift: float = 0.2
    """A hypothesis that moves a known pivot farther than this loses its score."""
    points: int = 200
    """Of each image."""
    covariance_scale: float = 10.0
    """From the inverse Hessian to the scatter observed with 1 mm noise: neighbouring pixels share noise, and small_gicp
    takes planes for a hundredth as uncertain as they are long. Without noise it is pessimistic."""


@dataclass(frozen=True)
class Stage:
    """One resolution, relative to the object diameter."""

    voxel: float
    gate: float
    """Largest distance of corresponding points."""
    iterations: int
    """At most: with noise, correspondences flicker for longer than they gain anything."""


COARSE, MIDDLE, FINE = Stage(0.032, 0.12, 20), Stage(0.018, 0.05, 12), Stage(0.009, 0.03, 8)


class GICP:
    """The strongest purely geometric estimator up to 60 degrees, with or without a known pivot."""

    def __init__(self, settings: Settings | None = None) -> None:
        self._settings = settings or Settings()

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; the history is not used. Raises ReorientError for a cloud of too few points."""
        check_pair(current, goal, pivot_m)
        return _Alignment(current, goal, pivot_m, self._settings).estimate()


@dataclass(frozen=True, eq=False)
class _Aligned:
    T: Transform
    score: float
    """Less the cost of moving a known pivot."""
    plain_score: float
    converged: bool
    iterations: int
    covariance_rad2: Float[np.ndarray, "3 3"] | None


class _Alignment:
    """The clouds of one pair, prepared once for all starts."""

    def __init__(
        self, current: DepthImage, goal: DepthImage, pivot_m: Float[np.ndarray, "3"] | None, settings: Settings
    ) -> None:
        self._settings = settings
        self._points = current.points(), goal.points()
        self._clouds: dict[Stage, tuple[Any, Any, Any]] = {}
        self._views = DepthView(current), DepthView(goal)
        self._prior = pivot_prior(*self._views, pivot_m)

    def estimate(self) -> RotationEstimate:
        best = self._align(self._start(np.eye(3)), COARSE, FINE)
        if best.plain_score < self._settings.enough:
            others = [self._align(T, MIDDLE) for T in self._other_starts(best)]
            other = self._align(max(others, key=lambda aligned: aligned.score).T, FINE)
            best = max(best, other, key=lambda aligned: aligned.score)
        return with_evidence(
            *self._views,
            best.T[:3, :3],
            best.T[:3, 3],
            converged=best.converged,
            iterations=best.iterations,
            covariance_rad2=best.covariance_rad2,
        )

    def _start(self, R: Float[np.ndarray, "3 3"]) -> Transform:
        """The transform that rotates about the rotation centre by R."""
        return se3.transform(R, self._prior.translations(R[None])[0])

    def _other_starts(self, first: _Aligned) -> list[Transform]:
        """The most promising other rotations of the grid, and the first answer, all at their best score nearby."""
        scores = self._score(_GRID, self._prior.translations(_GRID))
        floor = self._score(first.T[None, :3, :3], first.T[None, :3, 3])[0] - self._settings.margin
        far = so3.angle_difference(_GRID, first.T[:3, :3]) > np.radians(10)
        good = np.nonzero(far & (scores > floor))[0]
        modes = non_maximum_suppression(_GRID[good], scores[good], float(np.radians(20)), self._settings.starts)
        return self._climbed(np.stack([first.T, *(self._start(R) for R in _GRID[good[modes]])]))

    def _climbed(self, T: Float[np.ndarray, "k 4 4"]) -> list[Transform]:
        """The best ends of random local searches for the score from some starts; every round drops the worst third."""
        pivot, R, finalists = self._prior.current_m, T[:, :3, :3], self._settings.finalists
        at = R @ pivot + T[:, :3, 3]  # where each puts the rotation centre
        for k in range(ROUNDS):
            tried = _ROTATIONS[:, k] @ R[:, None]
            tried_at = at[:, None] + _SHIFTS[:, k] * self._prior.diameter_m
            t = tried_at - tried @ pivot
            scores = self._score(tried.reshape(-1, 3, 3), t.reshape(-1, 3), 0.8**k).reshape(len(R), STEPS)
            kept = np.argsort(-scores.max(axis=1))[: max(finalists, 2 * len(R) // 3)]
            step = scores[kept].argmax(axis=1)
            R, at = tried[kept, step], tried_at[kept, step]
        return [se3.transform(R[i], at[i] - R[i] @ pivot) for i in range(min(finalists, len(R)))]

    def _align(self, T: Transform, *stages: Stage) -> _Aligned:
        """GICP from one start, at one resolution after the other."""
        iterations = 0
        for stage in stages:
            fine = self._register(stage, T)
            T = fine.T_target_source
            iterations += fine.iterations
        R = so3.matrix_from_quat(so3.quat_from_matrix(T[:3, :3]))  # small_gicp's products drift from SO(3)
        T = se3.transform(R, T[:3, 3])
        determined = bool(fine.num_inliers > 6 and np.linalg.cond(fine.H) < 1e12)
        tolerance_m = self._settings.tolerance * self._prior.diameter_m
        score = measure_evidence(*self._views, R, T[:3, 3], tolerance_m, self._settings.points).score
        covariance = None
        if determined:  # small_gicp perturbs on the right, (rotation, translation): rotate to the goal's camera axes
            spread = 2 * fine.error / (fine.num_inliers - 6)
            covariance = self._settings.covariance_scale * spread * R @ np.linalg.inv(fine.H)[:3, :3] @ R.T
        converged = bool(fine.converged) and determined
        return _Aligned(T, score - self._pivot_cost(T), score, converged, iterations, covariance)

    def _pivot_cost(self, T: Transform) -> float:
        """Score that a hypothesis loses by moving a pivot that is known not to move."""
        if not self._prior.known:
            return 0.0
        moved_m = se3.apply(T, self._prior.current_m) - self._prior.goal_m
        return max(float(np.linalg.norm(moved_m)) / (self._settings.pivot_shift * self._prior.diameter_m) - 1, 0)

    def _register(self, stage: Stage, T: Transform) -> small_gicp.RegistrationResult:
        source, target, tree = self._prepared(stage)
        return small_gicp.align(
            target,
            source,
            tree,
            T,
            registration_type="GICP",
            max_correspondence_distance=stage.gate * self._prior.diameter_m,
            max_iterations=stage.iterations,
            rotation_epsilon=1e-5 if stage is FINE else 1e-4,
            translation_epsilon=1e-5 * self._prior.diameter_m,
        )

    def _prepared(self, stage: Stage) -> tuple[Any, Any, Any]:
        """Both clouds at one resolution, and the target's tree."""
        if stage in self._clouds:
            return self._clouds[stage]
        voxel_m = stage.voxel * self._prior.diameter_m
        (source_cloud, _), cloud_and_tree = (small_gicp.preprocess_points(x, voxel_m, 10) for x in self._points)
        for name, cloud in (("current", source_cloud), ("goal", cloud_and_tree[0])):
            if cloud.size() < FEWEST_POINTS:
                raise ReorientError(
                    f"{name} image has {cloud.size()} distinct points at a resolution of {1000 * voxel_m:.1f} mm: "
                    f"expected at least {FEWEST_POINTS}; remove stray returns (--near, --far) or move the camera closer"
                )
        self._clouds[stage] = source_cloud, *cloud_and_tree
        return self._clouds[stage]

    def _score(
        self, R: Float[np.ndarray, "k 3 3"], t: Float[np.ndarray, "k 3"], share: float = 1.0
    ) -> Float[np.ndarray, " k"]:
        tolerance_m = share * self._settings.search_tolerance * self._prior.diameter_m
        return score(*self._views, Hypotheses(R, t), tolerance_m, self._settings.points)
