"""Search hypotheses: from all rotations to a few distinct hypotheses, each in its own minimum.

1. Score a grid over SO(3) on few points. Take two Gauss-Newton steps from the best of it, and score them again: the
   first translation is a guess where no pivot is known.
2. From the best after non-maximum suppression (and "no rotation"): Gauss-Newton, non-maximum suppression, perturb and
   select; and again with finer tolerances.
3. Gauss-Newton to the finest tolerance; the hypotheses left after non-maximum suppression go to the verifier.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.random import Generator

from reorient import so3
from reorient.registration import Hypotheses, Problem, non_maximum_suppression, refine


@dataclass(frozen=True)
class Stage:
    """One level of refinement; lengths relative to the object diameter."""

    tolerances: tuple[float, ...]
    """Of each Gauss-Newton step."""
    points: int
    """Of each image."""
    scored_tolerance: float
    scored_points: int
    """Of each image."""
    keep: int
    """Hypotheses that are kept."""
    radius_deg: float
    """Of the non-maximum suppression."""
    copies: int = 0
    """Perturbed copies of each that is kept, itself among them; 0: none."""
    rotation_rad: float = 0.0
    """Root mean square of the perturbations' rotations."""
    shift: float = 0.0
    """Root mean square of their shifts."""


@dataclass(frozen=True)
class Effort:
    """How much work the search does."""

    grid: int
    """Rotations."""
    grid_points: int
    """Of each image."""
    slid: int
    """How many of them take two Gauss-Newton steps."""
    modes: int
    """How many are left after non-maximum suppression."""
    stages: tuple[Stage, ...]


GRID_TOLERANCE = 0.05
SLIDE, SLIDE_POINTS = (0.08, 0.08), 60
MODE_RADIUS_RAD = float(np.radians(15))

_COARSE = (0.05, 0.05, 0.04, 0.04, 0.03, 0.03)
_MIDDLE = (0.03, 0.025, 0.02, 0.02, 0.015, 0.015)
_FINE = (0.01, 0.01, 0.01, 0.01)
_FINEST = (0.01, 0.008, 0.006)

EFFORTS = {
    "fast": Effort(
        1500,
        60,
        100,
        16,
        (
            Stage(_COARSE, 100, 0.03, 200, 8, 8.0, 12, 0.2, 0.04),
            Stage(_MIDDLE, 200, 0.015, 400, 4, 5.0),
            Stage(_FINE, 600, 0.015, 600, 4, 3.0),
        ),
    ),
    "normal": Effort(
        6000,
        100,
        500,
        64,
        (
            Stage(_COARSE, 200, 0.03, 300, 34, 8.0, 24, 0.2, 0.04),
            Stage(_MIDDLE, 400, 0.015, 600, 18, 5.0, 24, 0.1, 0.02),
            Stage(_FINE, 1000, 0.01, 1000, 14, 3.0, 16, 0.06, 0.012),
            Stage(_FINEST, 1000, 0.012, 1000, 14, 3.0),
        ),
    ),
    "thorough": Effort(
        12000,
        150,
        2000,
        220,
        (
            Stage(_COARSE, 200, 0.03, 400, 110, 8.0, 48, 0.25, 0.05),
            Stage(_COARSE, 300, 0.025, 600, 64, 6.0, 48, 0.15, 0.03),
            Stage(_MIDDLE, 600, 0.015, 1000, 44, 4.0, 48, 0.1, 0.02),
            Stage((*_FINE, *_FINE), 1000, 0.01, 1500, 28, 3.0, 32, 0.06, 0.012),
            Stage((*_FINE, *_FINEST), 1500, 0.012, 1500, 24, 3.0),
        ),
    ),
}

_grid = cache(so3.grid)


def search(problem: Problem, effort: Effort) -> Hypotheses:
    """Distinct hypotheses, best score first. Deterministic."""
    rng = np.random.default_rng(0)
    hypotheses = propose(problem, effort)
    for stage in effort.stages:
        hypotheses = refine(problem, hypotheses, stage.tolerances, stage.points)
        score = problem.score(hypotheses, stage.scored_tolerance, stage.scored_points)
        radius_rad = float(np.radians(stage.radius_deg))
        hypotheses = hypotheses[non_maximum_suppression(hypotheses.R, score, radius_rad, stage.keep)]
        if stage.copies:
            hypotheses = perturb_and_select(problem, hypotheses, rng, stage)
    return hypotheses


def propose(problem: Problem, effort: Effort) -> Hypotheses:
    """ "No rotation", and the best of the grid after non-maximum suppression."""
    everywhere = problem.start(_grid(effort.grid))
    score = problem.image_score(everywhere, GRID_TOLERANCE, effort.grid_points)  # none moves a known pivot
    best = everywhere[np.argsort(-score, kind="stable")[: effort.slid]]
    slid = refine(problem, best, SLIDE, SLIDE_POINTS)
    score = problem.score(slid, GRID_TOLERANCE, effort.grid_points)
    slid = slid[non_maximum_suppression(slid.R, score, MODE_RADIUS_RAD, effort.modes)]
    still = problem.start(np.eye(3)[None])
    return Hypotheses(np.concatenate([still.R, slid.R]), np.concatenate([still.t_m, slid.t_m]))


def perturb_and_select(problem: Problem, hypotheses: Hypotheses, rng: Generator, stage: Stage) -> Hypotheses:
    """Each hypothesis, or the best of its randomly perturbed copies where that has a higher score."""
    k, copies = len(hypotheses), stage.copies
    rotvec = rng.standard_normal((copies, 3)) * (stage.rotation_rad / np.sqrt(3))
    shift_m = rng.standard_normal((copies, 3)) * (stage.shift * problem.diameter_m / np.sqrt(3))
    rotvec[0], shift_m[0] = 0, 0
    repeated = hypotheses[np.repeat(np.arange(k), copies)]
    tried = repeated.perturbed(problem.prior.goal_m, so3.exp(np.tile(rotvec, (k, 1))), np.tile(shift_m, (k, 1)))
    score = problem.score(tried, stage.scored_tolerance, stage.scored_points).reshape(k, copies)
    return tried[np.arange(k) * copies + np.argmax(score, axis=1)]
