"""Do the alternatives cover symmetry: do they include the true rotation where others are equivalent?

    python benchmarks/alternatives.py results/alternatives.csv.gz --meshes FOLDER

One row a pair of images, all angles, after the objects with a finite group and as many without symmetry. An axis of
revolution leaves no finite set of answers, so such objects are left out.
"""

import sys
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from rich.progress import track
from scipy.stats import binomtest

from reorient import load_estimator, so3
from reorient.cli.arguments import Positional, parse
from reorient.reporting.rows import CORRECT_DEG
from reorient.runs.files import make_folder, write_table
from reorient.world.objects import ObjectSource
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised
from reorient.world.statistics import is_distinctive
from reorient.world.symmetry import SymmetryGroup, rotation_group, symmetric_error


@dataclass(frozen=True)
class Alternatives:
    """Do the alternatives cover symmetry: do they include the true rotation where others are equivalent?"""

    out: Positional[Path]
    """CSV.gz to write."""
    source: ObjectSource = field(default_factory=ObjectSource)
    objects: int = 40
    """With a finite symmetry, and as many without."""
    pairs: int = 4
    """Of each object."""
    noise_mm: float = 1.0


def main(config: Alternatives) -> None:
    """All pairs, then the summary."""
    make_folder(config.out.parent)
    world, estimator = load_world("benchmark"), load_estimator()
    meshes = _chosen(config)
    rows = []
    for kind, chosen in meshes.items():
        for name, mesh, group in track(chosen, kind):
            renderer = Renderer(mesh)
            for index in range(config.pairs):
                rng = np.random.default_rng([zlib.crc32(name.encode()), index])
                pair = sample_pair(rng, renderer, world, randomised(config.noise_mm / 1000), 0, np.pi)
                e = estimator.estimate(pair.current, pair.goal, pair.pivot_m)
                answers = np.stack([e.R_goal_current, *(R for R, _ in e.alternatives)])
                apart = np.degrees(so3.angle_difference(answers, pair.R_goal_current))
                aware = symmetric_error(group, e.R_goal_current, pair.R_goal_current, pair.R_camera_object)
                rows.append(
                    {
                        "object": name,
                        "symmetry": kind,
                        "elements": len(group.rotations),
                        "pair": index,
                        "alternatives": len(e.alternatives),
                        "confidence": f"{e.confidence:.4f}",
                        "error_deg": f"{apart[0]:.4f}",
                        "error_sym_deg": f"{np.degrees(aware):.4f}",
                        "nearest_deg": f"{apart.min():.4f}",
                    }
                )
    write_table(config.out, rows)
    for kind in meshes:
        mine = [row for row in rows if row["symmetry"] == kind]
        for what, hits in (
            ("right but for symmetry", [float(str(row["error_sym_deg"])) < CORRECT_DEG for row in mine]),
            ("right", [float(str(row["error_deg"])) < CORRECT_DEG for row in mine]),
            (
                "the true rotation is the answer or an alternative",
                [float(str(row["nearest_deg"])) < CORRECT_DEG for row in mine],
            ),
            ("no alternatives", [row["alternatives"] == 0 for row in mine]),
        ):
            low, high = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
            print(f"{kind}: {what}: {np.mean(hits):.1%} ({low:.0%}-{high:.0%}) of {len(hits)}")


def _chosen(config: Alternatives) -> dict[str, list[tuple[str, trimesh.Trimesh, SymmetryGroup]]]:
    """As many objects with a finite symmetry group as without symmetry."""
    source = config.source.open()
    meshes: dict[str, list[tuple[str, trimesh.Trimesh, SymmetryGroup]]] = {"finite": [], "none": []}
    for name in sorted(source.names, key=lambda name: zlib.crc32(f"alternatives {name}".encode())):
        mesh = source.load(name)
        group = rotation_group(mesh)
        finite = len(group.rotations) > 1 and not len(group.axes) and not group.spherical
        kind = "finite" if finite else "none" if is_distinctive(mesh) else None
        if kind and len(meshes[kind]) < config.objects:
            meshes[kind].append((name, mesh, group))
        if min(map(len, meshes.values())) == config.objects:
            break
    return meshes


if __name__ == "__main__":
    main(parse(Alternatives, "benchmarks/alternatives.py", sys.argv[1:]))
