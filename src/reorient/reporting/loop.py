"""A closed loop, or a single estimate, as one interactive page; a loop as an animation, too."""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from reorient import so3
from reorient.controller import OrientResult, Step
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.extras import extras_named
from reorient.formatting import FigureFormat, format_number, format_probability, format_share
from reorient.imaging import DepthImage
from reorient.registration import DepthView
from reorient.registration.evidence import Evidence
from reorient.reporting.growing_curve import growing_curve
from reorient.reporting.page import inline_image, part, table, write_page
from reorient.reporting.pictures import depth_range, framed, montage, shade, write_gif
from reorient.reporting.scenes import CLASSES, Compared, at_most, class_data, hypothesis_data, image_data

_PANEL_PX = 256
_FRAME_MS, _LAST_FRAME_MS = 160, 2500
_FILM_MS = 6000  # a short loop is shown more slowly, to last this long
_HELP = "Drag to rotate, wheel or two fingers to zoom, click an alternative to compare it."


def write_loop(
    folder: str | Path,
    goal: DepthImage,
    result: OrientResult,
    errors_deg: Sequence[float],
    title: str,
    figure: FigureFormat | None = None,
) -> list[Path]:
    """Write ``loop.gif`` (goal, current image, remaining angle) and ``loop.html`` into a folder, and with ``figure``
    the curve of the remaining angle in that format; returns the paths.

    ``errors_deg``: the true remaining angle at each step's image, then, if there was a last move, after it; empty where
    the true orientation is unknown. Raises ReorientError for a loop without a step and for another number of errors.
    """
    steps = result.steps
    if not steps:
        raise ReorientError(f"a loop without a step ({result.reason}): expected at least one image to show")
    if len(errors_deg) not in (0, len(steps), len(steps) + 1):
        raise ReorientError(f"{len(errors_deg)} errors for {len(steps)} steps: expected one for each image, or none")
    images = framed([goal, *(step.image for step in steps)])
    gif = _write_gif(Path(folder) / "loop.gif", images, steps, errors_deg)
    animation = "data:image/gif;base64," + base64.b64encode(gif.read_bytes()).decode()
    alt = f"animation of the loop: the goal, the current image at each of {len(steps)} images, the remaining angle"
    sections = {
        "3D view": part("view", _HELP),
        "Remaining angle": part("curve"),
        "Images": part("images"),
        "Decisions": _decisions(result),
        "Steps": _table(steps, errors_deg),
        "Animation": f"<details><summary>show</summary>{inline_image(animation, alt, kind='dark')}</details>",
    }
    data = {"loop": loop_data(images[0], images[1:], result, errors_deg)}
    written = [gif, write_page(Path(folder) / "loop.html", title, outcome(result, errors_deg), sections, data)]
    if figure is not None:
        with extras_named():
            from reorient.reporting.loop_figures import loop_curve
            from reorient.reporting.style import write_figure
        curve = loop_curve([np.degrees(step.estimate.angle_rad) for step in steps], errors_deg)
        written.append(write_figure(curve, Path(folder) / f"remaining-angle.{figure}"))
    return written


def loop_data(
    goal: DepthImage, images: Sequence[DepthImage], result: OrientResult, errors_deg: Sequence[float]
) -> dict[str, Any]:
    """What the page shows of a loop, as JSON. ``images``: those of the steps, cropped as the goal is."""
    small = at_most(goal)
    view = DepthView(small)
    steps = []
    for step, image in zip(result.steps, images, strict=True):
        steps.append(
            _pair_data(small, view, image, step.estimate)
            | {
                "index": step.index,
                "true_deg": round(float(errors_deg[step.index]), 4) if errors_deg else None,
                "message": step.message,
                "status": _status(step, result),
                "belief": [_believed(R, log_odds) for R, log_odds in step.hypotheses],
            }
        )
    after = round(float(errors_deg[-1]), 4) if len(errors_deg) > len(steps) else None
    return {"goal": image_data(small), "steps": steps, "classes": class_data(), "end_deg": after}


def write_estimate(path: Path, current: DepthImage, goal: DepthImage, estimate: RotationEstimate, title: str) -> Path:
    """Write an estimate as a page; returns its path. Raises ReorientError where it cannot be written."""
    images = framed([goal, current])
    small = at_most(images[0])
    step = _pair_data(small, DepthView(small), images[1], estimate) | {
        "index": 0,
        "true_deg": None,
        "message": " ".join(estimate.warnings),
        "status": "",
        "belief": [],
    }
    headings = ["hypothesis", "angle", "axis", "probability", *(each.label for each in CLASSES)]
    lines = [
        [
            each["label"],
            f"{each['angle_deg']:.2f}°",
            f"[{' '.join(f'{x:z.3f}' for x in each['axis'])}]",
            format_probability(each["probability"]),
            *map(format_share, each["shares"]),
        ]
        for each in step["hypotheses"]
    ]
    confidence = "not calibrated" if estimate.confidence is None else format_probability(estimate.confidence)
    lead = (
        f"The object is to be rotated by {np.degrees(estimate.angle_rad):.2f} deg; confidence {confidence}. "
        + evidence_in_words(estimate.evidence).capitalize()
        + "."
    )
    sections = {
        "3D view": part("view", _HELP),
        "Images": part("images"),
        "Hypotheses": table(headings, lines, {0}, "hypotheses"),
    }
    loop = {"goal": image_data(small), "steps": [step], "classes": class_data(), "end_deg": None}
    return write_page(path, title, lead, sections, {"loop": loop})


def outcome(result: OrientResult, errors_deg: Sequence[float]) -> str:
    """How the loop ended, in a sentence or two."""
    sentence = f"{result.status.replace('_', ' ').capitalize()} after {_in_words(result.moves)}: {result.reason}."
    if errors_deg:
        sentence += f" The true remaining angle went from {errors_deg[0]:.2f} to {errors_deg[-1]:.2f} deg."
    return sentence


def evidence_in_words(evidence: Evidence) -> str:
    """The evidence of an estimate, in one line."""
    violations = format_share(evidence.free_space_violation + evidence.silhouette_violation)
    line = (
        f"inliers {format_share(evidence.inlier_ratio)} ({format_share(evidence.covisible_inlier_ratio)} of co-visible "
        f"points), violations {violations}, occluded {format_share(evidence.occluded)}, residual "
        f"{format_number(1000 * evidence.residual_m, 1)} mm"
    )
    return line if evidence.converged is not False else line + "; registration not converged"


def _in_words(moves: int) -> str:
    return f"{moves} move" + "s" * (moves != 1)


def _write_gif(path: Path, images: Sequence[DepthImage], steps: Sequence[Step], errors_deg: Sequence[float]) -> Path:
    range_m = depth_range(images)
    goal, *pictures = (shade(image, _PANEL_PX, range_m) for image in images)
    curves = growing_curve([np.degrees(step.estimate.angle_rad) for step in steps], errors_deg, _PANEL_PX)
    frames = [
        montage([goal, picture, curve], 3, ["goal", "current", f"after {_in_words(moves)}" if moves else "start"])
        for moves, picture, curve in zip(_moves_before(steps), pictures, curves, strict=True)
    ]
    write_gif(path, frames, max(_FRAME_MS, _FILM_MS // len(frames)), _LAST_FRAME_MS)
    return path


def _pair_data(goal: DepthImage, view: DepthView, image: DepthImage, estimate: RotationEstimate) -> dict[str, Any]:
    """The image and the hypotheses of an estimate, as JSON."""
    small = at_most(image)
    return {
        "image": image_data(small),
        "estimated_deg": round(float(np.degrees(estimate.angle_rad)), 4),
        "confidence": estimate.confidence,
        "hypotheses": [hypothesis_data(each) for each in Compared(small, goal, view).of(estimate)],
    }


def _believed(R: np.ndarray, log_odds: float) -> dict[str, Any]:
    """A hypothesis of the strategy's belief, as JSON."""
    axis = so3.quat_axis(so3.quat_from_matrix(R))
    return {
        "axis": [round(float(x), 4) for x in axis],
        "angle_deg": round(float(np.degrees(so3.angle(R))), 3),
        "probability": round(float(1 / (1 + np.exp(-log_odds))), 4),
    }


def _status(step: Step, result: OrientResult) -> str:
    """What became of a step, in a word or two."""
    if step.error:
        return step.error
    if step.undone:
        return "moved and undone"
    if step.R_executed is not None:
        return f"moved by {np.degrees(so3.angle(step.R_executed)):.1f} deg"
    return result.status.replace("_", " ") if step.index == len(result.steps) - 1 else "captured again"


def _moves_before(steps: Sequence[Step]) -> list[int]:
    """Number of moves before each image."""
    return [sum(step.moves for step in steps[:k]) for k in range(len(steps))]


def _decisions(result: OrientResult) -> str:
    """The decision at each image, and the errors of the loop."""
    lines = "".join(f"<li>{escape(step.message)}</li>" for step in result.steps)
    errors = "".join(f"<li>{escape(error)}</li>" for error in result.errors)
    below = f'<p class="note">Errors during the loop:</p><ul class="note">{errors}</ul>' if errors else ""
    return f'<ol start="0">{lines}</ol>{below}'


def _table(steps: Sequence[Step], errors_deg: Sequence[float]) -> str:
    headings = ["image", "estimated", *(["true"] if errors_deg else []), "commanded", "executed", "evidence"]
    lines = [
        [
            str(step.index),
            f"{np.degrees(step.estimate.angle_rad):.2f}°",
            *([f"{errors_deg[step.index]:.2f}°"] if errors_deg else []),
            _angle(step.R_step),
            _angle(step.R_executed),
            evidence_in_words(step.estimate.evidence),
        ]
        for step in steps
    ]
    return table(headings, lines, {len(headings) - 1}, "steps")


def _angle(R: np.ndarray | None) -> str:
    return "–" if R is None else f"{np.degrees(so3.angle(R)):.2f}°"
