"""The interface of an estimator, and its estimate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.imaging.depth_image import MILLIMETRES_ABOVE
from reorient.imaging.goal import Goal
from reorient.imaging.refusals import require_isolated
from reorient.imaging.summary import check_scale
from reorient.registration import DepthView, Evidence, inlier_tolerance_m, measure_evidence

History = Sequence[tuple[DepthImage, Float[np.ndarray, "3 3"]]]
"""Earlier captures of the same held object, each with R_now_then."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A rotation that the truth may be, with what a confidence set needs."""

    R_goal_current: Float[np.ndarray, "3 3"]
    probability: float
    """Probability that it is within 5 degrees of the truth, up to symmetry."""
    level: float
    """Confidence sets of a higher level hold it."""


@dataclass(frozen=True, eq=False)
class RotationEstimate:
    """The motion from current to goal: p_goal = R_goal_current p_current + t_goal_current_m, camera axes, metres."""

    R_goal_current: Float[np.ndarray, "3 3"]
    """R_goal = R_goal_current @ R_current (left multiplication)."""
    t_goal_current_m: Float[np.ndarray, "3"]
    evidence: Evidence
    """How the motion fits both images."""
    confidence: float | None = None
    """Calibrated probability that the symmetry-aware error is below 5 degrees; None where not calibrated."""
    alternatives: tuple[tuple[Float[np.ndarray, "3 3"], float], ...] = ()
    """Other rotations that fit, each with its probability; the confidence and these need not sum to 1."""
    covariance_rad2: Float[np.ndarray, "3 3"] | None = None
    """Covariance (rad^2) of the rotation vector d, camera axes, in R_true = exp(d) R_goal_current, if the answer is
    near the truth; None if unknown."""
    free_axis: Float[np.ndarray, "3"] | None = None
    """Unit axis, the goal's camera axes, about which every rotation fits, as of a solid of revolution; the answer is
    then the smallest of these rotations. None if there is none."""
    symmetries: tuple[Float[np.ndarray, "3 3"], ...] = ()
    """Rotations S, the goal's camera axes, such that S R_goal_current is the same to the object, by the symmetry that a
    goal of views from all sides shows; the answer is the smallest of these rotations. Those about ``free_axis`` are in
    steps of 20 degrees. Empty without such a goal."""
    motion_covariance: Float[np.ndarray, "6 6"] | None = None
    """Covariance of the rotation vector d (rad) and the shift u (m) in p_true = exp(d) p_goal + u, camera axes, for
    points p_goal of the answer, if it is near the truth; None if unknown. Its first block is ``covariance_rad2``."""
    warnings: tuple[str, ...] = ()
    """What was found wrong with the input, a sentence each."""
    candidates: tuple[Candidate, ...] = ()
    """Distinct rotations, the answer first, then the most probable, for ``confidence_set``; empty where not calibrated.
    """
    guaranteed: float = 0.0
    """The largest level at which ``confidence_set`` holds; 0 where not calibrated."""

    def confidence_set(self, level: float = 0.95) -> list[tuple[Float[np.ndarray, "3 3"], float]] | None:
        """The smallest list of (R, probability) that holds the truth with the probability ``level``, the answer first.

        It holds the truth if one of its rotations is within 5 degrees of it, up to symmetry. By split-conformal
        calibration on objects that nothing was trained on (``reorient verifier calibrate``): the probability is that
        over estimates of the same number of views, and of images alike in noise and ambiguity. Never empty; a set of a
        higher level holds those of lower ones. None where there is no guarantee: the estimator is not calibrated, or of
        estimates like this one so many miss the truth altogether that only all rotations would do.

        Raises ReorientError for a level that is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ReorientError(f"level {level}: expected a probability between 0 and 1, such as 0.95")
        if level > self.guaranteed:
            return None
        return [(x.R_goal_current, x.probability) for k, x in enumerate(self.candidates) if k == 0 or x.level < level]

    @property
    def T_goal_current(self) -> se3.Transform:
        """The motion as a (4, 4) matrix, p_goal = T p_current, camera axes, metres."""
        return se3.transform(self.R_goal_current, self.t_goal_current_m)

    @property
    def rotvec_rad(self) -> Float[np.ndarray, "3"]:
        """The rotation as a rotation vector (axis times angle), camera axes."""
        return so3.log(self.R_goal_current)

    @property
    def quat_wxyz(self) -> Float[np.ndarray, "4"]:
        """The rotation as a unit quaternion with w >= 0."""
        return so3.quat_from_matrix(self.R_goal_current)

    @property
    def angle_rad(self) -> float:
        """Angle of the rotation, in [0, pi]."""
        return float(so3.angle(self.R_goal_current))


@runtime_checkable
class Estimator(Protocol):
    """Anything with this method; see ``reorient.load_estimator`` for those in the package."""

    def estimate(
        self,
        current: DepthImage,
        goal: Any,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """The rotation from current to goal. ``pivot_m``: rotation centre in camera axes, good to about 1 cm, if known.

        ``goal``: a DepthImage; also a Goal where the estimator states ``several_views = True`` (see ``for_any_goal``).

        Raises ReorientError for images that cannot be compared.
        """
        ...


@dataclass(frozen=True)
class OneView:
    """An estimator that knows one goal view: of a ``Goal`` it receives the primary view."""

    estimator: Estimator
    several_views: ClassVar[bool] = True

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage | Goal,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> Any:
        """As ``Estimator.estimate``; whatever a user's own returns."""
        return self.estimator.estimate(current, goal.image if isinstance(goal, Goal) else goal, pivot_m, history)

    def __getattr__(self, name: str) -> Any:
        """All else is the estimator's own."""
        if name == "estimator":  # not there yet: while it is being copied or unpickled
            raise AttributeError(name)
        return getattr(self.estimator, name)


def for_any_goal(estimator: Estimator) -> Estimator:
    """The estimator itself where it states ``several_views = True``, else one that gives it the primary view."""
    return estimator if getattr(estimator, "several_views", False) else OneView(estimator)


def check_pair(
    current: DepthImage, goal: DepthImage | Goal, pivot_m: Float[np.ndarray, "3"] | None = None, fewest: int = 20
) -> None:
    """Raise ReorientError for input that no estimator can use: few returns, no isolated object, a goal of several
    views of another size, a bad pivot."""
    further = goal.views if isinstance(goal, Goal) else ()
    primary = goal.image if isinstance(goal, Goal) else goal
    named = [("current", current), ("goal", primary), *((f"goal view {k}", x.image) for k, x in enumerate(further, 1))]
    for name, image in named:
        if not isinstance(image, DepthImage):
            raise ReorientError(f"{name} is a {type(image).__name__}: expected DepthImage(depth_m, camera)")
        if (returns := np.count_nonzero(image.depth_m)) < fewest:
            raise ReorientError(f"{name} image has {returns} returns: expected at least {fewest} on the object")
        require_isolated(image)
    if isinstance(goal, Goal):
        check_scale(current, goal)
    if pivot_m is not None:
        _check_pivot(pivot_m)


def _check_pivot(pivot_m: object) -> None:
    try:
        pivot = np.asarray(pivot_m, float)
    except (TypeError, ValueError):
        pivot = np.empty(0)
    if pivot.shape != (3,) or not np.all(np.isfinite(pivot)) or pivot[2] <= 0:
        raise ReorientError(f"pivot {pivot_m}: expected three finite metres in camera axes, in front of the camera")
    if pivot[2] > MILLIMETRES_ABOVE:
        raise ReorientError(f"pivot {pivot_m}: this looks like millimetres, expected metres (times 0.001)")


def checked_history(history: History) -> History:
    """The history itself. Raises ReorientError where it is not a sequence of (DepthImage, rotation matrix)."""
    try:
        known = [(image, np.asarray(R, float)) for image, R in history]
        right = all(isinstance(image, DepthImage) and so3.is_rotation(R) for image, R in known)
    except (TypeError, ValueError):
        right = False
    if not right:
        raise ReorientError("history: expected pairs (DepthImage, R_now_then), R_now_then a (3, 3) rotation matrix")
    return known


def with_evidence(
    current: DepthView,
    goal: DepthView,
    R_goal_current: Float[np.ndarray, "3 3"],
    t_goal_current_m: Float[np.ndarray, "3"],
    converged: bool | None = None,
    iterations: int | None = None,
    **more: Any,
) -> RotationEstimate:
    """An estimate with its evidence, at the tolerance that all estimators share; ``more``: its other fields."""
    tolerance_m = inlier_tolerance_m(current, goal)
    evidence = measure_evidence(current, goal, R_goal_current, t_goal_current_m, tolerance_m)
    evidence = replace(evidence, converged=converged, iterations=iterations)
    return RotationEstimate(R_goal_current, t_goal_current_m, evidence, **more)


def as_estimate(answer: Any, current: DepthImage, goal: DepthImage) -> RotationEstimate:
    """The answer of a user's own estimator as a ``RotationEstimate``; any object with its fields will do.

    The evidence is measured where the answer brings none. Raises ReorientError where there is no valid motion.
    """
    try:
        R, t_m = np.asarray(answer.R_goal_current, float), np.asarray(answer.t_goal_current_m, float)
    except (AttributeError, TypeError, ValueError):
        R = t_m = np.empty(0)
    if not so3.is_rotation(R) or t_m.shape != (3,) or not np.isfinite(t_m).all():
        raise ReorientError(
            f"the estimator returned {type(answer).__name__}: expected R_goal_current, a (3, 3) rotation matrix, and "
            "t_goal_current_m, three finite metres"
        )
    if isinstance(answer, RotationEstimate):
        return answer
    more = {name: getattr(answer, name, None) for name in ("confidence", "covariance_rad2")}
    alternatives = tuple(getattr(answer, "alternatives", None) or ())
    return with_evidence(DepthView(current), DepthView(goal), R, t_m, alternatives=alternatives, **more)
