"""The two object sets as two rows of pictures, and how symmetric they are (paper, Figure 3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reorient.experiments.evaluation import Row
from reorient.reporting.page import inline_image
from reorient.reporting.pictures import montage, png_data_uri, shade_mesh
from reorient.reporting.rows import numbers, read_table
from reorient.reproducing import full, non_symmetric
from reorient.reproducing.findings import Finding, share
from reorient.reproducing.one_shot import of, write_page
from reorient.reproducing.setting import Setting, collect
from reorient.runs.files import replacing
from reorient.world.objects import ObjectSource
from reorient.world.statistics import describe_mesh
from reorient.world.symmetry import SYMMETRIC_BELOW

NAME = "object-sets"
SETS = {"non-symmetric set": "100", "full set": "872"}  # and the paper's number of objects
SHOWN = 10  # of each


@dataclass(frozen=True)
class Sets:
    """What is looked at."""

    sets: dict[str, ObjectSource]
    every: int
    """Only each of so many objects."""


def _sets(setting: Setting) -> Sets:
    sources = (
        ObjectSource(
            only=setting.lists / "non-symmetric.txt", count=non_symmetric.COUNT, object_seed=non_symmetric.OBJECT_SEED
        ),
        ObjectSource(count=full.COUNT, object_seed=full.OBJECT_SEED),
    )
    return Sets(dict(zip(SETS, sources, strict=True)), round(1 / setting.share))


def measure(setting: Setting) -> None:
    """The figures of each object."""
    config = _sets(setting)
    tasks = [(title, source, name) for title, source in config.sets.items() for name in source.open().names]
    file = setting.folder(NAME) / "objects.csv.gz"
    setting.progress(NAME, collect(file, config, tasks[:: config.every], _describe, setting.workers))


def _describe(task: tuple[str, ObjectSource, str]) -> list[Row]:
    title, source, name = task
    figures = describe_mesh(source.open().load(name))
    return [{"estimator": title, "object": name} | {key: f"{value:.4g}" for key, value in figures.items()}]


def findings(folder: Path) -> Sequence[Finding]:
    """How many are symmetric by the measure that the tables use."""
    rows = read_table(folder / "objects.csv.gz", ["symmetry_residual"])
    return [
        share(
            f"{title}: symmetric objects",
            numbers(of(rows, title), "symmetry_residual") < SYMMETRIC_BELOW,
            [row["object"] for row in of(rows, title)],
            differs=f"generated objects, {count} as in the paper; residual below {SYMMETRIC_BELOW}",
        )
        for title, count in SETS.items()
    ]


def draw(setting: Setting, folder: Path) -> list[Path]:
    """Ten of each set, evenly spread over it."""
    pictures = []
    for source in _sets(setting).sets.values():
        objects = source.open()
        at = np.linspace(0, len(objects.names) - 1, SHOWN).round().astype(int)
        pictures += [shade_mesh(objects.load(objects.names[i])) for i in at]
    sheet = montage(pictures, SHOWN)
    path = folder / "object-sets.png"
    with replacing(path) as temporary:
        sheet.save(temporary, optimize=True)
    picture = inline_image(
        png_data_uri(sheet), "ten objects of each set", "Top: non-symmetric; below: full.", dark=True
    )
    lead = "Objects of the package's generator; the paper's own are not public."
    title = "The object sets (Figure 3 of the paper)"
    return [path, *write_page(folder, title, lead, findings(folder), {}, {"Ten of each": picture})]
