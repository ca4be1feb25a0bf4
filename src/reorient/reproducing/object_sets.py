"""The two object sets as two rows of pictures, and how symmetric they are (paper, Figure 3)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from reorient.reporting.mesh_pictures import shade_mesh
from reorient.reporting.page import inline_image
from reorient.reporting.pictures import montage, png_data_uri
from reorient.reporting.rows import numbers, read_table
from reorient.reproducing.findings import Finding, share
from reorient.reproducing.full import Full
from reorient.reproducing.non_symmetric import NonSymmetric
from reorient.reproducing.one_shot import of, write_page
from reorient.reproducing.setting import Setting
from reorient.runs.files import replacing
from reorient.runs.run import RowStore, Tables, resumable
from reorient.world.objects import ObjectSource
from reorient.world.statistics import describe_mesh
from reorient.world.symmetry import SYMMETRIC_BELOW

SETS = {"non-symmetric set": "100", "full set": "872"}  # and the paper's number of objects


@dataclass(frozen=True)
class Sets:
    """Sets to describe."""

    sets: dict[str, ObjectSource]
    every: int
    """Only each of so many objects."""


@dataclass(frozen=True)
class ObjectSets:
    """As ``Figure``."""

    name: str = "object-sets"
    non_symmetric: NonSymmetric = field(default_factory=NonSymmetric)
    full: Full = field(default_factory=Full)
    shown: int = 10
    """Objects of each set in the picture."""

    def measure(self, setting: Setting) -> None:
        """The figures of each object."""
        config = self._sets(setting)
        tasks = [(title, source, name) for title, source in config.sets.items() for name in source.open().names]
        chosen = {f"{title}: {name}": (title, source, name) for title, source, name in tasks[:: config.every]}
        states = resumable(setting.folder(self.name), config, chosen, _describe, RowStore(), setting.pool)
        setting.progress(self.name, states)

    def findings(self, folder: Path) -> Sequence[Finding]:
        """How many are symmetric by the measure that the tables use."""
        rows = read_table(folder / "rows.csv.gz", ["symmetry_residual"])
        return [
            share(
                f"{title}: symmetric objects",
                numbers(of(rows, title), "symmetry_residual") < SYMMETRIC_BELOW,
                [row["object"] for row in of(rows, title)],
                differs=f"generated objects, {count} as in the paper; residual below {SYMMETRIC_BELOW}",
            )
            for title, count in SETS.items()
        ]

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """Ten of each set, evenly spread over it."""
        pictures = []
        for source in self._sets(setting).sets.values():
            objects = source.open()
            at = np.linspace(0, len(objects.names) - 1, self.shown).round().astype(int)
            pictures += [shade_mesh(objects.load(objects.names[i])) for i in at]
        sheet = montage(pictures, self.shown)
        path = folder / "object-sets.png"
        with replacing(path) as temporary:
            sheet.save(temporary, optimize=True)
        picture = inline_image(
            png_data_uri(sheet), "ten objects of each set", "Top: non-symmetric; below: full.", kind="dark"
        )
        lead = "Objects of the package's generator; the paper's own are not public."
        title = "The object sets (Figure 3 of the paper)"
        return [path, *write_page(folder, title, lead, self.findings(folder), {}, {"Ten of each": picture})]

    def _sets(self, setting: Setting) -> Sets:
        sources = self.non_symmetric.objects(setting), self.full.objects()
        return Sets(dict(zip(SETS, sources, strict=True)), round(1 / setting.share))


def _describe(task: tuple[str, ObjectSource, str]) -> Tables:
    title, source, name = task
    figures = describe_mesh(source.open().load(name))
    row = {"estimator": title, "object": name} | {key: f"{value:.4g}" for key, value in figures.items()}
    return {"rows": [row]}


FIGURE = ObjectSets()
