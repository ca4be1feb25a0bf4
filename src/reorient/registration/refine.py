"""Refine many hypotheses at once: Gauss-Newton on depth and silhouettes both ways, and scattering to leave bad minima.

For a hypothesis, the points of each image are moved into the other's view. One that lands on the object is drawn onto
the surface's plane there (less the farther it is, and hardly if it lies behind, where it may be hidden); one that
stands before the surface is pushed back, one outside the silhouette is pushed in, both from any distance but with
bounded force. All hypotheses take the step together, in float32, and their 6 x 6 systems are solved in one call.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.registration.evidence import NOWHERE_M, agreement, batches, moved
from reorient.registration.surface import Frame, Surface

FRONT_WEIGHT, OUTSIDE_WEIGHT = np.float32(0.25), np.float32(0.5)  # of what contradicts, beside 1 for what fits
HIDDEN_REACH = np.float32(1.0)  # a point this many tolerances behind the surface counts half at most
DAMPING = 0.02  # of the diagonal
INDEPENDENT = 60.0  # what all points of an image are worth beside the prior: neighbours share their errors
LONGEST_TURN_RAD, LONGEST_SHIFT = 0.25, 0.25  # of one step; the shift in half sizes
SURPRISE_COST = 0.01  # agreement lost for each unit of the prior's surprise
LARGEST_SURPRISE = 20.0
FEWEST_POINTS = 50  # of an image
BOX_POINTS = 100


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Motions from current to goal: p_goal = R p + t."""

    R: Float[np.ndarray, "k 3 3"]
    t_m: Float[np.ndarray, "k 3"]

    def __len__(self) -> int:
        return len(self.R)

    def __getitem__(self, chosen: np.ndarray | slice) -> "Hypotheses":
        return Hypotheses(self.R[chosen], self.t_m[chosen])

    def after(self, R_now_then: Float[np.ndarray, "3 3"], t_now_then_m: Float[np.ndarray, "3"]) -> "Hypotheses":
        """The motions from an earlier moment to the goal, by way of now."""
        return Hypotheses(self.R @ R_now_then, self.R @ t_now_then_m + self.t_m)


@dataclass(frozen=True, eq=False)
class Look:
    """One capture of the object, and how the object moved from then to now."""

    surface: Surface
    R_now_then: Float[np.ndarray, "3 3"]
    t_now_then_m: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Problem:
    """The captures of the object (the current one first), the goal, and what they share."""

    looks: tuple[Look, ...]
    goal: Surface
    frame: Frame

    def start(self, R: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3"]:
        """First translations: about a known pivot, else such that what is seen stands in the goal's place.

        That is: the boxes around both share their middle across the view, and their nearest depth.
        """
        if self.frame.pivot_known:
            return self.frame.start(R)
        turned = moved(
            R.astype(np.float32), np.zeros((len(R), 3), np.float32), self.looks[0].surface.sample(BOX_POINTS)
        )
        return _place(self.goal.sample(BOX_POINTS)[None]) - _place(turned)

    def agreement(self, hypotheses: Hypotheses, tolerance: float, points: int) -> Float[np.ndarray, " k"]:
        """The mean over all looks, which share the points between them; ``tolerance`` in sizes."""
        total = np.zeros(len(hypotheses))
        for look in self.looks:
            then = hypotheses.after(look.R_now_then, look.t_now_then_m)
            total += agreement(
                look.surface, self.goal, then.R, then.t_m, tolerance * self.frame.size_m, self.share(points)
            )
        return total / len(self.looks)

    def score(self, hypotheses: Hypotheses, tolerance: float, points: int) -> Float[np.ndarray, " k"]:
        """Agreement, less what the prior holds against each."""
        surprise = self.frame.surprise(hypotheses.R, hypotheses.t_m)
        return self.agreement(hypotheses, tolerance, points) - SURPRISE_COST * np.minimum(surprise, LARGEST_SURPRISE)

    def share(self, points: int) -> int:
        """Of each look, so that several take no longer than one."""
        return max(points // len(self.looks), FEWEST_POINTS)


def _place(points_m: Float[np.ndarray, "k 3 n"]) -> Float[np.ndarray, "k 3"]:
    """The middle of the box across the view, and its nearest depth."""
    low, high = points_m.min(axis=2).astype(float), points_m.max(axis=2).astype(float)
    return np.concatenate([(low[:, :2] + high[:, :2]) / 2, low[:, 2:]], axis=1)


def distinct(R: Float[np.ndarray, "k 3 3"], score: Float[np.ndarray, " k"], most: int, apart_rad: float) -> np.ndarray:
    """Indices of the best that are farther apart than an angle, best first."""
    order = np.argsort(-score, kind="stable")
    flat = R.reshape(-1, 9)[order].astype(np.float32)
    near = np.float32(1 + 2 * np.cos(apart_rad))  # of the trace
    free = np.ones(len(order), bool)
    chosen: list[int] = []
    while len(chosen) < most and free.any():
        first = int(np.argmax(free))
        chosen.append(first)
        free &= flat @ flat[first] < near
        free[first] = False
    return order[chosen]


def descend(
    problem: Problem, hypotheses: Hypotheses, tolerances: Sequence[float], points: int, turn: bool = True
) -> Hypotheses:
    """One Gauss-Newton step for each tolerance (in sizes), on so many points of each image.

    ``turn``: False keeps the rotations.
    """
    for tolerance in tolerances:
        H, g = normal_equations(problem, hypotheses, tolerance, points)
        if not turn:
            H[:, :3], H[:, :, :3], g[:, :3] = 0, 0, 0
        diagonal = np.einsum("kii->ki", H)
        damping = DAMPING * diagonal + 1e-3 * diagonal.mean(axis=1, keepdims=True) + 1e-12
        step = -np.linalg.solve(H + damping[:, :, None] * np.eye(6), g[:, :, None])[:, :, 0]
        half = problem.frame.size_m / 2
        rotvec, shift = (
            part * np.minimum(1, limit / np.maximum(np.linalg.norm(part, axis=1, keepdims=True), 1e-12))
            for part, limit in ((step[:, :3], LONGEST_TURN_RAD), (step[:, 3:], LONGEST_SHIFT))
        )
        hypotheses = _perturbed(problem.frame, hypotheses, so3.exp(rotvec), shift * half)
    return hypotheses


def normal_equations(
    problem: Problem, hypotheses: Hypotheses, tolerance: float, points: int
) -> tuple[Float[np.ndarray, "k 6 6"], Float[np.ndarray, "k 6"]]:
    """Of the robust squares and the prior: a turn about the centre (rad) and a shift (half sizes), on the left."""
    frame = problem.frame
    total = np.zeros((len(hypotheses), 7, 7))
    shared = problem.share(points)
    for look in problem.looks:
        for batch in batches(len(hypotheses), 2 * shared):
            total[batch] += _moments(look, problem.goal, hypotheses[batch], frame, tolerance * frame.size_m, shared)
    total *= INDEPENDENT / len(problem.looks) / (tolerance * frame.size_m) ** 2
    H, g = total[:, :6, :6].copy(), total[:, :6, 6].copy()
    if frame.pivot_known:
        information, moved_m = frame.prior(hypotheses.R, hypotheses.t_m)
        half = frame.size_m / 2
        H[:, 3:, 3:] += information * half**2
        g[:, 3:] += (information @ moved_m[:, :, None])[:, :, 0] * half
    return H, g


def _moments(
    look: Look, goal: Surface, hypotheses: Hypotheses, frame: Frame, tolerance_m: float, points: int
) -> Float[np.ndarray, "k 7 7"]:
    """Weighted products of the Jacobian's columns and the residual, summed over the points of both images."""
    then = hypotheses.after(look.R_now_then, look.t_now_then_m)
    R, t = then.R.astype(np.float32), then.t_m.astype(np.float32)
    R_back = np.ascontiguousarray(np.swapaxes(R, 1, 2))
    mine, theirs = look.surface.sample(points), goal.sample(points)
    n, m = mine.shape[1], theirs.shape[1]
    forward = moved(R, t, mine)
    backward = moved(R_back, -(R_back @ t[:, :, None])[:, :, 0], theirs)
    J = np.empty((len(R), 7, n + m), np.float32)
    weight = np.empty((len(R), n + m), np.float32)
    J[:, 6, :n], weight[:, :n], J[:, 3:6, :n] = _residuals(goal, forward, tolerance_m)
    J[:, 6, n:], weight[:, n:], normal = _residuals(look.surface, backward, tolerance_m)
    J[:, 3:6, n:] = -(R @ normal)  # moving the goal's point back is moving the plane forth
    lever = np.concatenate([forward, np.broadcast_to(theirs, (len(R), 3, m))], axis=2)
    lever -= frame.center_m.astype(np.float32)[:, None]
    x, y, z = np.moveaxis(lever, 1, 0)
    nx, ny, nz = J[:, 3], J[:, 4], J[:, 5]
    J[:, 0], J[:, 1], J[:, 2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
    J[:, 3:6] *= np.float32(frame.size_m / 2)
    weight[:, :n] /= n
    weight[:, n:] /= m
    return (J * weight[:, None]) @ np.swapaxes(J, 1, 2)


def _residuals(
    view: Surface, x: Float[np.ndarray, "k 3 n"], tolerance_m: float
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"], Float[np.ndarray, "k 3 n"]]:
    """Distances of moved points from the planes they meet, their weights, and the planes' normals."""
    tolerance = np.float32(tolerance_m)
    place = view.pixels(x[:, 0], x[:, 1], x[:, 2])
    nx, ny, nz, offset_m = view.planes(place)
    residual = nx * x[:, 0]
    residual += ny * x[:, 1]
    residual += nz * x[:, 2]
    residual -= offset_m
    behind = x[:, 2] - view.surface_m(place)
    square = (residual / tolerance) ** 2
    bounded = 1 / (1 + square)  # Geman and McClure's, squared below; its root bounds the force, as Huber's does
    hidden = 1 / (1 + (np.maximum(behind, 0) / (HIDDEN_REACH * tolerance)) ** 2)
    against = np.where(behind < -NOWHERE_M / 2, OUTSIDE_WEIGHT, FRONT_WEIGHT) * np.sqrt(bounded)
    return residual, np.where(behind < -tolerance, against, bounded**2 * hidden), np.stack([nx, ny, nz], axis=1)


def scatter(
    problem: Problem,
    hypotheses: Hypotheses,
    rng: Generator,
    copies: int,
    turn_rad: float,
    shift: float,
    tolerance: float,
    points: int,
) -> Hypotheses:
    """Each hypothesis, or the best of its randomly perturbed copies where that agrees better.

    ``turn_rad`` and ``shift`` (in sizes) are root mean squares.
    """
    k = len(hypotheses)
    turn = rng.standard_normal((copies, 3)) * (turn_rad / np.sqrt(3))
    away = rng.standard_normal((copies, 3)) * (shift * problem.frame.size_m / np.sqrt(3))
    turn[0], away[0] = 0, 0
    repeated = hypotheses[np.repeat(np.arange(k), copies)]
    tried = _perturbed(problem.frame, repeated, so3.exp(np.tile(turn, (k, 1))), np.tile(away, (k, 1)))
    score = problem.score(tried, tolerance, points).reshape(k, copies)
    return tried[np.arange(k) * copies + np.argmax(score, axis=1)]


def _perturbed(
    frame: Frame, hypotheses: Hypotheses, turn: Float[np.ndarray, "k 3 3"], shift_m: Float[np.ndarray, "k 3"]
) -> Hypotheses:
    """Turned about the frame's centre and shifted, on the left."""
    t_m = (turn @ (hypotheses.t_m - frame.center_m)[:, :, None])[:, :, 0] + frame.center_m + shift_m
    return Hypotheses(turn @ hypotheses.R, t_m)
