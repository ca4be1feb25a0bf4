"""A closed loop as an animation and as one page."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from reorient import so3
from reorient.controller import OrientResult, Step
from reorient.errors import ReorientError
from reorient.formatting import format_number, format_share
from reorient.imaging import DepthImage
from reorient.registration.evidence import Evidence
from reorient.reporting.loop_figures import growing_curve, loop_curve
from reorient.reporting.page import inline_image, page
from reorient.reporting.pictures import depth_range, framed, montage, png_data_uri, shade, write_gif
from reorient.runs.files import replacing

_PANEL_PX, _STILL_PX = 256, 352
_FRAME_MS, _LAST_FRAME_MS = 160, 2500
_FILM_MS = 6000  # a short loop is shown more slowly, to last this long


def write_loop(
    folder: str | Path, goal: DepthImage, result: OrientResult, errors_deg: Sequence[float], title: str
) -> tuple[Path, Path]:
    """Write ``loop.gif`` (goal, current image, remaining angle) and ``loop.html`` into a folder; returns both paths.

    ``errors_deg``: the true remaining angle at each step's image, then, if there was a last move, after it; empty where
    the true orientation is unknown. Raises ReorientError for a loop without a step and for another number of errors.
    """
    steps = result.steps
    if not steps:
        raise ReorientError(f"a loop without a step ({result.reason}): expected at least one image to show")
    if len(errors_deg) not in (0, len(steps), len(steps) + 1):
        raise ReorientError(f"{len(errors_deg)} errors for {len(steps)} steps: expected one for each image, or none")
    estimated_deg = [float(np.degrees(step.estimate.angle_rad)) for step in steps]
    images = framed([goal, *(step.image for step in steps)])
    range_m = depth_range(images)
    goal_picture, *pictures = (shade(image, _PANEL_PX, range_m) for image in images)
    curves = growing_curve(estimated_deg, errors_deg, _PANEL_PX)
    gif = Path(folder) / "loop.gif"
    frames = [
        montage([goal_picture, picture, curve], 3, ["goal", "current", f"after {moves} moves" if moves else "start"])
        for moves, picture, curve in zip(_moves_before(steps), pictures, curves, strict=True)
    ]
    write_gif(gif, frames, max(_FRAME_MS, _FILM_MS // len(frames)), _LAST_FRAME_MS)

    stills = [shade(images[index], _STILL_PX, range_m) for index in (1, 0, -1)]
    triptych = montage(stills, 3, ["start", "goal", "last image"])
    sections = {
        "Start, goal, last image": inline_image(png_data_uri(triptych), "start, goal and last image", dark=True),
        "Remaining angle": inline_image(loop_curve(estimated_deg, errors_deg), "remaining angle at each image"),
        "Decisions": _decisions(result),
        "Steps": _table(steps, errors_deg),
    }
    html = Path(folder) / "loop.html"
    with replacing(html) as temporary:
        temporary.write_text(page(title, outcome(result, errors_deg), sections), encoding="utf-8")
    return gif, html


def outcome(result: OrientResult, errors_deg: Sequence[float]) -> str:
    """How the loop ended, in a sentence or two."""
    moves = f"{result.moves} move" + "s" * (result.moves != 1)
    sentence = f"{result.status.replace('_', ' ').capitalize()} after {moves}: {result.reason}."
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
    heads = ["image", "estimated", *(["true"] if errors_deg else []), "commanded", "executed"]
    lines = []
    for step in steps:
        angles_deg = [float(np.degrees(step.estimate.angle_rad))]
        if errors_deg:
            angles_deg.append(errors_deg[step.index])
        cells = [
            str(step.index),
            *(f"{angle:.2f}°" for angle in angles_deg),
            _angle(step.R_step),
            _angle(step.R_executed),
        ]
        numbers = "".join(f"<td>{cell}</td>" for cell in cells)
        lines.append(f'<tr>{numbers}<td class="word">{escape(evidence_in_words(step.estimate.evidence))}</td></tr>')
    head = "".join(f"<th>{heading}</th>" for heading in heads) + '<th class="word">evidence</th>'
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'


def _angle(R: np.ndarray | None) -> str:
    return "–" if R is None else f"{np.degrees(so3.angle(R)):.2f}°"
