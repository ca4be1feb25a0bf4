"""The error that a loop leaves: its bound by the covariances of the estimates, and what to expect before any move."""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincinv

from reorient.imaging import DepthImage, Goal
from reorient.plugins import USER_ERRORS, in_words

COMMON = 0.7
"""Share of an estimate's variance that all observations of a pose have in common: they err alike with the one goal
image, its pixels and the intrinsics. More observations leave it. Loops of generated objects (docs/tuning.md,
"Covariance")."""
EXPECTED_OBSERVATIONS = 3
"""Observations that are fused at the end of most loops."""


def fused_covariance(covariance_rad2: Float[np.ndarray, "3 3"], observations: int) -> Float[np.ndarray, "3 3"]:
    """The covariance of the mean of so many observations of one pose, from that of one."""
    return np.asarray(covariance_rad2 * (COMMON + (1 - COMMON) / observations))


def bound_rad(
    covariance_rad2: Float[np.ndarray, "3 3"], rotvec_rad: Float[np.ndarray, "3"], level: float = 0.95
) -> float:
    """The angle that a rotation does not exceed with the probability ``level``, if its rotation vector is normal about
    a mean.

    The squared angle is taken as gamma-distributed with the right mean and variance (Satterthwaite's approximation).
    """
    moment = covariance_rad2 + np.outer(rotvec_rad, rotvec_rad)
    mean, variance = float(np.trace(moment)), 2 * float(np.trace(covariance_rad2 @ (2 * moment - covariance_rad2)))
    shape = mean**2 / max(variance, 1e-30)
    return float(np.sqrt(gammaincinv(shape, level) * mean / shape))


def expected_error_rad(estimator: Any, image: DepthImage, goal: Goal) -> float | None:
    """The root mean square error to expect at the end of a loop that reaches the goal, from the goal image's shape and
    the noise of both; None for an estimator without ``final_covariance``."""
    final_covariance = getattr(estimator, "final_covariance", None)
    if final_covariance is None:
        return None
    try:
        covariance_rad2 = final_covariance(image, goal)
    except USER_ERRORS as error:  # it may be the user's own; a loop does not end for want of a forecast
        in_words(error)  # logs it
        return None
    return float(np.sqrt(np.trace(fused_covariance(covariance_rad2, EXPECTED_OBSERVATIONS))))
