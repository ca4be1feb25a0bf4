"""The cell experiment: summaries of its raw rows, one page, and an animation of the arm rotating an object."""

import base64
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from reorient.errors import ReorientError
from reorient.experiments.cell import END
from reorient.experiments.cell_trials import Experiment, close_loop, stage
from reorient.formatting import FigureFormat
from reorient.perception.segmentation import object_mask
from reorient.reporting.loop import loop_data
from reorient.reporting.loop_figures import error_by_image, errors_by_object, growing_curve
from reorient.reporting.page import inline_image, part, table, write_page
from reorient.reporting.pictures import depth_range, framed, montage, png_data_uri, shade, show_mask, write_gif
from reorient.reporting.rows import read_table
from reorient.reporting.style import write_figure

PAPER_DEG = 4.2  # median of the paper's 50 physical trials
_PAPER = "paper's physical cell, 4.2° (other objects)"
_PANEL_PX, _FRAME_MS, _LAST_FRAME_MS = 300, 220, 2500
_WAYS = {
    "shape": "by the gripper's shape",
    "shape_coloured": "by the gripper's shape, filled by the object's colour",
    "colour": "by the gripper's colour (HSV), filled by the object's colour",
}
_MASKS = (
    "The object in the last image of that loop by each segmentation. Green: with a return of the depth camera; orange: "
    "without; black: pixels without a return that are not part of the object."
)


@dataclass(frozen=True)
class Loop:
    """One trial of one system from the raw rows. Angles in degrees."""

    object: str
    trial: int
    range_deg: tuple[float, float]
    system: str
    errors_deg: tuple[float, ...]
    """The true error at each image and, last, at the end; empty if the trial could not be set up."""
    moves: int
    reason: str


def read_loops(folder: Path) -> list[Loop]:
    """The loops of a run folder. Raises ReorientError if there are none."""
    keys = ("object", "trial", "low_deg", "high_deg", "estimator", "strategy")
    needed = (*keys, "image", "error_deg", "moves", "reason")
    loops = []
    for _, group in groupby(
        read_table(folder / "rows.csv.gz", needed), key=lambda row: tuple(row[key] for key in keys)
    ):
        rows = list(group)
        end = rows[-1]
        if end["image"] != END:
            raise ReorientError(f"rows of {str(folder)!r} break off: expected an {END!r} row after each loop")
        errors_deg = tuple(float(row["error_deg"]) for row in rows if row["error_deg"])
        loops.append(
            Loop(
                end["object"],
                int(end["trial"]),
                (float(end["low_deg"]), float(end["high_deg"])),
                f"{end['estimator']}/{end['strategy']}",
                errors_deg,
                int(end["moves"] or 0),
                end["reason"],
            )
        )
    return loops


HEADINGS = (
    *("start", "system", "trials", "median°", "mean°", "p90°", "< 1°", "< 2° (95% interval)", "< 5°", "> 30°"),
    *("moves, median", "most"),
)


def summary(loops: Sequence[Loop]) -> list[list[str]]:
    """The cells of one line, as in HEADINGS, for each range and system."""
    lines = []
    for limits, system in dict.fromkeys((loop.range_deg, loop.system) for loop in loops):
        mine = [loop for loop in loops if (loop.range_deg, loop.system) == (limits, system) and loop.errors_deg]
        if not mine:
            continue
        final = np.array([loop.errors_deg[-1] for loop in mine])
        moves = [loop.moves for loop in mine]
        low, high = binomtest(int(np.sum(final < 2)), len(final)).proportion_ci(method="wilson")
        lines.append(
            [
                _range(limits),
                system,
                str(len(mine)),
                *(f"{x:.2f}" for x in (np.median(final), final.mean(), np.percentile(final, 90))),
                f"{np.mean(final < 1):.0%}",
                f"{np.mean(final < 2):.0%} ({100 * low:.0f}–{100 * high:.0f})",
                f"{np.mean(final < 5):.0%}",
                f"{np.mean(final > 30):.0%}",
                f"{np.median(moves):g}",
                str(max(moves)),
            ]
        )
    return lines


def mask_summary(folder: Path) -> list[str]:
    """Accuracy of the masks, in sentences."""
    rows = (
        read_table(folder / "masks.csv.gz", ["iou_shape", "iou_shape_all"])
        if (folder / "masks.csv.gz").is_file()
        else []
    )
    sentences = []
    for name, words in _WAYS.items():
        column = f"iou_{name}"
        values = np.array([float(row[column]) for row in rows if row.get(column)])
        every = np.array([float(row[f"{column}_all"]) for row in rows if row.get(column)])
        if len(values):
            sentences.append(
                f"Masks {words}: IoU median {np.median(values):.3f}, p10 {np.percentile(values, 10):.3f} over the "
                f"{len(values)} goal and start images, over pixels with a return; over all pixels, with or without a "
                f"return, median {np.median(every):.3f}, "
                f"p10 {np.percentile(every, 10):.3f}."
            )
    return sentences


def print_summary(folder: Path) -> None:
    """Print the table and the accuracy of the masks."""
    loops = read_loops(folder)
    table = Table(header_style="bold")
    for index, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if index < 2 else "right", no_wrap=True)
    for line in summary(loops):
        table.add_row(*line)
    console = Console(width=max(Console().width, 130), markup=False, emoji=False)
    console.print(table)
    for sentence in [*mask_summary(folder), *_not_staged(loops)]:
        print(sentence)


def write_cell_report(config: Experiment, folder: Path) -> tuple[Path, Path]:
    """Write ``report.html`` and ``cell.gif`` into a run folder; returns both paths. Repeats one trial to show it."""
    loops = read_loops(folder)
    staged = [loop for loop in loops if loop.errors_deg]
    if not staged:
        raise ReorientError(f"no trial of {str(folder)!r} could be set up: expected starts within the arm's reach")
    names = list(dict.fromkeys(loop.object for loop in loops))
    # of the first trial the system with most moves
    first = [loop for loop in staged if (loop.object, loop.trial, loop.range_deg) == _trial(staged[0])]
    shown = max(first, key=lambda loop: loop.moves)
    gif, loop, masks = _show(config, shown, folder)
    notes = "".join(f'<p class="note">{escape(x)}</p>' for x in [*mask_summary(folder), *_not_staged(loops)])
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
        f"{len(names)} objects, {len({_trial(loop) for loop in staged})} trials, in a simulated cell: a YuMi arm with "
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
    limits = list(dict.fromkeys(loop.range_deg for loop in staged))
    systems = list(dict.fromkeys(loop.system for loop in staged))

    def errors(*cell: Any) -> list[Sequence[float]]:
        return [loop.errors_deg for loop in staged if (loop.range_deg, loop.system, loop.object)[: len(cell)] == cell]

    by_image = {f"start {_range(r)} away": {s: errors(r, s) for s in systems} for r in limits}
    by_object = {
        f"start {_range(r)} away": {
            s: [[course[-1] for course in errors(r, s, name)] for name in names] for s in systems
        }
        for r in limits
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
            "range": _range(loop.range_deg),
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


def _trial(loop: Loop) -> tuple[str, int, tuple[float, float]]:
    return loop.object, loop.trial, loop.range_deg


def _range(limits: tuple[float, float]) -> str:
    return f"{limits[0]:g}°" if limits[0] == limits[1] else f"{limits[0]:g}–{limits[1]:g}°"


def _caption(loop: Loop) -> str:
    return (
        f"<b>{escape(loop.object)}</b>, trial {loop.trial}, {escape(loop.system)}: from {loop.errors_deg[0]:.1f} to "
        f"{loop.errors_deg[-1]:.2f} degrees in {loop.moves} moves. {escape(loop.reason)}."
    )


def _not_staged(loops: Sequence[Loop]) -> list[str]:
    missing = {_trial(loop): loop.reason for loop in loops if not loop.errors_deg}
    return (
        [f"Excluded: {len(missing)} trials that could not be set up: {next(iter(missing.values()))}"] if missing else []
    )
