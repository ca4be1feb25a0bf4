"""Summary of closed loops: final errors, moves, loops that are unsure and loops that falsely converge."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.table import Table
from scipy.stats import binomtest

from reorient.experiments.loops import COLUMNS
from reorient.reporting.rows import numbers, read_table
from reorient.runs.run import Row

FALSE_DEG = 5.0  # a loop that converges with a larger symmetry-aware error converges falsely
HEADINGS = (
    *("start", "noise", "slack", "faults", "system", "loops", "median°", "p90°", "< 1° (95% interval)", "< 5°"),
    *("falsely converged", "unsure", "moves, median", "most", "images", "s"),
)
NOTE = (
    "Errors are symmetry-aware. Falsely converged: status converged, error above 5 degrees. Unsure: any other status. "
    "Both with their number and Wilson's 95% interval. s: mean processor time of a loop."
)
_WORDS = 5  # the first columns, set to the left


def read_loop_rows(folder: Path) -> list[Row]:
    """The rows of a run of ``reorient loops``. Raises ReorientError as ``read_table``."""
    return read_table(folder / "rows.csv.gz", COLUMNS)


def loop_table(rows: Sequence[Row]) -> Table:
    """One line for each start, noise and system, for the screen."""
    table = Table(title="closed loops", title_justify="left", header_style="bold", caption=NOTE, caption_justify="left")
    for index, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if index < _WORDS else "right")
    for line in _lines(rows):
        table.add_row(*line)
    return table


def markdown_loops(rows: Sequence[Row]) -> str:
    """The same table and its note in Markdown."""
    marks = ["---" if index < _WORDS else "---:" for index in range(len(HEADINGS))]
    return "\n".join(f"| {' | '.join(line)} |" for line in (HEADINGS, marks, *_lines(rows))) + f"\n\n{NOTE}\n"


def _lines(rows: Sequence[Row]) -> Iterator[list[str]]:
    def cell(row: Row) -> tuple[str, ...]:
        start = row["start_deg"] if row["start_deg"] == "any" else f"{row['start_deg']}°"
        system = f"{row['estimator']}/{row['strategy']}"
        return start, f"{row['noise_mm']} mm", f"{row['slack_deg']}°", row["faults"], system

    for words, group in groupby(sorted(rows, key=cell), key=cell):
        yield [*words, *_numbers(list(group))]


def _numbers(rows: Sequence[Row]) -> list[str]:
    error_deg, moves, images = (numbers(rows, column) for column in ("error_sym_deg", "moves", "images"))
    converged = np.array([row["status"] == "converged" for row in rows])
    return [
        str(len(rows)),
        f"{np.median(error_deg):.2f}",
        f"{np.percentile(error_deg, 90):.2f}",
        _share(error_deg < 1),
        f"{np.mean(error_deg < FALSE_DEG):.1%}",
        _counted(converged & (error_deg > FALSE_DEG)),
        _counted(~converged),
        f"{np.median(moves):g}",
        f"{moves.max():g}",
        f"{np.median(images):g}",
        f"{np.mean([float(row['seconds'] or 'nan') for row in rows]):.1f}",
    ]


def _share(hits: np.ndarray) -> str:
    """A share with its interval, in percent."""
    low, high = binomtest(int(hits.sum()), len(hits)).proportion_ci(method="wilson")
    return f"{hits.mean():.1%} ({100 * low:.1f}–{100 * high:.1f})"


def _counted(hits: np.ndarray) -> str:
    """A number, and its share with the interval."""
    return f"{hits.sum()}: {_share(hits)}"
