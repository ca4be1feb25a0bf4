"""The raw rows of the cell experiment: loops, and their summaries."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from reorient.errors import ReorientError
from reorient.experiments.cell import END
from reorient.reporting.rows import read_table

_WAYS = {
    "shape": "by the gripper's shape",
    "shape_coloured": "by the gripper's shape, filled by the object's colour",
    "colour": "by the gripper's colour (HSV), filled by the object's colour",
}


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

    @property
    def drawn(self) -> tuple[str, int, tuple[float, float]]:
        """The trial, which all systems share."""
        return self.object, self.trial, self.range_deg

    @property
    def start(self) -> str:
        """The range of the angle at the start, in words."""
        low, high = self.range_deg
        return f"{low:g}°" if low == high else f"{low:g}–{high:g}°"


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
                mine[0].start,
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
    for sentence in [*mask_summary(folder), *not_staged(loops)]:
        print(sentence)


def not_staged(loops: Sequence[Loop]) -> list[str]:
    """A sentence about the trials that could not be set up, if there are any."""
    missing = {loop.drawn: loop.reason for loop in loops if not loop.errors_deg}
    return (
        [f"Excluded: {len(missing)} trials that could not be set up: {next(iter(missing.values()))}"] if missing else []
    )
