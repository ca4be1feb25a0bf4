"""Equivalent hypotheses: rotations that fit the images alike, as of a symmetric object. The smallest is the answer.

A solid of revolution leaves one axis free: every rotation about it fits. Other symmetric objects, and views that show
too little, leave a few separate rotations.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.registration import Evidence, Hypotheses, Problem, normal_equations, refine


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Lengths relative to the object diameter. The trials that chose them are in docs/tuning.md."""

    tolerances: tuple[float, ...] = (0.04, 0.03, 0.02, 0.015, 0.012, 0.01)
    """Of the Gauss-Newton steps before hypotheses are compared."""
    points: int = 1000
    """Of each image."""
    scored_tolerance: float = 0.012
    """Depth difference of an inlier in the comparison."""
    loss: float = 0.05
    """Co-visible inlier ratio that a rotation about a free axis may lose."""
    choice_loss: float = 0.02
    """Co-visible inlier ratio that an equivalent hypothesis may lose."""
    overlap: float = 0.1
    """Least inlier ratio of a hypothesis that is compared."""
    probe_deg: float = 20.0
    """First rotations about an axis, both ways, that must fit if it is free."""
    doublings: int = 1
    """How often the rotations that fit are doubled, which must fit again: up to 40 degrees both ways."""
    kept: float = 0.5
    """The Gauss-Newton steps must not rotate a probe by more, relative to its own rotation."""
    weak: float = 1.4
    """An axis is probed if the images determine the rotation about it by this factor worse than about the others."""
    gain_deg: float = 3.0
    """A hypothesis that rotates by this much less is preferred."""


SETTINGS = Settings()


def smallest_equivalent(
    problem: Problem, answer: Hypotheses, others: Hypotheses
) -> tuple[Hypotheses, np.ndarray | None]:
    """The hypothesis with the smallest rotation that fits as well as the answer, and the free axis of the object.

    The axis is a unit vector in the goal's camera axes, or None. ``others``: competing hypotheses.
    """
    axis = free_axis(problem, answer)
    if axis is not None:
        others = others.and_also(_rotated(problem, answer, axis, np.array([-so3.twist_angle(answer.R[0], axis)])))
    smaller = others[so3.angle(others.R) < so3.angle(answer.R[0]) - np.radians(SETTINGS.gain_deg)]
    if len(smaller):
        refined, fits = _fitting(problem, answer, smaller, SETTINGS.choice_loss)
        if fits.any():
            refined = refined[fits]
            answer = refined[np.array([np.argmin(so3.angle(refined.R))])]
    return answer, axis


def free_axis(problem: Problem, answer: Hypotheses) -> np.ndarray | None:
    """The axis (goal's camera axes) about which every rotation of the answer fits the images; None if there is none."""
    H, _ = normal_equations(problem, answer, SETTINGS.scored_tolerance, SETTINGS.points)
    spread, axes = np.linalg.eigh(np.linalg.inv(H[0] + 1e-9 * np.eye(6))[:3, :3])
    if spread[2] < SETTINGS.weak**2 * spread[1]:
        return None
    angle_rad = np.radians(SETTINGS.probe_deg)
    probes = _rotated(problem, answer, axes[:, 2], np.array([-angle_rad, angle_rad]))
    refined, fits = _fitting(problem, answer, probes, SETTINGS.loss)
    for doubling in range(SETTINGS.doublings + 1):
        slid = so3.angle_difference(refined.R, probes.R) > SETTINGS.kept * angle_rad * 2**doubling
        if np.any(slid | ~fits):
            return None
        if doubling < SETTINGS.doublings:
            probes = _twice(answer, refined)
            refined, fits = _fitting(problem, answer, probes, SETTINGS.loss)
    axis = so3.log(refined.R[1] @ answer.R[0].T)
    return np.asarray(axis / np.linalg.norm(axis))


def _twice(answer: Hypotheses, others: Hypotheses) -> Hypotheses:
    """From the answer twice the motion that leads to each of the others."""
    R = others.R @ answer.R[0].T
    shift_m = others.t_m - R @ answer.t_m[0]
    return Hypotheses(R @ others.R, (R @ others.t_m[:, :, None])[:, :, 0] + shift_m)


def _fitting(problem: Problem, answer: Hypotheses, others: Hypotheses, loss: float) -> tuple[Hypotheses, np.ndarray]:
    """The others, refined, and which of them lose no more of the answer's co-visible inlier ratio."""
    refined = refine(problem, others, SETTINGS.tolerances, SETTINGS.points)
    first, *rest = (
        _evidence(problem, R, t_m) for each in (answer, refined) for R, t_m in zip(each.R, each.t_m, strict=True)
    )
    least = first.covisible_inlier_ratio - loss
    return refined, np.array([x.covisible_inlier_ratio >= least and x.inlier_ratio >= SETTINGS.overlap for x in rest])


def _evidence(problem: Problem, R: Float[np.ndarray, "3 3"], t_m: Float[np.ndarray, "3"]) -> Evidence:
    tolerance_m = SETTINGS.scored_tolerance * problem.diameter_m
    return problem.evidence(R, t_m, tolerance_m, SETTINGS.points)


def _rotated(problem: Problem, answer: Hypotheses, axis: np.ndarray, angles_rad: np.ndarray) -> Hypotheses:
    """The answer rotated further about an axis through the goal's centre."""
    k = len(angles_rad)
    repeated = answer[np.zeros(k, int)]
    return repeated.perturbed(problem.prior.goal_m, so3.exp(angles_rad[:, None] * axis), np.zeros((k, 3)))
