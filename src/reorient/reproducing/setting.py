"""Where and how large: what every figure is told; and rows collected task by task, so that nothing is done twice."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

from reorient.experiments.evaluation import Row
from reorient.runs.files import make_folder, whole_lines, write_table
from reorient.runs.pool import check_workers, processes
from reorient.runs.provenance import keep_record
from reorient.world.objects import ObjectSource

States = Iterator[tuple[int, int] | tuple[int, int, str]]


def in_silence(what: str, states: States) -> None:
    """Let work run to its end; the command line draws a bar instead."""
    for _ in states:
        pass


@dataclass(frozen=True)
class Setting:
    """What every figure is told."""

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
    workers: int = 1
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


def collect(
    file: Path, config: Any, tasks: Sequence[Any], measure: Callable[[Any], list[Row]], workers: int = 1
) -> Iterator[tuple[int, int]]:
    """Rows of all tasks, in their order, into ``file`` (.csv.gz); yields (tasks done, in all).

    ``config``: a dataclass, recorded beside the file. Each finished task is kept at once, so that an interrupted run
    goes on where it stopped. Raises ReorientError where rows of another config are there, and for no workers.
    """
    partial, described = (file.with_name(file.name.replace(".csv.gz", end)) for end in (".partial.jsonl", ".json"))
    check_workers(workers)
    keep_record(described, config, repr(str(file)))
    if file.is_file():
        yield len(tasks), len(tasks)
        return
    lines = whole_lines(partial)
    yield len(lines), len(tasks)
    with processes(workers) as pool, partial.open("a") as kept:
        left = tasks[len(lines) :]
        for rows in pool.map(measure, left) if workers > 1 else map(measure, left):
            lines.append(json.dumps(rows) + "\n")
            kept.write(lines[-1])
            kept.flush()
            yield len(lines), len(tasks)
    write_table(file, [row for line in lines for row in json.loads(line)])
    partial.unlink()
