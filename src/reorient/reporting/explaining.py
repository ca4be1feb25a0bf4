"""An estimate in words and as a picture: how sure it is, what else it could be, where it fails."""

import numpy as np
from PIL import Image

from reorient import so3
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage
from reorient.reporting.pictures import BACKGROUND, depth_range, framed, montage, shade

FITS, IN_FRONT, OUTSIDE, BEHIND = (96, 178, 112), (226, 84, 70), (236, 160, 60), (92, 110, 150)
TOLERANCE = 0.02  # of the object's depth range and width, what still counts as the same surface
REVOLUTION_DEG = 20.0  # axes of alternatives that lie this near are one axis


def in_words(estimate: RotationEstimate) -> str:
    """How sure the estimate is, and what else may be meant, in one or two sentences."""
    if estimate.confidence is None:
        return "confidence is not calibrated for this estimator"
    said = f"{estimate.confidence:.0%} sure to be within 5 degrees of the goal, or of an orientation that looks like it"
    if not estimate.alternatives:
        return said
    turns = [so3.log(R @ estimate.R_goal_current.T) for R, _ in estimate.alternatives]
    degrees = [float(np.degrees(np.linalg.norm(turn))) for turn in turns]
    axes = np.stack([turn / max(float(np.linalg.norm(turn)), 1e-9) for turn in turns])
    axis = axes[0] if axes[0] @ axes.sum(axis=0) >= 0 else -axes[0]
    count = len(turns) + 1
    named = " ".join(f"{x:.2f}" for x in axis)
    alike = bool(np.all(np.abs(axes @ axes[0]) > np.cos(np.radians(REVOLUTION_DEG))))
    about = f" about [{named}] (camera axes, at the goal)" if alike else ""
    away = ", ".join(f"{x:.0f}" for x in sorted(degrees))
    first = float(np.clip(1 - sum(probability for _, probability in estimate.alternatives), 0, 1))
    chances = ", ".join(f"{p:.0%}" for p in [first, *(p for _, p in estimate.alternatives)])
    return (
        f"{said}; {count} orientations fit about equally well ({chances}): the object looks symmetric{about}, or the "
        f"views leave it open; the others are {away} degrees from the answer"
    )


def picture(current: DepthImage, goal: DepthImage, estimate: RotationEstimate, size_px: int = 256) -> Image.Image:
    """Current, goal, current turned by the answer, and where that disagrees with the goal, side by side.

    Green fits; red stands before the goal's surface, which the camera saw; orange falls outside the goal's outline;
    blue lies behind the surface, where it may be hidden.
    """
    points_m = current.points() @ estimate.R_goal_current.T + estimate.t_goal_current_m
    turned = _seen_by(goal, points_m)
    windows = framed([current, goal, turned])
    near_far = depth_range(windows)
    pictures = [shade(image, size_px, near_far) for image in windows]
    colours = _disagreement(windows[1], windows[2])
    verdict = Image.fromarray(colours).resize((size_px, size_px), Image.Resampling.NEAREST)
    return montage([*pictures, verdict], 4, ["current", "goal", "current, turned", "fits / before / outside / hidden"])


def _seen_by(goal: DepthImage, points_m: np.ndarray) -> DepthImage:
    """Points as the goal's camera sees them, the nearest of each pixel; small holes between them are closed."""
    depth_m: np.ndarray = np.full(goal.depth_m.shape, np.inf)
    pixel = np.nan_to_num(np.floor(goal.camera.project(points_m)), nan=-1.0).astype(int)
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):  # a point covers its pixel and the next
        u, v = pixel[:, 0] + column, pixel[:, 1] + row
        inside = (u >= 0) & (u < depth_m.shape[1]) & (v >= 0) & (v < depth_m.shape[0])
        np.minimum.at(depth_m, (v[inside], u[inside]), points_m[inside, 2])
    depth_m[np.isinf(depth_m)] = 0
    return DepthImage(depth_m if depth_m.any() else goal.depth_m, goal.camera)


def _disagreement(goal: DepthImage, turned: DepthImage) -> np.ndarray:
    """(h, w, 3) colours of the turned image's returns by what the goal says about them."""
    colours = np.full((*goal.depth_m.shape, 3), BACKGROUND, np.uint8)
    colours[goal.valid] = np.array(BACKGROUND) + 24  # the goal's outline, faintly
    seen = turned.valid
    depths = goal.depth_m[goal.valid]
    tolerance_m = TOLERANCE * max(float(np.ptp(np.percentile(depths, [1, 99]))), 0.1 * float(np.median(depths)))
    beyond = turned.depth_m - goal.depth_m
    colours[seen & ~goal.valid] = OUTSIDE
    colours[seen & goal.valid & (beyond < -tolerance_m)] = IN_FRONT
    colours[seen & goal.valid & (beyond > tolerance_m)] = BEHIND
    colours[seen & goal.valid & (np.abs(beyond) <= tolerance_m)] = FITS
    return colours
