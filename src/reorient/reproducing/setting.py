"""Where a figure is made, how large, and by how many workers."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path

from reorient.formatting import FigureFormat
from reorient.runs.files import make_folder
from reorient.runs.pool import Pool
from reorient.world.objects import ObjectSource

States = Iterator[tuple[int, int] | tuple[int, int, str]]


def in_silence(what: str, states: States) -> None:
    """Let work run to its end; the command line draws a bar instead."""
    for _ in states:
        pass


@dataclass(frozen=True)
class Setting:
    """Arguments of every figure."""

    data: Path = Path("out/reproduce")
    """Pairs, training runs and weights: large, and made again by the same command."""
    out: Path = Path("results/reproduce")
    """Raw rows, tables and pictures, a folder for each figure."""
    lists: Path = Path("results")
    """Lists of object names."""
    meshes: Path | None = None
    """Household meshes, where a figure is about such."""
    only: Path | None = None
    """Names of those meshes to use."""
    share: float = 1.0
    """Of each figure's pairs, trials and epochs; below 1, other pairs than those of the whole figure."""
    format: FigureFormat = "png"
    """Of the figures' files."""
    pool: Pool = field(default_factory=Pool)
    progress: Callable[[str, States], None] = in_silence

    @property
    def quick(self) -> bool:
        """Whether this is less than the whole figure."""
        return self.share < 1

    @property
    def seed(self) -> int:
        """Of the pairs and trials: others in a part than in the whole, which could not fail against itself."""
        return int(self.quick)

    def folder(self, name: str) -> Path:
        """Where a figure's rows and pictures are."""
        return make_folder((self.data / "quick" if self.quick else self.out) / name)

    def part(self, count: int) -> int:
        """How many of ``count`` this setting asks for."""
        return max(1, ceil(self.share * count - 1e-9))

    def household(self) -> ObjectSource:
        """The household meshes; without a folder of them, generated objects that no network was trained on."""
        if self.meshes is not None:
            return ObjectSource(meshes=self.meshes, only=self.only)
        return ObjectSource(only=self.lists / "generated-reporting.txt", count=400, object_seed=100)
