"""Search hypotheses: from all rotations to a few distinct hypotheses, each in its own minimum.

1. Score a grid over SO(3) on few points. Take two Gauss-Newton steps from the best of it, and score them again: the
   first translation is a guess where no pivot is known.
2. From the best after non-maximum suppression (and "no rotation"): Gauss-Newton, non-maximum suppression, perturb and
   select; and again with finer tolerances.
3. Gauss-Newton to the finest tolerance, and non-maximum suppression.

All this twice: with the silhouettes, which help where the images show the whole object, and with less work without
them, which mislead where part of it is missing. Where a part is known to be missing, as beyond the frame, generalised
ICP from no rotation finds small ones that neither does. All these hypotheses go to the verifier. A first search whose
best hypothesis needs to be beyond doubt does without the second and ICP.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool
from numpy.random import Generator

from reorient import so3
from reorient.estimators.polish import register
from reorient.registration import Hypotheses, Problem, non_maximum_suppression, refine


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One level of refinement; lengths relative to the object diameter."""

    tolerances: tuple[float, ...]
    """Of each Gauss-Newton step."""
    points: int
    """Of each image."""
    scored_tolerance: float
    """For the ranking after the steps: depth difference of an inlier."""
    scored_points: int
    """For the ranking after the steps: of each image."""
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


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How much work the search does."""

    grid: int
    """Rotations of the grid."""
    grid_points: int
    """Of each image, for the ranking of the grid."""
    slid: int
    """Best grid rotations that take two Gauss-Newton steps."""
    modes: int
    """How many of these are left after non-maximum suppression."""
    stages: tuple[Stage, ...]


GRID_TOLERANCE = 0.05  # depth difference of an inlier, relative to the object diameter
SLIDE, SLIDE_POINTS = (0.08, 0.08), 60  # the two steps from the grid: tolerances (docs/tuning.md), points of each image
MODE_RADIUS_RAD = float(np.radians(15))  # of the non-maximum suppression after these

INCOMPLETE = 0.02  # unknown share of the outline of an image that may miss a part; at most 0.005 of whole objects
ICP = ((0.032, 0.12), (0.009, 0.03))  # voxels and farthest correspondences, as of the estimator gicp

SAME_RAD = float(np.radians(1))  # a hypothesis of one search this close to one of the other is the same; not tuned

_COARSE = (0.05, 0.05, 0.04, 0.04, 0.03, 0.03)
_MIDDLE = (0.03, 0.025, 0.02, 0.02, 0.015, 0.015)
_FINE = (0.01, 0.01, 0.01, 0.01)
_FINEST = (0.01, 0.008, 0.006)

# What each stage, the perturbations and the number of modes of "normal" are worth: docs/ablations.md, "Stages of the
# search". The trials that chose the single numbers are not recorded.
# fmt: off
EFFORTS = {
    "fast": Effort(
        grid=1500, grid_points=60, slid=100, modes=16,
        stages=(
            Stage(
                tolerances=_COARSE, points=100, scored_tolerance=0.03, scored_points=200,
                keep=8, radius_deg=8.0, copies=12, rotation_rad=0.2, shift=0.04,
            ),
            Stage(
                tolerances=_MIDDLE, points=200, scored_tolerance=0.015, scored_points=400,
                keep=4, radius_deg=5.0,
            ),
            Stage(
                tolerances=_FINE, points=600, scored_tolerance=0.015, scored_points=600,
                keep=4, radius_deg=3.0,
            ),
        ),
    ),
    "normal": Effort(
        grid=6000, grid_points=100, slid=500, modes=64,
        stages=(
            Stage(
                tolerances=_COARSE, points=200, scored_tolerance=0.03, scored_points=300,
                keep=24, radius_deg=8.0, copies=24, rotation_rad=0.2, shift=0.04,
            ),
            Stage(
                tolerances=_MIDDLE, points=400, scored_tolerance=0.015, scored_points=600,
                keep=12, radius_deg=5.0, copies=24, rotation_rad=0.1, shift=0.02,
            ),
            Stage(
                tolerances=_FINE, points=1000, scored_tolerance=0.01, scored_points=1000,
                keep=8, radius_deg=3.0, copies=16, rotation_rad=0.06, shift=0.012,
            ),
            Stage(
                tolerances=_FINEST, points=1000, scored_tolerance=0.012, scored_points=1000,
                keep=8, radius_deg=3.0,
            ),
        ),
    ),
}
# fmt: on

_grid = cache(so3.grid)


@dataclass(frozen=True, eq=False)
class Found:
    """What a search leaves to the verifier."""

    hypotheses: Hypotheses
    """Best score first."""
    silhouettes: Bool[np.ndarray, " k"]
    """Which of them were refined with the silhouettes."""


def search(problem: Problem, effort: Effort, robust: bool = True) -> Found:
    """Distinct hypotheses of a search with the silhouettes and, if ``robust``, of one without, and of ICP.
    Deterministic."""
    hypotheses = search_once(problem, effort)
    count = len(hypotheses)
    if robust:
        hypotheses = hypotheses.and_also(search_once(problem.without_silhouettes, EFFORTS["fast"]))
        if max(problem.current.unknown_outline, problem.goal.unknown_outline) >= INCOMPLETE:
            hypotheses = hypotheses.and_also(from_no_rotation(problem))
    score = problem.score(hypotheses, effort.stages[-1].scored_tolerance, effort.stages[-1].scored_points)
    kept = non_maximum_suppression(hypotheses.R, score, SAME_RAD)
    return Found(hypotheses[kept], kept < count)


def from_no_rotation(problem: Problem) -> Hypotheses:
    """Where generalised ICP from no rotation ends; nothing of clouds too small for it."""
    found = problem.start(np.eye(3)[None])
    for voxel, farthest in ICP:
        registered = register(problem, found, voxel, farthest)
        if registered is None:
            return found[:0]
        found = registered.hypothesis
    return found


def search_once(problem: Problem, effort: Effort) -> Hypotheses:
    """Distinct hypotheses, best score first."""
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
    # the prior costs nothing here: starts keep a known pivot in place
    score = problem.image_score(everywhere, GRID_TOLERANCE, effort.grid_points)
    best = everywhere[np.argsort(-score, kind="stable")[: effort.slid]]
    slid = refine(problem, best, SLIDE, SLIDE_POINTS)
    score = problem.score(slid, GRID_TOLERANCE, effort.grid_points)
    slid = slid[non_maximum_suppression(slid.R, score, MODE_RADIUS_RAD, effort.modes)]
    still = problem.start(np.eye(3)[None])
    return still.and_also(slid)


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
