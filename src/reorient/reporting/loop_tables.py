"""Summary of closed loops: final errors, moves, loops that are unsure and loops that falsely converge."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from scipy.stats import binomtest

from reorient.experiments.loops import COLUMNS
from reorient.reporting.rows import numbers, read_table
from reorient.runs.run import Row

FALSE_DEG = 5.0  # a loop that converges with a larger symmetry-aware error converges falsely
HEADINGS = (
    *("start and conditions", "system", "loops", "median°", "< 1° (95% interval)", "falsely converged", "unsure"),
    *("moves, median", "most", "p90°", "< 5°", "images", "s"),
)
NOTE = (
    "Errors are symmetry-aware; intervals are Wilson's of 95%. Falsely converged: status converged, error above 5 "
    "degrees. Unsure: any other status. s: mean processor time of a loop."
)
_WORDS = 2  # the first columns, set to the left
_ON_SCREEN = 8  # columns that fit


def read_loop_rows(folder: Path) -> list[Row]:
    """The rows of a run of ``reorient loops``. Raises ReorientError as ``read_table`` and ``numbers``."""
    rows = read_table(folder / "rows.csv.gz", COLUMNS)
    for column in ("noise_mm", "slack_deg", "faults", "moves", "images", "error_sym_deg"):
        numbers(rows, column)
    numbers([row for row in rows if row["seconds"]], "seconds")
    return rows


def loop_table(rows: Sequence[Row]) -> Table:
    """One line for each start, condition and system; the columns that fit on the screen."""
    table = Table(
        title="closed loops",
        title_justify="left",
        caption=NOTE,
        caption_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for index, heading in enumerate(HEADINGS[:_ON_SCREEN]):
        table.add_column(heading, justify="left" if index < _WORDS else "right", overflow="fold")
    for line in _lines(rows):
        table.add_row(*line[:_ON_SCREEN])
    return table


def markdown_loops(rows: Sequence[Row]) -> str:
    """The whole table and its note in Markdown."""
    marks = ["---" if index < _WORDS else "---:" for index in range(len(HEADINGS))]
    return "\n".join(f"| {' | '.join(line)} |" for line in (HEADINGS, marks, *_lines(rows))) + f"\n\n{NOTE}\n"


def _lines(rows: Sequence[Row]) -> Iterator[list[str]]:
    def cell(row: Row) -> tuple[str, str]:
        conditions = [row["start_deg"] if row["start_deg"] == "any" else f"{row['start_deg']}°"]
        conditions += [f"{row['noise_mm']} mm"]
        conditions += [f"slack {row['slack_deg']}°"] * (row["slack_deg"] != "0")
        conditions += [f"faults {float(row['faults']):.0%}"] * (row["faults"] != "0")
        return ", ".join(conditions), f"{row['estimator']}/{row['strategy']}"

    for words, group in groupby(sorted(rows, key=cell), key=cell):
        yield [*words, *_numbers(list(group))]


def _numbers(rows: Sequence[Row]) -> list[str]:
    error_deg, moves, images = (numbers(rows, column) for column in ("error_sym_deg", "moves", "images"))
    converged = np.array([row["status"] == "converged" for row in rows])
    return [
        str(len(rows)),
        f"{np.median(error_deg):.2f}",
        f"{np.mean(error_deg < 1):.1%} ({_interval(error_deg < 1)})",
        *(f"{hits.sum()} ({_interval(hits)}%)" for hits in (converged & (error_deg > FALSE_DEG), ~converged)),
        f"{np.median(moves):g}",
        f"{moves.max():g}",
        f"{np.percentile(error_deg, 90):.2f}",
        f"{np.mean(error_deg < FALSE_DEG):.1%}",
        f"{np.median(images):g}",
        f"{np.mean([float(row['seconds'] or 'nan') for row in rows]):.1f}",
    ]


def _interval(hits: np.ndarray) -> str:
    """Wilson's interval of a share, in percent."""
    low, high = binomtest(int(hits.sum()), len(hits)).proportion_ci(method="wilson")
    return f"{100 * low:.1f}–{100 * high:.1f}"
