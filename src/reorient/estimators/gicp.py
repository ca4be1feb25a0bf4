"""Generalised ICP (small_gicp), coarse to fine, from several starts where one is not enough.

1. Align from "no rotation", coarse then fine. If the evidence is clear, that is the answer.
2. Else score a grid of rotations up to 80 degrees by their agreement (free space and silhouettes included), align the
   distinct ones that could rival it coarsely, the best of them finely, and keep what agrees best.

All lengths scale with the object, so that a screw and a chair are treated alike.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import small_gicp
from jaxtyping import Float

from reorient import so3
from reorient.depth import DepthImage
from reorient.errors import ReorientError
from reorient.estimators.base import History, RotationEstimate, check_pair
from reorient.estimators.evidence import Evidence, View, agreement, size_m, weigh

CLEAR_AGREEMENT = 0.8  # of the first alignment: no further starts
RIVAL_MARGIN = 0.4  # a start may agree less than the first answer by this much, and still win once aligned
STARTS = 8
FINALISTS = 4
LARGEST_PIVOT_SHIFT = 0.2  # of the object's size; a hypothesis that moves a known pivot farther is implausible
PIVOT_ERROR_M = 0.01  # what a known pivot is good to; where that is not small against the object it says nothing
FEWEST_POINTS = 10  # of a cloud at its resolution
# Neighbouring pixels share noise and small_gicp takes planes for a hundredth as uncertain as they are long: the factor
# from the inverse Hessian to the scatter observed with 1 mm noise; without noise it is pessimistic.
COVARIANCE_SCALE = 10.0

_GRID = so3.grid(3000)
_GRID = _GRID[so3.angle(_GRID) <= np.radians(80)]


@dataclass(frozen=True)
class Stage:
    """One resolution, in shares of the object's size."""

    voxel: float
    gate: float
    """Largest distance of corresponding points."""


COARSE, FINE = Stage(0.032, 0.12), Stage(0.009, 0.03)
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
        hypotheses = [alignment.refine(alignment.start(np.eye(3)))]
        if hypotheses[0].evidence.agreement < CLEAR_AGREEMENT:
            hypotheses += [alignment.refine(T) for T in alignment.rivals(hypotheses[0])]
        best = max(hypotheses, key=alignment.plausibility)
        return RotationEstimate(best.T[:3, :3], best.T[:3, 3], best.evidence, covariance_rad2=best.covariance_rad2)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    T: Float[np.ndarray, "4 4"]
    evidence: Evidence
    covariance_rad2: Float[np.ndarray, "3 3"] | None


class _Alignment:
    """The clouds of one pair, prepared once for all starts."""

    def __init__(self, current: DepthImage, goal: DepthImage, pivot_m: Float[np.ndarray, "3"] | None) -> None:
        source, target = current.points(), goal.points()
        self._size_m = max(size_m(source), size_m(target))
        self._clouds = {stage: self._prepared(stage, source, target) for stage in (COARSE, FINE)}
        self._views = View(current, 200), View(goal, 200)
        self._pivot_m = pivot_m if pivot_m is not None and 0.15 * self._size_m > PIVOT_ERROR_M else None
        if self._pivot_m is not None:
            self._turning = self._pivot_m, self._pivot_m
        else:  # guess where the object turns: behind the middle of what is seen
            behind = np.array([0.0, 0.0, 0.12 * self._size_m])
            self._turning = source.mean(axis=0) + behind, target.mean(axis=0) + behind

    def _prepared(self, stage: Stage, source: np.ndarray, target: np.ndarray) -> tuple[Any, Any, Any]:
        """Both clouds at one resolution, and the target's tree."""
        voxel_m = stage.voxel * self._size_m
        (source_cloud, _), cloud_and_tree = (small_gicp.preprocess_points(x, voxel_m, 10) for x in (source, target))
        for name, cloud in (("current", source_cloud), ("goal", cloud_and_tree[0])):
            if cloud.size() < FEWEST_POINTS:
                raise ReorientError(
                    f"{name} image has {cloud.size()} distinct points at a resolution of {1000 * voxel_m:.1f} mm: "
                    f"expected at least {FEWEST_POINTS}; remove stray returns (--near, --far) or move the camera closer"
                )
        return source_cloud, *cloud_and_tree

    def start(self, R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4 4"]:
        """The transform that turns about the turning point by R."""
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = self._turning[1] - R @ self._turning[0]
        return T

    def rivals(self, first: _Hypothesis) -> list[Float[np.ndarray, "4 4"]]:
        """The most promising other rotations of the grid, coarsely aligned."""
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
        aligned = [self._align(COARSE, self.start(_GRID[i])).T_target_source for i in modes]
        if not aligned:
            return []
        stacked = np.stack(aligned)
        best = np.argsort(-self._agreement(stacked[:, :3, :3], stacked[:, :3, 3]))[:FINALISTS]
        return [aligned[i] for i in best]

    def refine(self, T: Float[np.ndarray, "4 4"]) -> _Hypothesis:
        """GICP from one start, coarse then fine."""
        coarse = self._align(COARSE, T)
        fine = self._align(FINE, coarse.T_target_source)
        T = fine.T_target_source
        R = so3.matrix_from_quat(so3.quat_from_matrix(T[:3, :3]))  # small_gicp's products drift from SO(3)
        T = np.block([[R, T[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]])
        determined = bool(fine.num_inliers > 6 and np.linalg.cond(fine.H) < 1e12)
        evidence = weigh(
            *self._views,
            R,
            T[:3, 3],
            FINE_TOLERANCE * self._size_m,
            fine.converged and determined,
            coarse.iterations + fine.iterations,
        )
        covariance = None
        if determined:  # small_gicp perturbs on the right, (rotation, translation): turn into the goal's camera axes
            spread = 2 * fine.error / (fine.num_inliers - 6)
            covariance = COVARIANCE_SCALE * spread * R @ np.linalg.inv(fine.H)[:3, :3] @ R.T
        return _Hypothesis(T, evidence, covariance)

    def _align(self, stage: Stage, T: Float[np.ndarray, "4 4"]) -> small_gicp.RegistrationResult:
        source, target, tree = self._clouds[stage]
        return small_gicp.align(
            target,
            source,
            tree,
            T,
            registration_type="GICP",
            max_correspondence_distance=stage.gate * self._size_m,
            max_iterations=30,
            rotation_epsilon=1e-4 if stage is COARSE else 1e-5,
            translation_epsilon=1e-5 * self._size_m,
        )

    def _agreement(self, R: Float[np.ndarray, "k 3 3"], t: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        return agreement(*self._views, R, t, SEARCH_TOLERANCE * self._size_m)

    def plausibility(self, hypothesis: _Hypothesis) -> float:
        """Agreement, less what a hypothesis takes by moving a pivot that is known not to move."""
        score = hypothesis.evidence.agreement
        if self._pivot_m is not None:
            moved = hypothesis.T[:3, :3] @ self._pivot_m + hypothesis.T[:3, 3] - self._pivot_m
            score -= max(float(np.linalg.norm(moved)) / (LARGEST_PIVOT_SHIFT * self._size_m) - 1, 0)
        return score
