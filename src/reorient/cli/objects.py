"""The verbs of object sets: make, list, check, montage."""

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from trimesh import Trimesh

from reorient.cli.arguments import Positional
from reorient.cli.progress import show_progress, table_console
from reorient.errors import ReorientError, check_counts, check_range
from reorient.runs.files import make_folder, replacing, write_table
from reorient.runs.pool import Pool
from reorient.world.objects import ObjectSet, ObjectSource, split


def _loaded(objects: ObjectSet, name: str) -> Trimesh | None:
    """The mesh, or None with a note where it is refused: one broken file must not cost the others."""
    try:
        return objects.load(name)
    except ReorientError as error:
        print(f"reorient: left out: {error}", file=sys.stderr)
        return None


@dataclass(frozen=True)
class Make:
    """Write the meshes of an object set to a folder.

    They are .ply files of unit radius. Existing files are kept, so that an interrupted run can be continued.

    Examples:
        reorient objects make out/parts --count 50
    """

    out: Positional[Path]
    """Folder to write to."""
    objects: ObjectSource = field(default_factory=ObjectSource)

    def run(self) -> None:
        """Write one file for each object that has none."""
        from reorient.world.meshes import scale_to_radius

        objects = self.objects.open()
        files = {name: name.replace("/", "__") for name in objects.names}
        if doubles := [name for name, count in Counter(files.values()).items() if count > 1]:
            both = [name for name in files if files[name] == doubles[0]]
            raise ReorientError(
                f"meshes {' and '.join(map(repr, both))} would both become {doubles[0]}.ply: expected other names"
            )
        make_folder(self.out)

        def states() -> Iterator[tuple[int, int]]:
            for done, name in enumerate(objects.names, 1):
                path = self.out / f"{files[name]}.ply"
                if not path.exists() and (mesh := _loaded(objects, name)) is not None:
                    with replacing(path) as temporary:
                        scale_to_radius(mesh, 1.0).export(temporary)
                yield done, len(objects.names)

        show_progress("objects", states())
        print(self.out)


@dataclass(frozen=True)
class List:
    """Print the names of an object set.

    The option --only of other verbs reads such a list.

    Examples:
        reorient objects list --package example-robot-data
        reorient objects list --count 500 --distinctive > distinctive.txt
    """

    objects: ObjectSource = field(default_factory=ObjectSource)
    part: Literal["all", "train", "validation", "test"] = "all"
    """Part of the split that training makes."""
    paper_filter: bool = False
    """Print only objects that pass the paper's filter for non-symmetric ones."""
    distinctive: bool = False
    """Print only non-symmetric objects of at least 50 faces and an aspect ratio below 12."""

    def run(self) -> None:
        """Print one name a line."""
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
    """Measure shape and symmetry of every object of a set.

    Prints percentiles of faces, genus, aspect ratio, convexity and symmetry, and the objects that cannot be used.

    Examples:
        reorient objects check --meshes my_meshes --out out/objects.csv.gz
        reorient objects check --count 10000 --workers 2
    """

    objects: ObjectSource = field(default_factory=ObjectSource)
    out: Path | None = None
    """File for the rows (.csv.gz)."""
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
        print_statistics(rows, table_console())


@dataclass(frozen=True)
class Montage:
    """Draw the objects of a set in one picture.

    Examples:
        reorient objects montage out/bin.png --count 100
    """

    out: Positional[Path]
    """Picture to write (.png, .jpg)."""
    objects: ObjectSource = field(default_factory=ObjectSource)
    columns: int = 10
    """Number of columns."""
    size_px: int = 128
    """Width and height of each object."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_counts(self, "columns")
        check_range(self, "size_px", low=8, high=4096)

    def run(self) -> None:
        """Render and write."""
        from reorient.reporting.mesh_pictures import shade_mesh
        from reorient.reporting.pictures import check_suffix, montage

        check_suffix(self.out)
        objects = self.objects.open()
        meshes = [_loaded(objects, name) for name in objects.names]
        pictures = [shade_mesh(mesh, None, self.size_px) for mesh in meshes if mesh is not None]
        if not pictures:
            raise ReorientError("every mesh is refused: expected at least one")
        with replacing(self.out) as temporary:
            montage(pictures, self.columns).save(temporary)
        print(self.out)
