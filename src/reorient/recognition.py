"""Whether what stands before the camera is the goal: does the goal look as like it as it looks like itself?

Two captures of one pose differ by noise, lost pixels and the gripper's shadow alone. Where the goal image differs from
them by more, it shows another side of the object: a false arrival, such as the back of a cupboard that looks much like
its front. So the object is its own yardstick, whatever the camera's noise and the object's shape are.
"""

from collections.abc import Sequence
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.depth import DepthImage
from reorient.estimators.base import History, RotationEstimate
from reorient.estimators.default import pose
from reorient.estimators.evidence import View, size_m, weigh
from reorient.estimators.refine import Hypotheses, descend
from reorient.planes import fit_planes

POINTS = 1500  # of each image
MOST_CAPTURES = 4  # the latest
TOLERANCE = 0.012  # depth difference that still fits, in sizes
NEUTRAL, UNIT = (
    -0.06,
    0.05,
)  # difference of fit, over misfit, that says nothing either way; that adds one to the log odds
LEAST_MISFIT = 0.05  # even where two captures fit all over
MOST = 6.0  # log odds that one place can add or take
ALIGNED_COS = np.cos(np.radians(20))
SETTLING = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.012, 0.012)  # tolerances of the steps of a guess, in sizes
SETTLING_POINTS = 600


def likeness(captures: Sequence[DepthImage], goal: DepthImage, estimates: Sequence[RotationEstimate]) -> float:
    """Log odds that a pose is the goal's, from two or more captures of it, each with its estimate of what is missing.

    It rests on the share of points that fit: of the goal under the estimates, and of one capture on the next under what
    two estimates make of the motion between them, which should be none. So both bear the errors of estimates; of each
    the best counts, as a single estimate may be off by degrees.
    """
    views, target = [View(image, POINTS) for image in captures[-MOST_CAPTURES:]], View(goal, POINTS)
    tolerance_m = TOLERANCE * max(size_m(views[0].all_points_m), size_m(target.all_points_m))
    motions = [(x.R_goal_current, x.t_goal_current_m) for x in estimates[-MOST_CAPTURES:]]
    others = [max(weigh(view, target, R, t_m, tolerance_m).fit for R, t_m in motions) for view in views]
    between = [(Rb.T @ Ra, Rb.T @ (ta_m - tb_m)) for (Ra, ta_m), (Rb, tb_m) in permutations(motions, 2)]
    own = [max(weigh(a, b, R, t_m, tolerance_m).fit for R, t_m in between) for a, b in pairwise(views)]
    beyond = (np.mean(others) - np.mean(own)) / (1 + LEAST_MISFIT - np.mean(own))
    return float(np.clip((beyond - NEUTRAL) / UNIT, -MOST, MOST))


def half_turns(
    capture: DepthImage, goal: DepthImage, history: History = ()
) -> list[tuple[Float[np.ndarray, "3 3"], float]]:
    """Of a pose that may be the goal's: half turns about the axes of what is seen, each settled into place, with the
    agreement with the goal that is lost where it, and not staying, leads there.

    ``history``: earlier captures, each with R_now_then. What no capture shows, no guess can be blamed for: a small loss
    means that the turned object may look like the goal, too, not that it does.
    """
    problem = pose(capture, goal, None, history)
    R = np.concatenate([np.eye(3)[None], so3.exp(np.pi * upright_axes(capture))])
    settled = descend(problem, Hypotheses(R, problem.start(R)), SETTLING, SETTLING_POINTS)
    agreement = problem.agreement(settled, TOLERANCE, POINTS)
    return list(zip(settled.R[1:], (agreement[0] - agreement[1:]).tolist(), strict=True))


def upright_axes(image: DepthImage) -> Float[np.ndarray, "3 3"]:
    """Three perpendicular axes (rows, camera axes) along which the visible surface faces most: of things that people
    make, often the axes of their near symmetries."""
    normals = fit_planes(image).normals.astype(float)
    facing = (np.abs(normals @ normals[:: max(1, len(normals) // 200)].T) > ALIGNED_COS).sum(axis=0)
    axes = [_mean_axis(normals, normals[:: max(1, len(normals) // 200)][np.argmax(facing)])]
    across = normals - (normals @ axes[0])[:, None] * axes[0]
    length = np.linalg.norm(across, axis=1)
    across = across[length > np.sin(np.radians(45))]
    if len(across) < 20:  # one plane is all that is seen: its longest extent
        points = image.points() - image.points().mean(axis=0)
        across = np.linalg.svd(points - (points @ axes[0])[:, None] * axes[0], full_matrices=False)[2][:1]
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    some = across[:: max(1, len(across) // 200)]
    axes.append(_mean_axis(across, some[np.argmax((np.abs(across @ some.T) > ALIGNED_COS).sum(axis=0))]))
    axes[1] = axes[1] - (axes[1] @ axes[0]) * axes[0]
    axes[1] /= np.linalg.norm(axes[1])
    return np.stack([*axes, np.cross(axes[0], axes[1])])


def _mean_axis(directions: Float[np.ndarray, "n 3"], axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Of the directions that are nearly along an axis, either way, the mean."""
    along = directions @ axis
    near = np.abs(along) > ALIGNED_COS
    mean = (directions[near] * np.sign(along[near])[:, None]).mean(axis=0)
    return mean / np.linalg.norm(mean)
