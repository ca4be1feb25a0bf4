"""The estimator for any rotation: propose and refine (``search``), then verify (``judge``).

Without a GPU, a model of the object or a guess at the rotation; with a probability that the answer is right, and with
the other rotations that may be meant where the object is symmetric or the views leave it open.
"""

from collections.abc import Sequence
from os import cpu_count

import numpy as np
import small_gicp
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError, unknown_name
from reorient.estimators.base import History, RotationEstimate, check_pair, known_captures
from reorient.estimators.gicp import FEWEST_POINTS, FINE
from reorient.estimators.search import EFFORTS, search
from reorient.estimators.verifier import Judge, features, load_judge
from reorient.imaging import DepthImage
from reorient.registration.evidence import weigh
from reorient.registration.refine import Hypotheses, Look, Problem, descend, normal_equations
from reorient.registration.surface import Surface, frame_of
from reorient.runs.pool import Pool

FINE_TOLERANCE = 0.012  # depth difference that still fits, in sizes
POLISH = (0.008, 0.006, 0.004, 0.003)  # tolerances of the last steps, in sizes, unless noise forbids
POLISH_POINTS = 4000
NOISE_FACTOR = 4.0  # the last tolerances are at least this many typical residuals
QUIET = 0.0045  # residual, in sizes, of depth with next to no noise
NOISY_VOXEL = 0.02  # of GICP, in sizes, where noise leaves nothing finer to see
GATE = 0.02  # of the correspondences of GICP
SCORED_TOLERANCE = 0.0045  # by which its answer is compared with what it began from
NO_WORSE = 0.002  # agreement that its answer may lose: what lies between pixels counts as little
LEAST_NOISE = 0.001  # residual that even exact depth leaves between pixels
COVARIANCE_SCALE = 0.044  # from the curvature's inverse to the scatter with 1 mm noise; without noise pessimistic
LOOKS = 2  # earlier captures that are used: those that show the most new
LEAST_NEW_RAD = np.radians(10)  # a capture turned by less shows nothing new
SAME_RAD = np.radians(12)  # two hypotheses this near are one answer
ALTERNATIVE_ABOVE = 0.25  # of the answer's probability: what is less likely is not told


class Default:
    """Any rotation, with a calibrated confidence and alternatives; ``effort``: fast, normal or thorough."""

    def __init__(self, effort: str = "normal") -> None:
        """Raises ReorientError for an unknown effort."""
        if effort not in EFFORTS:
            raise unknown_name("effort", effort, list(EFFORTS))
        self._effort = effort

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; of the history the captures that show the most new are used."""
        check_pair(current, goal, pivot_m)
        problem = pose(current, goal, pivot_m, known_captures(history))
        return verdict(problem, search(problem, EFFORTS[self._effort]), load_judge(), self._effort)

    def estimate_many(
        self,
        pairs: Sequence[tuple[DepthImage, DepthImage]],
        pivots_m: Sequence[Float[np.ndarray, "3"] | None] | None = None,
        workers: int | None = None,
    ) -> list[RotationEstimate]:
        """``estimate`` for many (current, goal) pairs, on so many processes (None: one a core). Raises ReorientError
        for another number of pivots."""
        pivots = [None] * len(pairs) if pivots_m is None else list(pivots_m)
        if len(pivots) != len(pairs):
            raise ReorientError(f"{len(pivots)} pivots for {len(pairs)} pairs: expected one each, or no pivots_m")
        pool = Pool(max(min(workers or cpu_count() or 1, len(pairs)), 1))
        tasks = [(*pair, pivot_m) for pair, pivot_m in zip(pairs, pivots, strict=True)]
        return list(pool.map(lambda task: self.estimate(*task), tasks))


def pose(
    current: DepthImage, goal: DepthImage, pivot_m: Float[np.ndarray, "3"] | None, history: History = ()
) -> Problem:
    """The images made ready. Earlier captures turn to now about the pivot (or its guess), then slide into place."""
    now, target = Surface(current), Surface(goal)
    frame = frame_of(now, target, pivot_m)
    looks = [Look(now, np.eye(3), np.zeros(3))]
    for image, R in _most_telling(history):
        then = Surface(image)
        before = frame_of(then, now, pivot_m)
        to_now = Problem((Look(then, np.eye(3), np.zeros(3)),), now, before)
        placed = descend(to_now, Hypotheses(R[None], to_now.start(R[None])), _PLACING, 400, turn=False)
        looks.append(Look(then, R, placed.t_m[0]))
    return Problem(tuple(looks), target, frame)


_PLACING = (0.08, 0.06, 0.04, 0.03, 0.02, 0.015, 0.01)  # tolerances, in sizes


def _most_telling(history: History) -> list[tuple[DepthImage, Float[np.ndarray, "3 3"]]]:
    """One after another, the capture that is turned farthest from all chosen and from now."""
    chosen: list[tuple[DepthImage, Float[np.ndarray, "3 3"]]] = []
    known = [np.eye(3)]
    while len(chosen) < min(LOOKS, len(history)):
        away = [min(float(so3.angle_difference(R, x)) for x in known) for _, R in history]
        farthest = int(np.argmax(away))
        if away[farthest] < LEAST_NEW_RAD:
            break
        chosen.append(history[farthest])
        known.append(history[farthest][1])
    return chosen


def verdict(problem: Problem, hypotheses: Hypotheses, judge: Judge, effort: str) -> RotationEstimate:
    """The likeliest hypothesis of a search with that effort, polished, and what else may be meant."""
    odds = np.mean([judge.log_odds(features(problem, look, hypotheses)) for look in problem.looks], axis=0)
    probability = judge.probability(odds, effort)
    order = np.argsort(-odds, kind="stable")
    best = order[0]
    answer = _polished(problem, hypotheses[order[:1]])
    others: list[int] = []
    for i in order[1:]:
        apart = so3.angle_difference(hypotheses.R[[best, *others]], hypotheses.R[i])
        if probability[i] > ALTERNATIVE_ABOVE * probability[best] and apart.min() > SAME_RAD:
            others.append(i)
    share = probability / max(float(probability[[best, *others]].sum()), 1.0)
    look = problem.looks[0]
    tolerance_m = FINE_TOLERANCE * problem.frame.size_m
    return RotationEstimate(
        answer.R[0],
        answer.t_m[0],
        weigh(look.surface, problem.goal, answer.R[0], answer.t_m[0], tolerance_m),
        confidence=float(probability[best]),
        alternatives=tuple((hypotheses.R[i], float(share[i])) for i in others),
        covariance_rad2=_covariance(problem, answer),
    )


def _polished(problem: Problem, answer: Hypotheses) -> Hypotheses:
    """The last steps, on all returns; then generalised ICP, which is finer still unless it slides away."""
    noise = _residual(problem, answer)
    answer = descend(problem, answer, [max(x, NOISE_FACTOR * noise) for x in POLISH], POLISH_POINTS)
    finer = _registered(problem, answer, FINE.voxel if noise < QUIET else NOISY_VOXEL)
    before, after = (problem.score(x, SCORED_TOLERANCE, POLISH_POINTS)[0] for x in (answer, finer))
    return finer if after >= before - NO_WORSE else answer


def _residual(problem: Problem, answer: Hypotheses) -> float:
    """Root mean square depth difference of what fits, in sizes; 0 where nothing does."""
    size_m = problem.frame.size_m
    evidence = weigh(problem.looks[0].surface, problem.goal, answer.R[0], answer.t_m[0], FINE_TOLERANCE * size_m)
    return float(np.nan_to_num(evidence.residual_m)) / size_m


def _registered(problem: Problem, answer: Hypotheses, voxel: float) -> Hypotheses:
    """GICP from the answer, ``voxel`` in sizes; the answer itself where the clouds are too small for it."""
    size_m = problem.frame.size_m
    clouds = (problem.looks[0].surface.all_points_m, problem.goal.all_points_m)
    (source, _), (target, tree) = (small_gicp.preprocess_points(x.astype(float), voxel * size_m, 10) for x in clouds)
    if min(source.size(), target.size()) < FEWEST_POINTS:
        return answer
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = answer.R[0], answer.t_m[0]
    result = small_gicp.align(
        target,
        source,
        tree,
        T,
        registration_type="GICP",
        max_correspondence_distance=GATE * size_m,
        max_iterations=20,
        rotation_epsilon=1e-5,
        translation_epsilon=1e-5 * size_m,
    ).T_target_source
    R = so3.matrix_from_quat(so3.quat_from_matrix(result[:3, :3]))  # small_gicp's products drift from SO(3)
    return Hypotheses(R[None], result[None, :3, 3])


def _covariance(problem: Problem, answer: Hypotheses) -> Float[np.ndarray, "3 3"]:
    """Of the rotation, from the curvature at the answer."""
    noise = max(_residual(problem, answer), LEAST_NOISE)
    H, _ = normal_equations(problem, answer, NOISE_FACTOR * noise, POLISH_POINTS)
    return COVARIANCE_SCALE * np.linalg.inv(H[0] + 1e-9 * np.eye(6))[:3, :3]
