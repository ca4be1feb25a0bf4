"""Propose and refine: from all rotations to a few distinct hypotheses, each in its own minimum.

1. Score a grid over SO(3) on few points. Let the best of it slide into place by two steps, and score them again: where
   no pivot is known the first translation is a guess.
2. From the distinct best (and "no rotation"), descend; keep the distinct best; try what lies around each; twice.
3. Descend to the fine tolerance and keep the distinct best for the judge.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from reorient import so3
from reorient.registration.refine import Hypotheses, Problem, descend, distinct, scatter


@dataclass(frozen=True)
class Stage:
    """One level of refinement; lengths in sizes."""

    tolerances: tuple[float, ...]
    """Of each step."""
    points: int
    """Of each image."""
    scored_tolerance: float
    scored_points: int
    keep: int
    apart_deg: float
    """Hypotheses nearer than this are one."""
    copies: int = 0
    """Perturbations to try around each that is kept."""
    turn_rad: float = 0.0
    shift: float = 0.0


@dataclass(frozen=True)
class Effort:
    """How much work to do."""

    grid: int
    """Rotations."""
    grid_points: int
    """Of each image."""
    slid: int
    """How many of them slide into place."""
    modes: int
    stages: tuple[Stage, ...]


GRID_TOLERANCE = 0.05
SLIDE, SLIDE_POINTS = (0.08, 0.08), 60
MODES_APART_DEG = 15.0

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
    """Distinct hypotheses, best agreement first. Deterministic."""
    rng = np.random.default_rng(0)
    hypotheses = propose(problem, effort)
    for stage in effort.stages:
        hypotheses = descend(problem, hypotheses, stage.tolerances, stage.points)
        score = problem.score(hypotheses, stage.scored_tolerance, stage.scored_points)
        hypotheses = hypotheses[distinct(hypotheses.R, score, stage.keep, np.radians(stage.apart_deg))]
        if stage.copies:
            hypotheses = scatter(
                problem,
                hypotheses,
                rng,
                stage.copies,
                stage.turn_rad,
                stage.shift,
                stage.scored_tolerance,
                stage.scored_points,
            )
    return hypotheses


def propose(problem: Problem, effort: Effort) -> Hypotheses:
    """ "No rotation", and the distinct best of the grid."""
    grid = _grid(effort.grid)
    everywhere = Hypotheses(grid, problem.start(grid))
    score = problem.agreement(everywhere, GRID_TOLERANCE, effort.grid_points)  # none moves a known pivot
    best = everywhere[np.argsort(-score, kind="stable")[: effort.slid]]
    slid = descend(problem, best, SLIDE, SLIDE_POINTS)
    score = problem.score(slid, GRID_TOLERANCE, effort.grid_points)
    slid = slid[distinct(slid.R, score, effort.modes, np.radians(MODES_APART_DEG))]
    still = np.eye(3)[None]
    return Hypotheses(np.concatenate([still, slid.R]), np.concatenate([problem.start(still), slid.t_m]))
