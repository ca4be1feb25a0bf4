"""The paper's baseline: trimesh's iterative closest point, on correct clouds, reflection and scale off.

The paper's release shrinks the cloud to a line and lets ICP mirror and scale it; `reorient reproduce non-symmetric`
measures what that costs.
"""

import numpy as np
import trimesh
from jaxtyping import Float

from reorient.estimators.base import History, RotationEstimate, check_pair, weighed
from reorient.imaging import DepthImage


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
        T, _, _ = trimesh.registration.icp(
            source - source_center,
            target - target_center,
            threshold=self._threshold,
            max_iterations=self._max_iterations,
            reflection=False,
            scale=False,
        )
        R = T[:3, :3]
        t = T[:3, 3] + target_center - R @ source_center
        return weighed(current, goal, R, t)

    def _cloud(self, image: DepthImage) -> Float[np.ndarray, "n 3"]:
        points = image.points()
        return points[np.linspace(0, len(points) - 1, min(len(points), self._max_points)).astype(int)]
