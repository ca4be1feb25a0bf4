"""The verb that makes the paper's figures again, with the fair comparison beside them."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from tyro.conf import Positional

from reorient.cli.progress import show_progress
from reorient.errors import ReorientError
from reorient.reproducing import NAMES, Name, load_figure
from reorient.reproducing.findings import HEADINGS, Finding, cells, write_findings
from reorient.reproducing.quick import verdicts
from reorient.reproducing.setting import Setting


@dataclass(frozen=True)
class Reproduce:
    """Make a figure of the paper again: pairs, training, raw rows, pictures, numbers beside the paper's. Resumes.

    For example: reorient reproduce controller
    or, a tenth of every figure and which of the numbers hold: reorient reproduce --quick
    """

    name: Positional[Name | None] = None
    """Which figure; with --quick, all unless named."""
    quick: bool = False
    """A tenth of it, on other pairs, compared with the rows in --out; networks train a tenth of the epochs."""
    data: Path = Path("out/reproduce")
    """Pairs, training runs, weights and quick runs: large, made again when missing."""
    out: Path = Path("results/reproduce")
    """Raw rows and pictures; a figure whose rows are there is only drawn again."""
    lists: Path = Path("results")
    """Lists of object names."""
    meshes: Path | None = None
    """Household meshes for ``sweeps``; default: generated objects that no network was trained on."""
    only: Path | None = None
    """Names of those meshes to use."""
    workers: int = 1
    """Processes that draw pairs and measure."""

    def run(self) -> None:
        """Measure what is missing, draw, print."""
        if self.name is None and not self.quick:
            raise ReorientError(f"no figure named: expected one of {', '.join(NAMES)}, or --quick for a tenth of all")
        share = 0.1 if self.quick else 1.0
        setting = Setting(
            self.data, self.out, self.lists, self.meshes, self.only, share, self.workers, show_progress
        )  # fmt: skip
        for name in NAMES if self.name is None else (self.name,):
            began = time.monotonic()
            figure, folder = load_figure(name), setting.folder(name)
            figure.measure(setting)
            findings = figure.findings(folder)
            write_findings(findings, folder / "numbers.csv")
            written = figure.draw(setting, folder)
            if self.quick:
                for line in verdicts(name, findings, figure, self.out / name, folder):
                    print(line)
            else:
                _print(name, findings)
            print(f"{name}: {(time.monotonic() - began) / 60:.1f} minutes; {written[-1]}", flush=True)


def _print(name: str, findings: Sequence[Finding]) -> None:
    table = Table(title=name, title_justify="left", header_style="bold")
    for index, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if index in (0, 5) else "right", no_wrap=index != 5)
    for finding in findings:
        table.add_row(*cells(finding))
    Console(width=max(Console().width, 140)).print(table)
