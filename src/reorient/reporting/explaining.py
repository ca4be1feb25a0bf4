"""An estimate as a picture: both images, the motion between them, and every point that the evidence counts."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from reorient.estimators.base import RotationEstimate
from reorient.formatting import format_share
from reorient.imaging import Camera, DepthImage
from reorient.imaging.splatting import splat
from reorient.registration import (
    EVIDENCE_POINTS,
    DepthView,
    Evidence,
    inlier_tolerance_m,
    warp_both,
)
from reorient.reporting.pictures import BACKGROUND, INK, depth_range, framed, montage, shade, text_mask
from reorient.reporting.scenes import CLASSES, classes_of

POINT = 1 / 50  # width of a point, of a panel
DIMMED = 0.45  # brightness of the surface behind the points
MARGIN = 0.12  # around the object, of its width, so that points beside it show


@dataclass(frozen=True, eq=False)
class Panel:
    """The points of one image, warped into the view of the other."""

    image: DepthImage
    """The image of the view."""
    points_m: Float[np.ndarray, "n 3"]
    """The points, camera axes of the view."""
    classes: UInt8[np.ndarray, " n"]
    """Index of each point's class in ``CLASSES``."""


def classify(current: DepthImage, goal: DepthImage, estimate: RotationEstimate) -> tuple[Panel, Panel]:
    """The points of current in the goal's view, and those of goal in current's, as ``Evidence`` counts them."""
    views = DepthView(current), DepthView(goal)
    R, t_m = estimate.R_goal_current, estimate.t_goal_current_m
    tolerance_m = inlier_tolerance_m(*views)
    in_goal, in_current = warp_both(*views, R, t_m, EVIDENCE_POINTS)
    return (
        Panel(views[1].image, views[0].sample(EVIDENCE_POINTS).T @ R.T + t_m, classes_of(in_goal, tolerance_m)),
        Panel(views[0].image, (views[1].sample(EVIDENCE_POINTS).T - t_m) @ R, classes_of(in_current, tolerance_m)),
    )


def picture(current: DepthImage, goal: DepthImage, estimate: RotationEstimate, size_px: int = 256) -> Image.Image:
    """Current, goal, current moved by the estimate, and the points of each image in the other one's view.

    The points have the colours of their classes; the legend has the shares of the estimate's evidence.
    """
    moved = _moved(current.points() @ estimate.R_goal_current.T + estimate.t_goal_current_m, goal)
    windows = framed([current, goal, moved])
    range_m = depth_range(windows)
    panels = [shade(image, size_px, range_m) for image in windows]
    panels += [_draw(panel, size_px) for panel in classify(current, goal, estimate)]
    labels = ["current", "goal", "current, rotated", "current's points in goal", "goal's points in current"]
    sheet = montage(panels, len(panels), labels)
    return _with_legend(sheet, estimate.evidence, size_px)


def _moved(points_m: Float[np.ndarray, "n 3"], goal: DepthImage) -> DepthImage:
    """Depth of points in the goal's camera. A point covers its pixel and the next ones, which closes small holes."""
    corner_px = np.floor(goal.camera.project(points_m))
    uv_px = np.concatenate([corner_px + offset for offset in ((0, 0), (1, 0), (0, 1), (1, 1))])
    depth_m = splat(uv_px, np.tile(points_m[:, 2], 4), goal.depth_m.shape)
    return DepthImage(depth_m if depth_m.any() else goal.depth_m, goal.camera)


def _pixels(camera: Camera, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Whole pixels that points fall on; -1 for a point that projects nowhere."""
    pixel: np.ndarray = np.nan_to_num(np.floor(camera.project(points_m)), nan=-1.0, posinf=-1.0, neginf=-1.0)
    return pixel


def _draw(panel: Panel, size_px: int) -> Image.Image:
    """The dimmed surface of a view with the points on it."""
    height, width = panel.image.depth_m.shape
    side = round(max(height, width) * (1 + 2 * MARGIN))
    window = panel.image.cropped((width - side) // 2, (height - side) // 2, side, side)
    drawn = Image.blend(Image.new("RGB", (size_px, size_px), BACKGROUND), shade(window, size_px), DIMMED)
    pen, half = ImageDraw.Draw(drawn), max(size_px * POINT / 2, 1)
    for (u, v), index in zip(_pixels(window.camera, panel.points_m), panel.classes, strict=True):
        x, y = ((each + 0.5) * size_px / side for each in (u, v))
        pen.rectangle((x - half, y - half, x + half, y + half), CLASSES[index].colour)
    return drawn


def _with_legend(sheet: Image.Image, evidence: Evidence, size_px: int) -> Image.Image:
    """The sheet with a strip below it: the colour, the name and the share of each class."""
    height, text_px = size_px // 7, max(11, size_px // 17)
    extended = Image.new("RGB", (sheet.width, sheet.height + height), BACKGROUND)
    extended.paste(sheet)
    pen, width = ImageDraw.Draw(extended), sheet.width // len(CLASSES)
    for number, each in enumerate(CLASSES):
        left, top = number * width, sheet.height + (height - text_px) // 2
        pen.rectangle((left + text_px, top, left + 2 * text_px, top + text_px), each.colour)
        text = f"{each.label} {format_share(getattr(evidence, each.share))}"
        text_width = round(ImageFont.load_default(text_px).getlength(text)) + text_px
        extended.paste(INK, (left + 2 * text_px, sheet.height), text_mask(text, (text_width, height), text_px))
    return extended
