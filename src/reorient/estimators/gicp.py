"""Generalised ICP (small_gicp), coarse to fine, from several starts where one is not enough.

1. Align from "no rotation", coarse then fine. If the evidence is clear, that is the answer.
2. Else score a grid of rotations up to 80 degrees by their agreement (free space and silhouettes included). The
   distinct ones that could rival the first answer, and that answer, climb to better agreement by random steps: planes
   slide over each other unhindered, but not past an outline. Then align the best, and keep what agrees best.

All lengths scale with the object, so that a screw and a chair are treated alike.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import small_gicp
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators.base import History, RotationEstimate, check_pair
from reorient.imaging import DepthImage
from reorient.registration.evidence import Evidence, View, agreement, size_m, weigh

CLEAR_AGREEMENT = 0.7  # of the first alignment: no further starts
RIVAL_MARGIN = 0.6  # a start may agree less than the first answer by this much, and still win once aligned
STARTS = 8
FINALISTS = 3
LARGEST_PIVOT_SHIFT = 0.2  # of the object's size; a hypothesis that moves a known pivot farther is implausible
PIVOT_ERROR_M = 0.01  # what a known pivot is good to; where that is not small against the object it says nothing
FEWEST_POINTS = 11  # of a cloud at its resolution; small_gicp warns of fewer
# Neighbouring pixels share noise and small_gicp takes planes for a hundredth as uncertain as they are long: the factor
# from the inverse Hessian to the scatter observed with 1 mm noise; without noise it is pessimistic.
COVARIANCE_SCALE = 10.0

_GRID = so3.grid(3000)
_GRID = _GRID[so3.angle(_GRID) <= np.radians(80)]

ROUNDS, STEPS = 5, 24  # of the climb; every round's steps are shorter than the last's
_NUDGES = np.random.default_rng(0).standard_normal((2, STEPS, ROUNDS, 3)) * 0.65 ** np.arange(ROUNDS)[:, None]
_NUDGES[:, 0] = 0  # staying is a step too
_TURNS = so3.exp(0.15 * _NUDGES[0])
_SHIFTS = 0.03 * _NUDGES[1]  # in shares of the object's size


@dataclass(frozen=True)
class Stage:
    """One resolution, in shares of the object's size."""

    voxel: float
    gate: float
    """Largest distance of corresponding points."""
    iterations: int
    """At most: with noise, correspondences flicker for longer than they gain anything."""


COARSE, MIDDLE, FINE = Stage(0.032, 0.12, 20), Stage(0.018, 0.05, 12), Stage(0.009, 0.03, 8)
SEARCH_TOLERANCE, FINE_TOLERANCE = 0.04, 0.012  # depth difference that still fits, in shares of the object's size


class GICP:
    """The strongest geometric estimator up to 60 degrees, with or without a known pivot."""

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; the history is not used."""
        check_pair(current, goal, pivot_m)
        alignment = _Alignment(current, goal, pivot_m)
        best = alignment.refine(alignment.start(np.eye(3)), COARSE, FINE)
        if best.evidence.agreement < CLEAR_AGREEMENT:
            rivals = [alignment.refine(T, MIDDLE) for T in alignment.rivals(best)]
            rival = alignment.refine(max(rivals, key=alignment.plausibility).T, FINE)
            best = max(best, rival, key=alignment.plausibility)
        return RotationEstimate(best.T[:3, :3], best.T[:3, 3], best.evidence, covariance_rad2=best.covariance_rad2)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    T: Float[np.ndarray, "4 4"]
    evidence: Evidence
    covariance_rad2: Float[np.ndarray, "3 3"] | None


def _transform(R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


class _Alignment:
    """The clouds of one pair, prepared once for all starts."""

    def __init__(self, current: DepthImage, goal: DepthImage, pivot_m: Float[np.ndarray, "3"] | None) -> None:
        source, target = current.points(), goal.points()
        self._size_m = max(size_m(source), size_m(target))
        self._points = source, target
        self._clouds: dict[Stage, tuple[Any, Any, Any]] = {}
        self._views = View(current, 200), View(goal, 200)
        self._pivot_m = pivot_m if pivot_m is not None and 0.15 * self._size_m > PIVOT_ERROR_M else None
        if self._pivot_m is not None:
            self._turning = self._pivot_m, self._pivot_m
        else:  # guess where the object turns: behind the middle of what is seen
            behind = np.array([0.0, 0.0, 0.12 * self._size_m])
            self._turning = source.mean(axis=0) + behind, target.mean(axis=0) + behind

    def _prepared(self, stage: Stage) -> tuple[Any, Any, Any]:
        """Both clouds at one resolution, and the target's tree."""
        if stage in self._clouds:
            return self._clouds[stage]
        voxel_m = stage.voxel * self._size_m
        (source_cloud, _), cloud_and_tree = (small_gicp.preprocess_points(x, voxel_m, 10) for x in self._points)
        for name, cloud in (("current", source_cloud), ("goal", cloud_and_tree[0])):
            if cloud.size() < FEWEST_POINTS:
                raise ReorientError(
                    f"{name} image has {cloud.size()} distinct points at a resolution of {1000 * voxel_m:.1f} mm: "
                    f"expected at least {FEWEST_POINTS}; remove stray returns (--near, --far) or move the camera closer"
                )
        self._clouds[stage] = source_cloud, *cloud_and_tree
        return self._clouds[stage]

    def start(self, R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4 4"]:
        """The transform that turns about the turning point by R."""
        return _transform(R, self._turning[1] - R @ self._turning[0])

    def rivals(self, first: _Hypothesis) -> list[Float[np.ndarray, "4 4"]]:
        """The most promising other rotations of the grid, and the first answer, all at their best agreement nearby."""
        t = self._turning[1] - _GRID @ self._turning[0]
        scores = self._agreement(_GRID, t)
        floor = self._agreement(first.T[None, :3, :3], first.T[None, :3, 3])[0] - RIVAL_MARGIN
        far = so3.angle_difference(_GRID, first.T[:3, :3]) > np.radians(10)
        order = [i for i in np.argsort(-scores) if far[i] and scores[i] > floor]
        modes: list[int] = []
        while order and len(modes) < STARTS:
            modes.append(order[0])
            apart = so3.angle_difference(_GRID[order], _GRID[order[0]]) > np.radians(20)
            order = [i for i, is_apart in zip(order, apart, strict=True) if is_apart]
        return self._climbed(np.stack([first.T, *(self.start(_GRID[i]) for i in modes)]))

    def _climbed(self, T: Float[np.ndarray, "k 4 4"]) -> list[Float[np.ndarray, "4 4"]]:
        """The best ends of random local searches for agreement from some starts; every round drops the worst third."""
        pivot, R = self._turning[0], T[:, :3, :3]
        at = R @ pivot + T[:, :3, 3]  # where each puts the turning point
        for k in range(ROUNDS):
            tried = _TURNS[:, k] @ R[:, None]
            tried_at = at[:, None] + _SHIFTS[:, k] * self._size_m
            t = tried_at - tried @ pivot
            scores = self._agreement(tried.reshape(-1, 3, 3), t.reshape(-1, 3), 0.8**k).reshape(len(R), STEPS)
            kept = np.argsort(-scores.max(axis=1))[: max(FINALISTS, 2 * len(R) // 3)]
            step = scores[kept].argmax(axis=1)
            R, at = tried[kept, step], tried_at[kept, step]
        return [_transform(R[i], at[i] - R[i] @ pivot) for i in range(min(FINALISTS, len(R)))]

    def refine(self, T: Float[np.ndarray, "4 4"], *stages: Stage) -> _Hypothesis:
        """GICP from one start, at one resolution after the other."""
        iterations = 0
        for stage in stages:
            fine = self._align(stage, T)
            T = fine.T_target_source
            iterations += fine.iterations
        R = so3.matrix_from_quat(so3.quat_from_matrix(T[:3, :3]))  # small_gicp's products drift from SO(3)
        T = _transform(R, T[:3, 3])
        determined = bool(fine.num_inliers > 6 and np.linalg.cond(fine.H) < 1e12)
        evidence = weigh(
            *self._views,
            R,
            T[:3, 3],
            FINE_TOLERANCE * self._size_m,
            fine.converged and determined,
            iterations,
        )
        covariance = None
        if determined:  # small_gicp perturbs on the right, (rotation, translation): turn into the goal's camera axes
            spread = 2 * fine.error / (fine.num_inliers - 6)
            covariance = COVARIANCE_SCALE * spread * R @ np.linalg.inv(fine.H)[:3, :3] @ R.T
        return _Hypothesis(T, evidence, covariance)

    def _align(self, stage: Stage, T: Float[np.ndarray, "4 4"]) -> small_gicp.RegistrationResult:
        source, target, tree = self._prepared(stage)
        return small_gicp.align(
            target,
            source,
            tree,
            T,
            registration_type="GICP",
            max_correspondence_distance=stage.gate * self._size_m,
            max_iterations=stage.iterations,
            rotation_epsilon=1e-5 if stage is FINE else 1e-4,
            translation_epsilon=1e-5 * self._size_m,
        )

    def _agreement(
        self, R: Float[np.ndarray, "k 3 3"], t: Float[np.ndarray, "k 3"], share: float = 1.0
    ) -> Float[np.ndarray, " k"]:
        return agreement(*self._views, R, t, share * SEARCH_TOLERANCE * self._size_m)

    def plausibility(self, hypothesis: _Hypothesis) -> float:
        """Agreement, less what a hypothesis takes by moving a pivot that is known not to move."""
        score = hypothesis.evidence.agreement
        if self._pivot_m is not None:
            moved = hypothesis.T[:3, :3] @ self._pivot_m + hypothesis.T[:3, 3] - self._pivot_m
            score -= max(float(np.linalg.norm(moved)) / (LARGEST_PIVOT_SHIFT * self._size_m) - 1, 0)
        return score
