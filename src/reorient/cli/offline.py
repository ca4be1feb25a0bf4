"""The offline verbs: objects (make, list, check, montage), evaluate, report."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from trimesh import Trimesh
from tyro.conf import Positional, subcommand

from reorient.cli.progress import show_progress
from reorient.errors import ReorientError
from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.runs.files import make_folder, replacing, write_table
from reorient.runs.pool import Pool
from reorient.world.objects import ObjectSet, ObjectSource, split


def _console() -> Console:
    """As wide as the terminal; wide enough for the tables where there is none."""
    return Console() if sys.stdout.isatty() else Console(width=120)


def _loaded(objects: ObjectSet, name: str) -> Trimesh | None:
    """The mesh, or None with a note where it is refused: one broken file must not cost the others."""
    try:
        return objects.load(name)
    except ReorientError as error:
        print(f"reorient: left out: {error}", file=sys.stderr)
        return None


@dataclass(frozen=True)
class Make:
    """Write meshes of a set to a folder, as .ply of unit radius.

    For example: reorient objects make out/parts --count 50
    """

    out: Positional[Path]
    """Folder to write to."""
    objects: ObjectSource = field(default_factory=ObjectSource)

    def run(self) -> None:
        """One file an object; files already there are kept, so an interrupted run goes on."""
        from reorient.world.meshes import scale_to_radius

        objects = self.objects.open()
        make_folder(self.out)

        def states() -> Iterator[tuple[int, int]]:
            for done, name in enumerate(objects.names, 1):
                path = self.out / f"{name.replace('/', '__')}.ply"
                if not path.exists() and (mesh := _loaded(objects, name)) is not None:
                    with replacing(path) as temporary:
                        scale_to_radius(mesh, 1.0).export(temporary)
                yield done, len(objects.names)

        show_progress("objects", states())
        print(self.out)


@dataclass(frozen=True)
class List:
    """Print the names of a set.

    For example: reorient objects list --package example-robot-data
    or, what ``--only`` takes: reorient objects list --count 500 --distinctive > distinctive.txt
    """

    objects: ObjectSource = field(default_factory=ObjectSource)
    part: Literal["all", "train", "validation", "test"] = "all"
    """Which part of the split that training makes."""
    paper_filter: bool = False
    """Only objects that the paper's filter calls non-symmetric."""
    distinctive: bool = False
    """Only non-symmetric objects, of at least 50 faces and an aspect below 12."""

    def run(self) -> None:
        """One name a line."""
        from reorient.world.paper_filter import passes_paper_filter
        from reorient.world.statistics import is_distinctive

        tests = [passes_paper_filter] * self.paper_filter + [is_distinctive] * self.distinctive
        objects = self.objects.open()
        chosen = range(len(objects.names)) if self.part == "all" else sorted(getattr(split(objects.names), self.part))
        for name in (objects.names[i] for i in chosen):
            if not tests or ((mesh := _loaded(objects, name)) is not None and all(test(mesh) for test in tests)):
                print(name, flush=True)


@dataclass(frozen=True)
class Check:
    """Faces, genus, aspect, convexity and symmetry of every object of a set, and which are refused.

    For example: reorient objects check --meshes my_meshes --out out/objects.csv.gz
    or, 10,000 generated objects: reorient objects check --count 10000 --workers 2
    """

    objects: ObjectSource = field(default_factory=ObjectSource)
    out: Path | None = None
    """Write the rows here (.csv.gz)."""
    pool: Pool = field(default_factory=Pool)

    def run(self) -> None:
        """Measure, write, print percentiles."""
        from reorient.world.statistics import describe, print_statistics

        rows: list[dict[str, str]] = []

        def states() -> Iterator[tuple[int, int]]:
            for row, total in describe(self.objects, self.pool):
                rows.append(row)
                yield len(rows), total

        show_progress("objects", states())
        if self.out is not None:
            write_table(self.out, rows)
        print_statistics(rows, _console())


@dataclass(frozen=True)
class Montage:
    """A picture of a set.

    For example: reorient objects montage out/bin.png --count 100
    """

    out: Positional[Path]
    """Picture to write (.png, .jpg)."""
    objects: ObjectSource = field(default_factory=ObjectSource)
    columns: int = 10
    size_px: int = 128
    """Of each object."""

    def run(self) -> None:
        """Render and write."""
        from reorient.reporting.pictures import check_suffix, montage, shade_mesh

        check_suffix(self.out)
        if self.columns < 1 or self.size_px < 8:
            raise ReorientError(f"{self.columns} columns of {self.size_px} px: expected at least 1 of 8 px")
        objects = self.objects.open()
        meshes = [_loaded(objects, name) for name in objects.names]
        pictures = [shade_mesh(mesh, None, self.size_px) for mesh in meshes if mesh is not None]
        if not pictures:
            raise ReorientError("every mesh is refused: expected at least one")
        with replacing(self.out) as temporary:
            montage(pictures, self.columns).save(temporary)
        print(self.out)


@dataclass(frozen=True)
class Objects:
    """Sets of objects: make, list, check, montage."""

    verb: (
        Annotated[Make, subcommand("make")]
        | Annotated[List, subcommand("list")]
        | Annotated[Check, subcommand("check")]
        | Annotated[Montage, subcommand("montage")]
    )

    def run(self) -> None:
        """Run the chosen verb."""
        self.verb.run()


@dataclass(frozen=True)
class Evaluate:
    """Measure estimators: raw rows as CSV.gz, a table on screen. An interrupted run goes on where it stopped.

    For example: reorient evaluate out/eval --count 100 --pairs 300
    or, own meshes: reorient evaluate out/own --meshes my_meshes --estimators gicp --ranges-deg 0 30 --noise-mm 1
    """

    out: Positional[Path]
    """Folder for config.json, rows.csv.gz and table.md."""
    config: Evaluation = field(default_factory=Evaluation)
    pool: Pool = field(default_factory=Pool)

    def run(self) -> None:
        """Measure, then print the tables."""
        from reorient.reporting import markdown_table, print_tables, read_rows
        from reorient.runs.files import replacing

        show_progress("pairs", evaluate(self.config, self.out, self.pool))
        rows = read_rows(self.out)
        with replacing(self.out / "table.md") as temporary:
            temporary.write_text(markdown_table(rows))
        print_tables(rows, _console())
        print(self.out / "rows.csv.gz")


@dataclass(frozen=True)
class Report:
    """One self-contained HTML page of an evaluation: error against angle, histograms, best and worst pairs.

    For example: reorient report out/eval
    """

    folder: Positional[Path]
    """What ``reorient evaluate`` wrote."""

    def run(self) -> None:
        """Write report.html beside the rows."""
        from reorient.reporting import write_report

        print(write_report(self.folder))
