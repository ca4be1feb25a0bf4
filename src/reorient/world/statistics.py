"""Statistics of a set of objects: faces, genus, aspect, convexity, symmetry, and the meshes that are refused."""

from collections.abc import Iterator

import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

from reorient.errors import ReorientError
from reorient.runs.pool import Pool
from reorient.world.meshes import scale_to_radius
from reorient.world.objects import ObjectSource
from reorient.world.symmetry import SYMMETRIC_BELOW, rotation_group

FIGURES = ("faces", "genus", "aspect", "convexity", "symmetry_residual")
CHUNK = 8  # objects per task of a worker


def describe(source: ObjectSource, pool: Pool | None = None) -> Iterator[tuple[dict[str, str], int]]:
    """One row per object, in the order of the set, with the total number of objects."""
    names = source.open().names
    tasks = [(source, names[start : start + CHUNK]) for start in range(0, len(names), CHUNK)]
    for rows in (pool or Pool()).map(_describe_chunk, tasks):
        for row in rows:
            yield row, len(names)


def describe_mesh(mesh: trimesh.Trimesh) -> dict[str, float]:
    """The statistics of one mesh, in any unit.

    Genus: handles of the closed surface (NaN if open). Aspect: longest over shortest extent of the bounding box, in the
    mesh's axes. Convexity: volume over that of the convex hull (NaN if open). Symmetry residual: small if some rotation
    of at least 25 degrees maps the object to itself (see ``rotation_group``).
    """
    mesh = scale_to_radius(mesh, 1.0)
    welded = trimesh.Trimesh(mesh.vertices, mesh.faces)  # merges the vertices that process=False keeps apart
    extents = np.ptp(mesh.vertices, axis=0)
    closed = welded.is_watertight
    return {
        "faces": len(mesh.faces),
        "genus": welded.body_count - welded.euler_number / 2 if closed else np.nan,
        "aspect": float(extents.max() / max(extents.min(), 1e-9)),
        "convexity": float(abs(welded.volume) / welded.convex_hull.volume) if closed else np.nan,
        "symmetry_residual": rotation_group(mesh).residual,
    }


def is_distinctive(mesh: trimesh.Trimesh) -> bool:
    """The criterion for "non-symmetric" in the tables: symmetry residual at least 0.05, aspect below 12, at least 50
    faces."""
    figures = describe_mesh(mesh)
    return figures["symmetry_residual"] >= SYMMETRIC_BELOW and figures["aspect"] < 12 and figures["faces"] >= 50


def _describe_chunk(task: tuple[ObjectSource, tuple[str, ...]]) -> list[dict[str, str]]:
    source, names = task
    objects = source.open()
    rows = []
    for name in names:
        try:
            mesh = objects.load(name)
        except ReorientError as error:
            rows.append({"object": name, **dict.fromkeys(FIGURES, ""), "refused": str(error)})
        else:
            figures = {key: f"{value:.4g}" for key, value in describe_mesh(mesh).items()}
            rows.append({"object": name, **figures, "refused": ""})
    return rows


def print_statistics(rows: list[dict[str, str]], console: Console) -> None:
    """Print percentiles of each statistic, the share of symmetric objects, and the refused objects by name."""
    table = Table(title=f"{len(rows)} objects")
    table.add_column("figure")
    percentiles = (5, 25, 50, 75, 95)
    for percentile in percentiles:
        table.add_column(f"{percentile}%", justify="right")
    table.add_column("of", justify="right")
    for figure in FIGURES:
        values = np.array([float(row[figure]) for row in rows if row[figure] not in ("", "nan")])
        if len(values):
            table.add_row(figure, *(f"{x:.3g}" for x in np.percentile(values, percentiles)), str(len(values)))
    console.print(table)
    residuals = np.array([float(row["symmetry_residual"]) for row in rows if row["symmetry_residual"]])
    if len(residuals):
        console.print(f"symmetric (residual below {SYMMETRIC_BELOW}): {np.mean(residuals < SYMMETRIC_BELOW):.1%}")
    for row in rows:
        if row["refused"]:
            console.print(f"refused: {row['refused']}", style="red", soft_wrap=True)
