"""The verb that makes the paper's figures again, with the fair comparison beside them."""

from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import Positional

from reorient.cli.progress import show_progress
from reorient.errors import ReorientError
from reorient.reproducing import NAMES, Name
from reorient.runs.pool import Pool


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
    pool: Pool = field(default_factory=lambda: Pool(-1))

    def run(self) -> None:
        """Measure what is missing, draw, print."""
        if self.name is None and not self.quick:
            raise ReorientError(f"no figure named: expected one of {', '.join(NAMES)}, or --quick for a tenth of all")
        from reorient.reproducing.figure import load_figure
        from reorient.reproducing.making import reproduce
        from reorient.reproducing.setting import Setting

        share = 0.1 if self.quick else 1.0
        setting = Setting(self.data, self.out, self.lists, self.meshes, self.only, share, self.pool, show_progress)
        for name in NAMES if self.name is None else (self.name,):
            reproduce(load_figure(name), setting)
