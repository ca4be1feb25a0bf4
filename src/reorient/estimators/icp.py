"""The paper's baseline: trimesh's ICP on correctly projected point clouds, reflection and scale off.

The paper's release shrinks the cloud to a line and lets ICP mirror and scale it; `reorient reproduce non-symmetric`
measures the effect.
"""

from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from reorient.estimators.base import History, RotationEstimate, check_pair, with_evidence
from reorient.imaging import DepthImage
from reorient.registration import DepthView, evenly_spaced


class ICP:
    """Point-to-point ICP from "no rotation", the centroids removed ("Non-Symmetric Object Dataset Experiments")."""

    def __init__(self, max_points: int = 1500, max_iterations: int = 100, threshold: float = 1e-10) -> None:
        self._max_points = max_points
        self._max_iterations = max_iterations
        self._threshold = threshold

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; neither the pivot nor the history is used."""
        check_pair(current, goal, pivot_m)
        source, target = self._cloud(current), self._cloud(goal)
        source_center, target_center = source.mean(axis=0), target.mean(axis=0)
        T, cost = self._align(source - source_center, target - target_center, np.eye(4), self._max_iterations)
        # trimesh does not return whether it met the threshold: one more iteration shows that
        _, next_cost = self._align(source - source_center, target - target_center, T, 1)
        R = T[:3, :3]
        t = T[:3, 3] + target_center - R @ source_center
        views = DepthView(current), DepthView(goal)
        return with_evidence(*views, R, t, converged=abs(cost - next_cost) < self._threshold)

    def _align(
        self, source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "m 3"], T: np.ndarray, iterations: int
    ) -> tuple[Float[np.ndarray, "4 4"], float]:
        """The transform and the cost (mean squared distance, m^2)."""
        icp: Any = trimesh.registration.icp
        T, _, cost = icp(
            source,
            target,
            initial=T,
            threshold=self._threshold,
            max_iterations=iterations,
            reflection=False,
            scale=False,
        )
        return T, float(cost)

    def _cloud(self, image: DepthImage) -> Float[np.ndarray, "n 3"]:
        points = image.points()
        return np.asarray(points[evenly_spaced(len(points), self._max_points)])
