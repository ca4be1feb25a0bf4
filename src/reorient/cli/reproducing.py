"""The verb that makes the paper's figures again, with the fair comparison beside them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from reorient.cli.arguments import Metavar, Positional
from reorient.cli.progress import show_progress
from reorient.errors import ReorientError
from reorient.formatting import FigureFormat
from reorient.reproducing import NAMES, Name
from reorient.runs.pool import Pool


@dataclass(frozen=True)
class Reproduce:
    """Make a figure of the paper again.

    Pairs are generated and networks trained where the figure needs them; the numbers stand beside the paper's. An
    interrupted run continues where it stopped.

    Examples:
        reorient reproduce controller
        reorient reproduce --quick
    """

    name: Annotated[Positional[Name | None], Metavar("FIGURE")] = None
    """One of object-sets, best-worst, sweeps, controller, non-symmetric and full. Required unless --quick, which then
    takes all."""
    quick: bool = False
    """Measure a tenth of the pairs (other ones), train a tenth of the epochs, and compare with the full rows in
    --out."""
    data: Path = Path("out/reproduce")
    """Folder for pairs, training runs, weights and quick runs, which are large and made again when missing."""
    out: Path = Path("results/reproduce")
    """Folder for raw rows and pictures. A figure whose rows are there is only drawn again."""
    lists: Path = Path("results")
    """Folder with the lists of object names."""
    meshes: Path | None = None
    """Folder of household meshes for the figure sweeps, by default generated objects that no network was trained on."""
    only: Path | None = None
    """File with the names of the household meshes to use."""
    format: FigureFormat = "png"
    """Format of the figures."""
    pool: Pool = field(default_factory=lambda: Pool(-1))

    def run(self) -> None:
        """Measure what is missing, draw, print."""
        if self.name is None and not self.quick:
            raise ReorientError(f"no figure named: expected one of {', '.join(NAMES)}, or --quick for a tenth of all")
        from reorient.reproducing.figure import load_figure
        from reorient.reproducing.making import reproduce
        from reorient.reproducing.setting import Setting

        share = 0.1 if self.quick else 1.0
        setting = Setting(
            self.data, self.out, self.lists, self.meshes, self.only, share, self.format, self.pool, show_progress
        )
        for name in NAMES if self.name is None else (self.name,):
            reproduce(load_figure(name), setting)
