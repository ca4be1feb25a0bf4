"""The raw rows of an evaluation and their summaries, always computed from all rows (no averages of averages)."""

import csv
import gzip
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.stats import binomtest

from reorient.errors import ReorientError, in_short, reason_of
from reorient.runs.run import Row

NEEDED = (
    *("object", "pair", "world", "noise_mm", "low_deg", "high_deg", "estimator", "angle_deg", "error_deg"),
    *("error_sym_deg", "qw", "qx", "qy", "qz", "seconds", "message"),
)
_NUMERIC = tuple(column for column in NEEDED if column not in ("object", "pair", "world", "estimator", "message"))
OPTIONAL = ("overlap", "confidence", "goal_views", "set_size", "set_covers", "distance2")
"""Empty where rows of an earlier version lack them."""
CORRECT_DEG = 5.0  # symmetry-aware error below which an estimate is correct
QUARTERS = ((0, 25), (25, 50), (50, 75), (75, 100))  # of the overlap, in percent


@dataclass(frozen=True)
class Summary:
    """The errors of one estimator in one cell (noise, range of the start angle). Angles in degrees."""

    estimator: str
    noise_mm: float
    low_deg: float
    high_deg: float
    n: int
    """Number of pairs; one that the estimator refused counts as the estimate "no rotation"."""
    mean_deg: float
    median_deg: float
    rms_deg: float
    p90_deg: float
    """90% of the errors are at most this (linear between neighbours)."""
    within1: float
    """Share of errors below 1 degree."""
    within5: float
    """Share of errors below 5 degrees."""
    within5_interval: tuple[float, float]
    """Wilson's 95% interval of that share."""
    seconds: float
    """Median processor time of an estimate, all threads together."""


def read_rows(folder: str | Path) -> list[Row]:
    """The rows of ``rows.csv.gz``. Raises ReorientError where it is missing, broken, empty or lacks columns, and for a
    cell without a number where one is needed."""
    rows = read_table(Path(folder) / "rows.csv.gz", NEEDED)
    for column in _NUMERIC:
        numbers(rows, column)
    for column in ("overlap", "confidence"):
        numbers([row for row in rows if row.get(column)], column)
    for row in rows:
        if not row["pair"].isdecimal():
            raise _no_number(row, "pair", "a whole number")
    return [_named(dict.fromkeys(OPTIONAL, "") | row) for row in rows]


def _named(row: Row) -> Row:
    """The row, with the number of goal views, where there are several, in the name of its estimator."""
    several = row["goal_views"] not in ("", "1")
    return row | {"estimator": f"{row['estimator']}, {row['goal_views']} goal views"} if several else row


def read_table(file: Path, columns: Sequence[str]) -> list[Row]:
    """The rows of a table written by ``write_table``. Raises ReorientError as ``read_rows``."""
    if not file.is_file():
        raise ReorientError(f"no {str(file)!r}: expected config.json and {file.name} of a run")
    try:
        with gzip.open(file, "rt", newline="", encoding="utf-8") as text:
            reader = csv.DictReader(text)
            rows, present = list(reader), reader.fieldnames or ()
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error) as error:
        raise ReorientError(
            f"cannot read {str(file)!r} ({reason_of(error)}): expected a complete gzip of a CSV table"
        ) from error
    if missing := [column for column in columns if column not in present]:
        raise ReorientError(f"{str(file)!r} has no column {', '.join(missing)}: expected {', '.join(columns)}")
    if not rows:
        raise ReorientError(f"{str(file)!r} has no rows: expected one for each thing measured")
    for line, row in enumerate(rows, start=2):
        if None in row or None in row.values():
            raise ReorientError(f"line {line} of {str(file)!r}: expected {len(present)} cells, one for each column")
    return rows


def numbers(rows: Sequence[Row], column: str) -> Float[np.ndarray, " n"]:
    """One column as numbers. Raises ReorientError, naming the row, for a cell without a finite number."""
    values = np.empty(len(rows))
    for index, row in enumerate(rows):
        try:
            values[index] = float(row[column])
        except (KeyError, ValueError):
            values[index] = np.nan
        if not np.isfinite(values[index]):
            raise _no_number(row, column, "a finite number")
    return values


def _no_number(row: Row, column: str, expected: str) -> ReorientError:
    place = f"object {in_short(row.get('object'))!r}, pair {in_short(row.get('pair'))}"
    return ReorientError(f"{column} of {place} is {in_short(row.get(column))!r}: expected {expected}")


def estimators(rows: Sequence[Row]) -> list[str]:
    """Names of the estimators in order of first appearance."""
    return list(dict.fromkeys(row["estimator"] for row in rows))


def summarise(rows: Sequence[Row], error: str = "error_deg") -> list[Summary]:
    """One summary for each cell and estimator, sorted by noise, range and first appearance of the estimator.

    ``error``: the column of the errors, ``error_deg`` or the symmetry-aware ``error_sym_deg``.
    """
    errors_deg, seconds = numbers(rows, error), numbers(rows, "seconds")
    noise_mm, low_deg, high_deg = (numbers(rows, column) for column in ("noise_mm", "low_deg", "high_deg"))
    order = {name: index for index, name in enumerate(estimators(rows))}
    cells: dict[tuple[float, float, float, int], list[int]] = {}
    for index, row in enumerate(rows):
        key = (noise_mm[index], low_deg[index], high_deg[index], order[row["estimator"]])
        cells.setdefault(key, []).append(index)
    names = list(order)
    return [
        _summary(names[which], (float(noise), float(low), float(high)), errors_deg[members], seconds[members])
        for (noise, low, high, which), members in sorted(cells.items())
    ]


def by_overlap(rows: Sequence[Row]) -> list[Row]:
    """The rows with a known overlap, their range of angles replaced by the quarter of the overlap, in percent."""
    known = [row for row in rows if row["overlap"]]
    place = np.minimum(4 * numbers(known, "overlap"), 3).astype(int)
    return [
        row | {"low_deg": str(low), "high_deg": str(high)}
        for row, (low, high) in zip(known, (QUARTERS[x] for x in place), strict=True)
    ]


def _summary(estimator: str, cell: tuple[float, float, float], errors_deg: np.ndarray, seconds: np.ndarray) -> Summary:
    n = len(errors_deg)
    below5 = int(np.sum(errors_deg < 5))
    return Summary(
        estimator,
        *cell,
        n=n,
        mean_deg=float(np.mean(errors_deg)),
        median_deg=float(np.median(errors_deg)),
        rms_deg=float(np.sqrt(np.mean(errors_deg**2))),
        p90_deg=float(np.percentile(errors_deg, 90)),
        within1=float(np.mean(errors_deg < 1)),
        within5=below5 / n,
        within5_interval=binomtest(below5, n).proportion_ci(method="wilson"),
        seconds=float(np.median(seconds)),
    )
