"""The table of an evaluation on the screen, in Markdown and in HTML, by start angle or by overlap."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

from rich.console import Console
from rich.table import Table

from reorient.reporting.page import wide
from reorient.reporting.rows import CORRECT_DEG, Summary, by_overlap, estimators, summarise
from reorient.runs.run import Row

_BELOW5 = "< 5° (95% interval)"
HEADINGS = (
    *("noise", "", "estimator", "pairs", "median°", "mean°", "rms°", "p90°"),
    *("< 1°", _BELOW5, "< 5° sym.", "ms"),
)
ELLIPSOID_95 = 7.815  # squared Mahalanobis distance, three degrees of freedom
_WORDS = 3  # number of left-aligned columns
_BAR = HEADINGS.index(_BELOW5)


@dataclass(frozen=True)
class Breakdown:
    """The quantity by which the rows of an estimator and noise level are divided."""

    heading: str
    unit: str
    divide: Callable[[Sequence[Row]], Sequence[Row]]
    """Selects the rows with a known value and writes the bounds of its interval into the columns of the range."""
    note: str = ""

    @property
    def headings(self) -> list[str]:
        """Headings of the columns."""
        return [heading or self.heading for heading in HEADINGS]


RANGE = Breakdown("range", "°", lambda rows: rows)
OVERLAP = Breakdown(
    "overlap",
    "%",
    by_overlap,
    " Overlap: the share of the goal's visible surface that is visible in the start (co-visible), from rays cast "
    "at the mesh; all angles.",
)


def print_tables(rows: Sequence[Row], console: Console) -> None:
    """Print tables for each noise level, by range and (where known) by overlap, at most 120 columns wide."""
    for by in (RANGE, OVERLAP):
        for noise, group in groupby(_lines(rows, by), key=lambda line: line[1][0]):
            table = Table(title=f"depth noise {noise}, {_worlds(rows)}", title_justify="left", header_style="bold")
            for index, heading in enumerate(by.headings[1:], start=1):
                table.add_column(heading, justify="left" if index < _WORDS else "right", no_wrap=True)
            previous = None
            for _, cells in group:
                if previous not in (None, cells[1]):
                    table.add_section()
                table.add_row(*cells[1:])
                previous = cells[1]
            console.print(table)
    console.print(notes(rows), highlight=False)


def markdown_table(rows: Sequence[Row], by: Breakdown = RANGE) -> str:
    """The table and its notes, in Markdown."""
    marks = ["---" if index < _WORDS else "---:" for index in range(len(HEADINGS))]
    lines = [by.headings, marks, *([cell.replace("|", "\\|") for cell in cells] for _, cells in _lines(rows, by))]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + f"\n\n{notes(rows)}{by.note}\n"


def html_table(rows: Sequence[Row], by: Breakdown = RANGE) -> str:
    """The table and its notes as HTML, a bar behind each share below 5 degrees."""
    head = "".join(f"<th{_side(index)}>{escape(heading)}</th>" for index, heading in enumerate(by.headings))
    body = []
    previous: list[str] = []
    for summary, cells in _lines(rows, by):
        columns = [f"<td{_side(index)}>{escape(cell)}</td>" for index, cell in enumerate(cells)]
        columns[_BAR] = f'<td class="bar" style="--share:{100 * summary.within5:.1f}%">{escape(cells[_BAR])}</td>'
        begins = ' class="begins"' if cells[:2] != previous else ""
        body.append(f"<tr{begins}>{''.join(columns)}</tr>")
        previous = cells[:2]
    return (
        wide(f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>", f"errors by {by.heading}")
        + f'<p class="note">{escape(notes(rows) + by.note)}</p>'
    )


def notes(rows: Sequence[Row]) -> str:
    """The definitions behind the table, in one paragraph."""
    refused = {name: sum(bool(row["message"]) for row in rows if row["estimator"] == name) for name in estimators(rows)}
    counts = ", ".join(f"{name} {count}" for name, count in refused.items() if count)
    return (
        f"Errors in degrees over all pairs of the cell, {_worlds(rows)}; sym.: symmetry-aware; ms: median processor "
        'time of one estimate, all threads; the interval is Wilson\'s. A refused pair counts as "no rotation"'
        + (f" (refused: {counts})." if counts else "; none was refused.")
        + "".join(f" {sentence}." for name in estimators(rows) if (sentence := _trust(rows, name)))
    )


def _trust(rows: Sequence[Row], name: str) -> str:
    """The coverage of an estimator's 95% sets and ellipsoids in words; empty for one without."""
    mine = [row for row in rows if row["estimator"] == name]
    sizes = [int(row["set_size"]) for row in mine if row.get("set_size")]
    given = [row for row in mine if row.get("set_size", "") not in ("", "0")]
    inside = [
        float(row["distance2"]) <= ELLIPSOID_95
        for row in mine
        if row.get("distance2") and float(row["error_sym_deg"]) < CORRECT_DEG
    ]
    words = []
    if given:
        covered = sum(row["set_covers"] == "1" for row in given) / len(given)
        median = sorted(int(row["set_size"]) for row in given)[len(given) // 2]
        words.append(
            f"95% sets of {name}: {covered:.1%} of {len(given)} hold the truth, median size {median}, "
            f"none for {len(sizes) - len(given)} pairs"
        )
    if inside:
        share = sum(inside) / len(inside)
        words.append(f"95% ellipsoids of {name}: {share:.1%} of {len(inside)} correct answers hold the truth")
    return "; ".join(words)


def _lines(rows: Sequence[Row], by: Breakdown) -> Iterator[tuple[Summary, list[str]]]:
    rows = by.divide(rows)
    for plain, aware in zip(summarise(rows), summarise(rows, "error_sym_deg"), strict=True):
        low, high = (f"{share:.0%}"[:-1] for share in plain.within5_interval)
        yield (
            plain,
            [
                f"{plain.noise_mm:g} mm",
                f"{plain.low_deg:g}–{plain.high_deg:g}{by.unit}",
                plain.estimator,
                str(plain.n),
                *(f"{x:.2f}" for x in (plain.median_deg, plain.mean_deg, plain.rms_deg, plain.p90_deg)),
                f"{plain.within1:.1%}",
                f"{plain.within5:.1%} ({low}–{high})",
                f"{aware.within5:.1%}",
                f"{1000 * plain.seconds:.0f}",
            ],
        )


def _worlds(rows: Sequence[Row]) -> str:
    return "world " + ", ".join(sorted({row["world"] for row in rows}))


def _side(index: int) -> str:
    return ' class="word"' if index < _WORDS else ""
