"""What the paper's networks are compared with, beside the package's estimators: nothing, and the release's broken ICP.

Named ``reorient.reproducing.baselines:Nothing`` and so on wherever an estimator's name is asked for.
"""

from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from reorient.estimators.base import History, RotationEstimate, check_pair, with_evidence
from reorient.imaging import DepthImage
from reorient.registration import DepthView, evenly_spaced

MAX_POINTS = 1500


class Nothing:
    """Always "no rotation"."""

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``."""
        check_pair(current, goal, pivot_m)
        return _answer(current, goal, np.eye(3))


class ReleasedICP:
    """The ICP baseline as in the paper's public release, with its mistakes.

    Pixel offsets are divided by the image's width and again by the focal length, so that the cloud collapses to a line
    along the optical axis; and trimesh's ICP may mirror and scale. Where it does, the nearest rotation is the answer.
    """

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``."""
        check_pair(current, goal, pivot_m)
        registration: Any = trimesh.registration
        T, _, _ = registration.icp(_collapsed(current), _collapsed(goal), reflection=True, scale=True)
        left, _, right = np.linalg.svd(T[:3, :3])
        R = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
        return _answer(current, goal, R)


def _collapsed(image: DepthImage) -> Float[np.ndarray, "n 3"]:
    points: np.ndarray = image.points()
    points = points[evenly_spaced(len(points), MAX_POINTS)]
    points[:, :2] /= image.camera.width
    return points


def _answer(current: DepthImage, goal: DepthImage, R: Float[np.ndarray, "3 3"]) -> RotationEstimate:
    """With the translation that brings the centroids together."""
    t_m = goal.points().mean(axis=0) - R @ current.points().mean(axis=0)
    return with_evidence(DepthView(current), DepthView(goal), R, t_m)
