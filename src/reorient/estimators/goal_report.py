"""What a goal can and cannot tell, by its own views: remaining flips, a free axis, the overlap with any start."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.estimators.equivalents import free_axis
from reorient.estimators.goal_symmetry import symmetries
from reorient.formatting import format_share
from reorient.imaging import Goal
from reorient.imaging.summary import Summary
from reorient.registration import Evidence, Hypotheses, Problem, refine, warp_both
from reorient.registration.aligning import posed_views
from reorient.registration.coverage import Coverage, coverage
from reorient.registration.evidence import evidence_of

ROTATIONS = 2000
"""Of the grid over SO(3) that is searched for rotations under which the goal resembles itself."""
KEPT = 40
DISTINCT_RAD = float(np.radians(15))
TOLERANCES = (0.06, 0.05, 0.04, 0.03, 0.02, 0.015, 0.012)
POINTS = 400
TOLERANCE = 0.015
"""Largest depth difference of an inlier, relative to the object diameter: that of all evidence."""
ALIKE = 0.92
"""Least co-visible inlier ratio of a rotation that the goal's views do not tell from none."""
OVERLAP = 0.3
"""Least inlier ratio of such a rotation."""


@dataclass(frozen=True, eq=False)
class Flip:
    """A rotation of the object under which the goal's own views match nearly as well as without it."""

    R: Float[np.ndarray, "3 3"]
    """About the goal pose (camera axes, left)."""
    inlier_ratio: float
    """Of the co-visible points."""


@dataclass(frozen=True, eq=False)
class GoalReport:
    """The statement about a goal."""

    views: int
    """The primary view included."""
    summary: Summary
    """Of the primary view."""
    coverage: Coverage
    """Overlap with a start in any orientation."""
    flips: tuple[Flip, ...]
    """Remaining flips, the most alike first."""
    free_axis: Float[np.ndarray, "3"] | None
    """Unit axis (camera axes) about which no rotation can be told; None if there is none."""

    def sentences(self) -> Iterator[str]:
        """The statement in words."""
        yield f"{self.views} view{'s' * (self.views != 1)}, {self.summary}"
        yield (
            f"overlap with any start: the views show at least half of the visible surface of about "
            f"{format_share(self.coverage.starts)} of all orientations (mean {format_share(self.coverage.mean)})"
        )
        if self.coverage.starts < 0.9:
            yield "from the other orientations a loop can end unsure (more views: reorient capture --views 5)"
        if self.free_axis is not None:
            x, y, z = self.free_axis
            yield f"free axis [{x:.2f} {y:.2f} {z:.2f}]: rotations about it cannot be told, the smallest will be made"
        for flip in self.flips:
            axis = so3.quat_axis(so3.quat_from_matrix(flip.R))
            yield (
                f"remaining flip: {np.degrees(so3.angle(flip.R)):.0f} deg about [{axis[0]:.2f} {axis[1]:.2f} "
                f"{axis[2]:.2f}] ({format_share(flip.inlier_ratio)} of co-visible points match): it looks the same in "
                "these views, by symmetry or because no view shows the difference"
            )
        if not self.flips and self.free_axis is None:
            yield "no remaining flip and no free axis, as far as the views show the object"


def report_on(goal: Goal) -> GoalReport:
    """The statement about a goal, whose views are aligned."""
    posed = posed_views(goal)
    problem = Problem.of(posed, posed, None)
    none = Hypotheses(np.eye(3)[None], np.zeros((1, 3)))
    axis = free_axis(problem, none) if symmetries(goal).axis is None else symmetries(goal).axis
    flips: list[Flip] = []
    for flip in sorted(_flips(problem, axis), key=lambda flip: -flip.inlier_ratio):
        apart_rad = [
            so3.angle_but_about(flip.R @ other.R.T, axis if axis is None else other.R @ axis) for other in flips
        ]
        if all(x > DISTINCT_RAD for x in apart_rad):
            flips.append(flip)
    return GoalReport(1 + len(goal.views), Summary.of(goal.image), coverage(goal), tuple(flips), axis)


def _flips(problem: Problem, axis: np.ndarray | None) -> Iterator[Flip]:
    """Rotations that are not nearly none, nor one about the free axis, and that match."""
    start = problem.start(so3.grid(ROTATIONS))
    score = problem.image_score(start, TOLERANCES[1], POINTS // 4)
    found = refine(problem, start[so3.non_maximum_suppression(start.R, score, DISTINCT_RAD, KEPT)], TOLERANCES, POINTS)
    score = problem.image_score(found, TOLERANCE, POINTS)
    found = found[so3.non_maximum_suppression(found.R, score, DISTINCT_RAD)]
    for R, t_m in zip(found.R, found.t_m, strict=True):
        if so3.angle_but_about(R, axis) > DISTINCT_RAD:
            evidence = _evidence(problem, Hypotheses(R[None], t_m[None]))
            if evidence.covisible_inlier_ratio >= ALIKE and evidence.inlier_ratio >= OVERLAP:
                yield Flip(R, evidence.covisible_inlier_ratio)


def _evidence(problem: Problem, hypothesis: Hypotheses) -> Evidence:
    """The evidence over all pairs of views."""
    warped = [
        each
        for pair in problem.pairs(hypothesis)
        for each in warp_both(pair.now.view, pair.goal.view, pair.motions.R[0], pair.motions.t_m[0], POINTS)
    ]
    return evidence_of(warped, TOLERANCE * problem.diameter_m)
