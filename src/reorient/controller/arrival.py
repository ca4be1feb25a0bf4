"""Whether what stands before the camera is the goal: does the goal look as like it as it looks like itself?

Two captures of one pose differ by noise, lost pixels and the gripper's shadow alone. Where the goal image differs from
them by more, it shows another side of the object: a false arrival, such as the back of a cupboard that looks much like
its front. So the object is its own yardstick, whatever the camera's noise and the object's shape are.

``likeness`` says that of one pose, by the share that fits. Between two poses that both fit, ``misfit`` decides, which
adds up how far each depth is off in units of the noise, and so sees differences that no single pixel shows. Of a pose
that is right, ``looseness_rad`` says how well the shape tells small turns.
"""

from collections.abc import Sequence
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from reorient import so3
from reorient.estimators.base import History, RotationEstimate
from reorient.imaging import DepthImage
from reorient.registration import DepthView, build_problem, fit_planes, measure_evidence, refine

POINTS = 1500  # of each image
MOST_CAPTURES = 4  # the latest
TOLERANCE = 0.012  # depth difference that still fits, in sizes
NEUTRAL, UNIT = (
    -0.06,
    0.05,
)  # difference of fit, over misfit, that says nothing either way; that adds one to the log odds
LEAST_MISFIT = 0.05  # even where two captures fit all over
MOST = 6.0  # log odds that one place can add or take
STAYING_RAD = float(np.radians(15))
MOST_DEVIATIONS = 3.0  # that one depth counts as
SHIFT_PX = 0.6  # by which views may be misaligned: where depth is steep over pixels it says less
LEAST_NOISE = 0.001  # of depth, in sizes
MOST_TELLING = 6000  # returns that count: finer images show the same errors of alignment more often
PER_NAT = 370.0  # summed squares that are as telling as one nat: neighbours err alike, and alignment errs, too
ALIGNED_COS = np.cos(np.radians(20))
SETTLING = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.012, 0.012)  # tolerances of the steps of a guess, in sizes
SETTLING_FINE = (0.01, 0.008, 0.006)
SETTLING_POINTS = 600
MORE_OFF, MORE_MISSING = 0.03, 0.1  # shares by which a repeated view may differ more than two captures do
LOOSE_RAD = float(np.radians(0.85))  # standard error: with less, next to no final error is above 1 degree
ASIDE_RAD = float(np.radians(20))  # a turn about the loosest axis, either way, to see whether it shows
FREE_RAD, FREE_LOSS = (
    float(np.radians(20)),
    0.1,
)  # between the two, settled; agreement: unless they slide back or lose more


def likeness(captures: Sequence[DepthImage], goal: DepthImage, estimates: Sequence[RotationEstimate]) -> float:
    """Log odds that a pose is the goal's, from two or more captures of it, each with its estimate of what is missing.

    It rests on the share of points that fit: of the goal under the estimates, and of one capture on the next under what
    two estimates make of the motion between them, which should be none. So both bear the errors of estimates; of each
    the best counts, as a single estimate may be off by degrees.
    """
    views, target = [DepthView(image) for image in captures[-MOST_CAPTURES:]], DepthView(goal)
    tolerance_m = TOLERANCE * max(views[0].diameter_m, target.diameter_m)
    motions = [(x.R_goal_current, x.t_goal_current_m) for x in estimates[-MOST_CAPTURES:]]
    others = [
        max(measure_evidence(view, target, R, t_m, tolerance_m, POINTS).inlier_ratio for R, t_m in motions)
        for view in views
    ]
    between = [(Rb.T @ Ra, Rb.T @ (ta_m - tb_m)) for (Ra, ta_m), (Rb, tb_m) in permutations(motions, 2)]
    own = [
        max(measure_evidence(a, b, R, t_m, tolerance_m, POINTS).inlier_ratio for R, t_m in between)
        for a, b in pairwise(views)
    ]
    beyond = (np.mean(others) - np.mean(own)) / (1 + LEAST_MISFIT - np.mean(own))
    return float(np.clip((beyond - NEUTRAL) / UNIT, -MOST, MOST))


def misfit(captures: Sequence[DepthImage], goal: DepthImage, estimates: Sequence[RotationEstimate]) -> float:
    """How far the depths of a pose's captures (two or more) and of the goal are from each other, in nats a capture.

    What one pose has less than another, times the captures that each of them has, is how much likelier the goal shows
    it: the log of their odds. In place of an estimate from which this is not the pose another one's motion is taken.
    """
    target = DepthView(goal)
    views = [DepthView(image) for image in captures]
    noise_m = max(_noise_m(captures, views), LEAST_NOISE * target.diameter_m)
    motions = [(x.R_goal_current, x.t_goal_current_m) for x in estimates]
    near = [motion for motion in motions if float(so3.angle(motion[0])) <= STAYING_RAD] or [_settled(captures[0], goal)]
    motions = [motion if float(so3.angle(motion[0])) <= STAYING_RAD else near[0] for motion in motions]
    shown = _squares(goal, views, [(R.T, -R.T @ t_m) for R, t_m in motions], noise_m)
    seen = [_squares(image, [target], [motion], noise_m) for image, motion in zip(captures, motions, strict=True)]
    return float(min(len(target.points_m), MOST_TELLING) * (shown + np.mean(seen)) / 2 / PER_NAT)


def looseness_rad(captures: Sequence[DepthImage], goal: DepthImage, estimates: Sequence[RotationEstimate]) -> float:
    """Of a pose that may be the goal's: the standard error about the axis that its shape tells worst, by the estimates'
    own covariance. Zero if it is small, if no estimate has one, and where the goal shows the same whatever the turn
    about that axis, as for a body of revolution."""
    told = [np.linalg.eigh(x.covariance_rad2) for x in estimates if x.covariance_rad2 is not None]
    if not told:
        return 0.0
    variances, axes = sorted(told, key=lambda x: float(x[0][-1]))[len(told) // 2]
    error_rad = float(np.sqrt(variances[-1]))
    return 0.0 if error_rad <= LOOSE_RAD or _turns_freely(captures[-1], goal, axes[:, -1]) else error_rad


def _turns_freely(capture: DepthImage, goal: DepthImage, axis: Float[np.ndarray, "3"]) -> bool:
    """Whether a capture of the goal's pose, turned about an axis either way, stays turned and matches as well."""
    problem = build_problem(capture, goal, None)
    R = so3.exp(np.array([[0.0], [ASIDE_RAD], [-ASIDE_RAD]]) * axis)
    settled = refine(problem, problem.start(R), SETTLING, SETTLING_POINTS)
    agreement, turned = problem.image_score(settled, TOLERANCE, POINTS), so3.log(settled.R) @ axis
    return bool(turned[1] - turned[2] >= FREE_RAD and agreement[0] - agreement[1:].min() <= FREE_LOSS)


def _settled(image: DepthImage, other: DepthImage) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """The small motion that takes one image to another of nearly the same pose."""
    problem = build_problem(image, other, None)
    stay = np.eye(3)[None]
    settled = refine(problem, problem.start(stay), (*SETTLING, *SETTLING_FINE), SETTLING_POINTS)
    return settled.R[0], settled.t_m[0]


def _noise_m(captures: Sequence[DepthImage], views: Sequence[DepthView]) -> float:
    """Standard deviation of one capture's depths, from pairs of captures of one pose."""
    deviations = []
    for image, view in zip(captures, views[1:], strict=False):
        warped = view.warp(image.points().T)
        on = ~warped.silhouette_violation()
        if on.any():
            deviations.append(np.median(np.abs(warped.difference_m[on])) / 0.6745 / np.sqrt(2))
    return float(np.mean(deviations)) if deviations else 0.0


def _squares(
    image: DepthImage, views: Sequence[DepthView], motions: Sequence[tuple[np.ndarray, np.ndarray]], noise_m: float
) -> float:
    """Mean over an image's returns of their squared depth differences to views, in variances; for what no view shows,
    the most."""
    points_m = image.points()
    deviation_m = np.hypot(np.sqrt(2) * noise_m, SHIFT_PX * _steep_m(image))
    total, count = np.zeros(len(points_m)), np.zeros(len(points_m))
    for view, (R, t_m) in zip(views, motions, strict=True):
        warped = view.warp((points_m @ R.T + t_m).T)
        on, dz_m = ~warped.silhouette_violation(), warped.difference_m
        total[on] += np.minimum((dz_m[on] / deviation_m[on]) ** 2, MOST_DEVIATIONS**2)
        count += on
    return float(np.mean(np.where(count > 0, total / np.maximum(count, 1), MOST_DEVIATIONS**2)))


def repeats(image: DepthImage, other: DepthImage, captures: Sequence[DepthImage]) -> bool:
    """Whether two images show the same view of an object, nearly as well as two captures of one pose do."""
    R, t_m = _settled(image, other)
    if float(so3.angle(R)) > STAYING_RAD:
        return False
    tolerance_m = TOLERANCE * DepthView(captures[0]).diameter_m
    off, missing = np.subtract(
        _differing(image, other, R, t_m, tolerance_m),
        _differing(captures[0], captures[1], np.eye(3), np.zeros(3), tolerance_m),
    )
    return bool(off < MORE_OFF and missing < MORE_MISSING)


def _differing(
    image: DepthImage,
    other: DepthImage,
    R: Float[np.ndarray, "3 3"],
    t_m: Float[np.ndarray, "3"],
    tolerance_m: float,
) -> Float[np.ndarray, "2"]:
    """Of both images the share of returns that are off by more than a tolerance (which grows where depth is steep),
    and of those that the other does not show."""
    shares = []
    for one, view, turn, shift_m in ((image, DepthView(other), R, t_m), (other, DepthView(image), R.T, -R.T @ t_m)):
        warped = view.warp((one.points() @ turn.T + shift_m).T)
        missed = warped.silhouette_violation()
        off = ~missed & (np.abs(warped.difference_m) > np.hypot(tolerance_m, _steep_m(one)))
        shares.append((off.mean(), missed.mean()))
    return np.mean(shares, axis=0)


def _steep_m(image: DepthImage) -> Float[np.ndarray, " n"]:
    """By how much depth changes over a pixel at each return, row by row."""
    highest = ndimage.maximum_filter(np.where(image.valid, image.depth_m, -np.inf), 3)
    lowest = ndimage.minimum_filter(np.where(image.valid, image.depth_m, np.inf), 3)
    return (highest[image.valid] - lowest[image.valid]) / 2


def half_turns(
    capture: DepthImage, goal: DepthImage, history: History = ()
) -> list[tuple[Float[np.ndarray, "3 3"], float]]:
    """Of a pose that may be the goal's: half turns about the axes of what is seen, each settled into place, with the
    agreement with the goal that is lost where it, and not staying, leads there.

    ``history``: earlier captures, each with R_now_then. What no capture shows, no guess can be blamed for: a small loss
    means that the turned object may look like the goal, too, not that it does.
    """
    problem = build_problem(capture, goal, None, history)
    R = np.concatenate([np.eye(3)[None], so3.exp(np.pi * upright_axes(capture))])
    settled = refine(problem, problem.start(R), SETTLING, SETTLING_POINTS)
    agreement = problem.image_score(settled, TOLERANCE, POINTS)
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
