"""The geometry kernel: depth views, the alignment problem, scores and evidence, Gauss-Newton, normals.

It aligns depth images and knows no estimator. ``build_problem`` makes the problem of a pair; ``Problem.start`` makes
hypotheses of rotations, ``refine`` improves them, ``Problem.score`` and ``measure_evidence`` compare them.
"""

from reorient.registration.aligning import aligned_goal
from reorient.registration.build import build_problem
from reorient.registration.depth_view import DepthView, Warped, evenly_spaced
from reorient.registration.evidence import (
    EVIDENCE_POINTS,
    INLIER_TOLERANCE,
    Evidence,
    inlier_tolerance_m,
    measure_evidence,
    warp_both,
)
from reorient.registration.gauss_newton import normal_equations, refine
from reorient.registration.hypotheses import Hypotheses
from reorient.registration.normals import fit_planes
from reorient.registration.pivot import PivotPrior, pivot_prior
from reorient.registration.problem import PosedView, Problem, ViewPair
from reorient.so3 import non_maximum_suppression

__all__ = [
    "EVIDENCE_POINTS",
    "INLIER_TOLERANCE",
    "DepthView",
    "Evidence",
    "Hypotheses",
    "PivotPrior",
    "PosedView",
    "Problem",
    "ViewPair",
    "Warped",
    "aligned_goal",
    "build_problem",
    "evenly_spaced",
    "fit_planes",
    "inlier_tolerance_m",
    "measure_evidence",
    "non_maximum_suppression",
    "normal_equations",
    "pivot_prior",
    "refine",
    "warp_both",
]
