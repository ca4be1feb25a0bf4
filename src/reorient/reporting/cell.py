"""The cell experiment as one page, with an animation of the arm rotating an object; and figures."""

import base64
from collections.abc import Sequence
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from reorient.errors import ReorientError
from reorient.experiments.cell_trials import Experiment, close_loop, stage
from reorient.formatting import FigureFormat
from reorient.perception.segmentation import object_mask
from reorient.reporting.cell_rows import HEADINGS, Loop, mask_summary, not_staged, read_loops, summary
from reorient.reporting.growing_curve import growing_curve
from reorient.reporting.loop import loop_data
from reorient.reporting.loop_figures import error_by_image, errors_by_object
from reorient.reporting.page import inline_image, part, table, write_page
from reorient.reporting.pictures import depth_range, framed, montage, png_data_uri, shade, show_mask, write_gif
from reorient.reporting.style import write_figure

PAPER_DEG = 4.2  # median of the paper's 50 physical trials
_PAPER = "paper's physical cell, 4.2° (other objects)"
_PANEL_PX, _FRAME_MS, _LAST_FRAME_MS = 300, 220, 2500
_MASKS = (
    "The object in the last image of that loop by each segmentation. Green: with a return of the depth camera; orange: "
    "without; black: pixels without a return that are not part of the object."
)


def write_cell_report(config: Experiment, folder: Path) -> tuple[Path, Path]:
    """Write ``report.html`` and ``cell.gif`` into a run folder; returns both paths. Repeats one trial to show it."""
    loops = read_loops(folder)
    staged = [loop for loop in loops if loop.errors_deg]
    if not staged:
        raise ReorientError(f"no trial of {str(folder)!r} could be set up: expected starts within the arm's reach")
    names = list(dict.fromkeys(loop.object for loop in loops))
    # of the first trial the system with most moves
    first = [loop for loop in staged if loop.drawn == staged[0].drawn]
    shown = max(first, key=lambda loop: loop.moves)
    gif, loop, masks = _show(config, shown, folder)
    notes = "".join(f'<p class="note">{escape(x)}</p>' for x in [*mask_summary(folder), *not_staged(loops)])
    animation = "data:image/gif;base64," + base64.b64encode(gif.read_bytes()).decode()
    arm = inline_image(animation, "animation: the arm rotates the object to its goal", _caption(shown), kind="dark")
    sections = {
        "Final errors": table(HEADINGS, summary(loops), {0, 1}, "final errors") + notes,
        "Trials": part("trials", f"Choose a mark to see the course of its trial. Dotted: {_PAPER}."),
        "One loop in 3D": part("view", f"{shown.object}, trial {shown.trial}, {shown.system}."),
        "Its remaining angle": part("curve"),
        "Its images": part("images"),
        "Masks": inline_image(masks, "the object in the last image, by each segmentation", _MASKS, kind="dark")
        if masks
        else "<p>The object is not visible at the end of that loop.</p>",
        "The arm": f"<details><summary>show</summary>{arm}</details>",
    }
    lead = (
        f"{len(names)} objects, {len({loop.drawn for loop in staged})} trials, in a simulated cell: a YuMi arm with "
        "servo errors and backlash, a structured-light depth camera and a colour camera, both with calibration errors. "
        f"Depth noise {config.noise_mm:g} mm; the gripper is removed by its {config.segmentation}. Errors from the "
        "true state."
    )
    data = {"loop": loop, "cell": _trials(staged, names)}
    title = "Orienting held objects in a simulated cell"
    return write_page(folder / "report.html", title, lead, sections, data), gif


def write_cell_figures(folder: Path, suffix: FigureFormat) -> list[Path]:
    """Write the errors at each image and the final errors by object as figures for papers; returns their paths."""
    staged = [loop for loop in read_loops(folder) if loop.errors_deg]
    names = list(dict.fromkeys(loop.object for loop in staged))
    starts = list(dict.fromkeys(loop.start for loop in staged))
    systems = list(dict.fromkeys(loop.system for loop in staged))

    def errors(*cell: Any) -> list[Sequence[float]]:
        return [loop.errors_deg for loop in staged if (loop.start, loop.system, loop.object)[: len(cell)] == cell]

    by_image = {f"start {start} away": {s: errors(start, s) for s in systems} for start in starts}
    by_object = {
        f"start {start} away": {
            s: [[course[-1] for course in errors(start, s, name)] for name in names] for s in systems
        }
        for start in starts
    }
    short = [name.rsplit("_", 1)[0].split("__")[-1] for name in names]
    drawn = {
        "error-by-image": error_by_image(by_image, PAPER_DEG, _PAPER),
        "errors-by-object": errors_by_object(by_object, short, PAPER_DEG, _PAPER),
    }
    return [write_figure(figure, folder / f"{name}.{suffix}") for name, figure in drawn.items()]


def _trials(staged: Sequence[Loop], names: Sequence[str]) -> dict[str, Any]:
    """The course of each trial, as JSON."""
    systems = list(dict.fromkeys(loop.system for loop in staged))
    trials = [
        {
            "object": names.index(loop.object),
            "trial": loop.trial,
            "range": loop.start,
            "system": systems.index(loop.system),
            "errors": [round(error, 4) for error in loop.errors_deg],
            "moves": loop.moves,
            "reason": loop.reason,
        }
        for loop in staged
    ]
    return {"systems": systems, "objects": list(names), "trials": trials, "level": PAPER_DEG}


def _show(config: Experiment, loop: Loop, folder: Path) -> tuple[Path, dict[str, Any], str]:
    """Repeat a loop; its animation, what the page shows of it, and as a data URI the masks after its end."""
    from reorient.stations.cell.scene import observer

    staged = stage(config, loop.object, loop.trial, loop.range_deg)
    plant = staged.cell.plant
    camera = observer(plant.tool_m, _PANEL_PX)

    def view() -> Image.Image:
        return Image.fromarray(plant.scene().color(camera, camera.camera).rgb)

    views = [view()]
    result, errors_deg = close_loop(config, staged, loop.system, (lambda step: views.append(view()),))
    images = [staged.goal, *(step.image for step in result.steps)]
    range_m = depth_range(images)
    goal, *seen = (shade(image, _PANEL_PX, range_m) for image in images)
    predicted_deg = [float(np.degrees(step.estimate.angle_rad)) for step in result.steps]
    curves = growing_curve(predicted_deg, errors_deg[: len(seen)], _PANEL_PX)
    frames = [
        montage([cell, curve, goal, picture], 2, ["the cell", f"image {index + 1}", "goal", "now"])
        for index, (cell, curve, picture) in enumerate(zip(views, curves, seen, strict=False))
    ]
    gif = folder / "cell.gif"
    write_gif(gif, frames, _FRAME_MS, _LAST_FRAME_MS)
    window = framed(images)
    return gif, loop_data(window[0], window[1:], result, errors_deg), _masks(staged.cell)


def _masks(cell: Any) -> str:
    """The present masks of the object by each segmentation, as a data URI; empty if none finds the object."""
    frame = cell.frame(colour="colour" in cell.segmentations)
    pictures = {}
    for name, segmentation in cell.segmentations.items():
        with suppress(ReorientError):
            mask = object_mask(frame, cell.calibration, segmentation)
            pictures[f"by {name}"] = show_mask(frame.depth, mask, _PANEL_PX)
    return png_data_uri(montage([*pictures.values()], len(pictures), [*pictures])) if pictures else ""


def _caption(loop: Loop) -> str:
    return (
        f"<b>{escape(loop.object)}</b>, trial {loop.trial}, {escape(loop.system)}: from {loop.errors_deg[0]:.1f} to "
        f"{loop.errors_deg[-1]:.2f} degrees in {loop.moves} moves. {escape(loop.reason)}."
    )
