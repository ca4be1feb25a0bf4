"""A figure from end to end; of a part of one, which of its numbers hold on other pairs."""

import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from reorient.errors import ReorientError
from reorient.reporting.rows import read_table
from reorient.reproducing.figure import Figure
from reorient.reproducing.findings import HEADINGS, WORDS, Finding, cells, held, write_findings
from reorient.reproducing.setting import Setting

MOST_LINES = 80  # of a table on the screen


def reproduce(figure: Figure, setting: Setting) -> None:
    """Measure what is missing, draw, print the numbers (of a part: whether those of the whole hold)."""
    began = time.monotonic()
    name, folder = figure.name, setting.folder(figure.name)
    if setting.quick and any(folder.rglob("*.csv.gz")):
        print(f"{name}: compares the rows that are in {folder}; remove them to measure anew", flush=True)
    figure.measure(setting)
    findings = figure.findings(folder)
    write_findings(findings, folder / "numbers.csv")
    written = figure.draw(setting, folder)
    if setting.quick:
        print(*verdicts(figure, findings, setting.out / name, folder), sep="\n")
    else:
        _print(name, findings)
    print(f"{name}: {(time.monotonic() - began) / 60:.1f} minutes; {written[-1]}", flush=True)


def _print(name: str, findings: Sequence[Finding]) -> None:
    if len(findings) > MOST_LINES:
        print(f"{name}: {len(findings)} numbers, in numbers.csv and on the page")
        return
    table = Table(title=name, title_justify="left", header_style="bold")
    for index, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if index in WORDS else "right", no_wrap=index != WORDS[-1])
    for finding in findings:
        table.add_row(*cells(finding))
    Console(width=max(Console().width, 160), markup=False, emoji=False).print(table)


def verdicts(figure: Figure, part: Sequence[Finding], whole: Path, folder: Path) -> list[str]:
    """In lines: the figure as a whole, then each number that differs.

    ``whole``: the folder with the rows of the whole figure; ``folder``: with those of the part.
    """
    name = figure.name
    try:
        full = {finding.what: finding for finding in figure.findings(whole)}
    except ReorientError as error:
        return [f"{name}: not compared, there are no whole rows ({error})"]
    if _objects(folder) - _objects(whole):
        return [f"{name}: not compared, the rows in {whole} are of other objects (see --meshes and --only)"]
    matched = [(finding, full.get(finding.what)) for finding in part]
    compared = [(a, b, held(a, b)) for a, b in matched if b is not None]
    decided = [(a, b, holds) for a, b, holds in compared if holds is not None]
    if not decided:
        return [f"{name}: not compared, none of its {len(part)} numbers has an interval and a counterpart"]
    failed = [f"  differs: {a.what}: {_in_words(a)}, whole {_in_words(b)}" for a, b, holds in decided if not holds]
    without = len(part) - len(decided)
    missing = f"; {without} have no interval or no counterpart" if without else ""
    verdict = "holds" if len(failed) <= _expected(len(decided)) else "DOES NOT HOLD"
    head = f"{name}: {verdict}: {len(decided) - len(failed)} of {len(decided)} numbers agree within their 95% intervals"
    return [f"{head} (one in twenty may differ by chance, twice as many where they fail together){missing}", *failed]


def _expected(n: int) -> int:
    """How many of n may differ before it is no chance; numbers of one figure fail together, so twice the mean."""
    return max(1, round(0.1 * n))


def _in_words(finding: Finding) -> str:
    value, between = cells(finding)[2:4]
    return f"{value} ({between}, n = {finding.n})"


def _objects(folder: Path) -> set[str]:
    return {row["object"] for file in folder.rglob("*.csv.gz") for row in read_table(file, ["object"])}
