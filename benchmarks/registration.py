"""Global registration by others, as estimators: a proposal each, then GICP (small_gicp) as ``gicp`` refines its own.

All lengths are relative to the object diameter, as for the package's own estimators.
"""

from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Protocol

import numpy as np
import small_gicp
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators.base import History, RotationEstimate, check_pair, with_evidence
from reorient.estimators.gicp import COARSE, FINE, MIDDLE, Settings, Stage
from reorient.estimators.polish import FEWEST_POINTS
from reorient.imaging import DepthImage
from reorient.registration import DepthView, Hypotheses
from reorient.registration.evidence import score

TOLERANCE = Settings().tolerance  # of the score, as of ``gicp``
POINTS = 4000  # of each image, for the score
Points = Float[np.ndarray, "_ 3"]
Motions = Float[np.ndarray, "k 4 4"]
"""T_goal_current, camera axes."""


class Proposal(Protocol):
    """Motions that may take one cloud to the other."""

    def __call__(self, current: Points, goal: Points, diameter_m: float) -> Motions:
        """From the points of the two images, metres, camera axes; ``diameter_m``: of the object."""
        ...


def optional(module: str) -> Any:
    """A module that may be missing. Raises ReorientError, saying how to get it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ReorientError(
            f"{module} does not import ({error}): expected `pip install 'reorient[peers]'`, and for open3d libusb-1.0 "
            "and libGL of the system"
        ) from error


def _open3d() -> Any:
    """open3d, drawing the same random numbers from here on, and silent."""
    open3d = optional("open3d")
    open3d.utility.random.seed(0)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


@dataclass(frozen=True)
class Starts:
    """GICP from rotations spread over SO(3), the centroids of both clouds on each other."""

    count: int = 120
    behind: float = 0.12
    """Distance behind that centroid where the object's own is assumed."""

    def __call__(self, current: Points, goal: Points, diameter_m: float) -> Motions:
        """All starts."""
        back = np.array([0.0, 0.0, self.behind * diameter_m])
        R = so3.grid(self.count)
        T = np.tile(np.eye(4), (len(R), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = R, goal.mean(axis=0) + back - R @ (current.mean(axis=0) + back)
        return T


@dataclass(frozen=True)
class Kiss:
    """KISS-Matcher (Lim et al., ICRA 2025): FasterPFH, pruning by a graph, graduated non-convexity."""

    voxel: float = 0.02
    """Relative to the object diameter."""
    normal_gain: float = 3.0
    """Radius of the normals, in voxels."""
    feature_gain: float = 5.0
    """Radius of the features, in voxels."""
    noise_gain: float = 1.0
    """Noise bound of the pruning, in voxels; the solver's is three quarters of it."""

    def __call__(self, current: Points, goal: Points, diameter_m: float) -> Motions:
        """One motion."""
        kiss = optional("kiss_matcher")
        unit = diameter_m * self.voxel  # lengths in voxels: it is made for scenes of metres
        config = kiss.KISSMatcherConfig(
            1.0,
            normal_r_gain=self.normal_gain,
            fpfh_r_gain=self.feature_gain,
            robin_noise_bound_gain=self.noise_gain,
            solver_noise_bound_gain=0.75 * self.noise_gain,
            enable_noise_bound_clamping=False,
        )
        found = kiss.KISSMatcher(config).estimate(
            list((current / unit).astype(np.float32)), list((goal / unit).astype(np.float32))
        )
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = found.rotation, np.ravel(found.translation) * unit
        return T[None]


@dataclass(frozen=True)
class Features:
    """Points and FPFH features of a cloud as open3d makes them."""

    voxel: float = 0.03
    normal_gain: float = 2.0
    """Radius of the normals, in voxels."""
    feature_gain: float = 8.0
    """Radius of the features, in voxels."""

    def of(self, points: Points, diameter_m: float) -> tuple[Any, Any]:
        """The cloud at the voxel's resolution, normals towards the camera, and its features."""
        open3d = _open3d()
        voxel_m = self.voxel * diameter_m
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)).voxel_down_sample(voxel_m)
        near = open3d.geometry.KDTreeSearchParamHybrid
        cloud.estimate_normals(near(self.normal_gain * voxel_m, 30))
        cloud.orient_normals_towards_camera_location(np.zeros(3))
        features = open3d.pipelines.registration.compute_fpfh_feature(cloud, near(self.feature_gain * voxel_m, 100))
        return cloud, features


@dataclass(frozen=True)
class Ransac:
    """open3d's RANSAC on FPFH correspondences."""

    features: Features = field(default_factory=Features)
    distance_gain: float = 1.0
    """Largest distance of an inlier, in voxels."""
    mutual: bool = False
    """Only pairs that are each other's nearest."""
    iterations: int = 100_000

    def __call__(self, current: Points, goal: Points, diameter_m: float) -> Motions:
        """One motion; the same for the same points."""
        open3d = _open3d()
        registration = open3d.pipelines.registration
        (source, of_source), (target, of_target) = (self.features.of(x, diameter_m) for x in (current, goal))
        distance_m = self.distance_gain * self.features.voxel * diameter_m
        found = registration.registration_ransac_based_on_feature_matching(
            source,
            target,
            of_source,
            of_target,
            self.mutual,
            distance_m,
            registration.TransformationEstimationPointToPoint(False),
            3,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                registration.CorrespondenceCheckerBasedOnDistance(distance_m),
            ],
            registration.RANSACConvergenceCriteria(self.iterations, 0.999),
        )
        return np.asarray(found.transformation)[None].copy()


@dataclass(frozen=True)
class Fast:
    """Fast Global Registration (Zhou et al., ECCV 2016) on FPFH correspondences, by open3d."""

    features: Features = field(default_factory=lambda: Features(0.02, feature_gain=5.0))
    alike: float = 0.9
    """How nearly a triple of correspondences must have sides of the same lengths in both clouds."""

    def __call__(self, current: Points, goal: Points, diameter_m: float) -> Motions:
        """One motion; the same for the same points."""
        open3d = _open3d()
        registration = open3d.pipelines.registration
        (source, of_source), (target, of_target) = (self.features.of(x, diameter_m) for x in (current, goal))
        found = registration.registration_fgr_based_on_feature_matching(
            source,
            target,
            of_source,
            of_target,
            registration.FastGlobalRegistrationOption(tuple_scale=self.alike),
        )
        return np.asarray(found.transformation)[None].copy()


@dataclass(frozen=True)
class Peer:
    """A proposal, GICP from all of its motions, and the one that is best."""

    propose: Proposal
    best_by: str = "score"
    """What is best of several: the score (free space and silhouettes count, too), or GICP's number of inliers."""
    coarse: bool = False
    """Whether a coarse alignment comes before the middle and the fine one: for proposals far from the truth."""

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; neither the pivot nor the history is used."""
        check_pair(current, goal, pivot_m)
        source, target = current.points(), goal.points()
        views = DepthView(current), DepthView(goal)
        diameter_m = max(view.diameter_m for view in views)
        motions = self.propose(source, target, diameter_m)
        if not np.all(np.isfinite(motions)):
            raise ReorientError("the proposal is no motion: expected finite numbers (too few correspondences?)")
        for stage in (COARSE, MIDDLE) if self.coarse else (MIDDLE,):
            motions, inliers = aligned(source, target, motions, stage, diameter_m)
        if len(motions) > 1:
            if self.best_by == "score":
                hypotheses = Hypotheses(motions[:, :3, :3], motions[:, :3, 3])
                inliers = score(*views, hypotheses, TOLERANCE * diameter_m, POINTS)
            motions = motions[[np.argmax(inliers)]]
        (T,), _ = aligned(source, target, motions, FINE, diameter_m)
        R = so3.matrix_from_quat(so3.quat_from_matrix(T[:3, :3]))  # products drift from SO(3)
        return with_evidence(*views, R, T[:3, 3])


def aligned(
    source: Points, target: Points, motions: Motions, stage: Stage, diameter_m: float
) -> tuple[Motions, Float[np.ndarray, " k"]]:
    """The motions after GICP at one resolution, and their inliers. Raises ReorientError for too few points."""
    (cloud, _), (other, tree) = (
        small_gicp.preprocess_points(x, stage.voxel * diameter_m, 10) for x in (source, target)
    )
    if min(cloud.size(), other.size()) < FEWEST_POINTS:
        raise ReorientError(f"clouds of {cloud.size()} and {other.size()} points: expected at least {FEWEST_POINTS}")
    results = [
        small_gicp.align(
            other,
            cloud,
            tree,
            T,
            registration_type="GICP",
            max_correspondence_distance=stage.gate * diameter_m,
            max_iterations=stage.iterations,
            rotation_epsilon=1e-4,
            translation_epsilon=1e-5 * diameter_m,
        )
        for T in motions
    ]
    return np.stack([x.T_target_source for x in results]), np.array([x.num_inliers for x in results], float)
