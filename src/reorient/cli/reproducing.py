"""The verb that makes the paper's figures again, with the fair comparison beside them."""

import os
from dataclasses import dataclass
from pathlib import Path

from reorient.cli.arguments import Positional
from reorient.cli.progress import show_progress
from reorient.errors import ReorientError
from reorient.reproducing import NAMES, Name


@dataclass(frozen=True)
class Reproduce:
    """Make a figure of the paper again: pairs, training, raw rows, pictures, numbers beside the paper's. Resumes.

    For example: reorient reproduce controller
    or, a tenth of every figure, and which of the numbers hold: reorient reproduce --quick
    """

    name: Positional[Name | None] = None
    """Which figure; with --quick, all unless named."""
    quick: bool = False
    """A tenth of it, on other pairs, compared with the rows in --out; networks train a tenth of the epochs."""
    data: Path = Path("out/reproduce")
    """Pairs, training runs, weights and quick runs: large, made again when missing."""
    out: Path = Path("results/reproduce")
    """Raw rows and pictures; a figure whose rows are there is only drawn again (elsewhere it is measured anew)."""
    lists: Path = Path("results")
    """Lists of object names."""
    meshes: Path | None = None
    """Household meshes for ``sweeps``; default: generated objects that no network was trained on."""
    only: Path | None = None
    """Names of those meshes to use."""
    workers: int = -1
    """Processes that draw pairs and measure; -1: one a core."""

    def run(self) -> None:
        """Measure what is missing, draw, print."""
        if self.name is None and not self.quick:
            raise ReorientError(f"no figure named: expected one of {', '.join(NAMES)}, or --quick for a tenth of all")
        from reorient.reproducing.making import reproduce
        from reorient.reproducing.setting import Setting

        share = 0.1 if self.quick else 1.0
        workers = (os.cpu_count() or 1) if self.workers == -1 else self.workers
        setting = Setting(self.data, self.out, self.lists, self.meshes, self.only, share, workers, show_progress)
        for name in NAMES if self.name is None else (self.name,):
            reproduce(name, setting)
