"""Ten frames of an unprepared bench, isolated with at most two options each: how well do the pixels agree?

    python benchmarks/bench_scenes.py results/bench-scenes.csv.gz --show out/bench

Table, walls, the edge of the table, a tray, other parts beside the object, a gripper that holds it. One row for each
frame and draw of objects, camera and noise: the options, and the intersection over union of the returns that were
kept with those that show the object. ``--show`` also draws each frame as ``reorient estimate --show-input`` does.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator
from rich.progress import track
from scipy import ndimage
from tabletop import Scene, block, box_around, camera_above, iou, lying, spin, table

from reorient.cli.arguments import Positional, parse
from reorient.errors import ReorientError
from reorient.imaging import DepthImage, Isolation
from reorient.reporting.inputs import picture
from reorient.runs.files import make_folder, write_table
from reorient.world.objects import ObjectSource


@dataclass(frozen=True)
class BenchScenes:
    """Isolation of an object on an unprepared bench."""

    out: Positional[Path]
    """CSV.gz to write."""
    source: ObjectSource = field(default_factory=lambda: ObjectSource(count=60, object_seed=7))
    draws: int = 5
    """Of each frame."""
    noise_mm: float = 1.5
    show: Path | None = None
    """Folder for pictures of the first draw, and of those below 0.95."""


@dataclass(frozen=True)
class Bench:
    """A drawn scene; mesh 0 is the object."""

    scene: Scene
    rng: Generator
    noise_m: float
    frame: DepthImage
    seen: Bool[np.ndarray, "h w"]
    """The pixels that show the object."""

    def box(self) -> dict[str, Any]:
        return {"box_px": box_around(self.seen, 12)}

    def sphere(self) -> dict[str, Any]:
        """A sphere as a user would give it: its centre some centimetres off."""
        points_m = self.frame.camera.rays()[self.returned] * self.frame.depth_m[self.returned][:, None]
        middle_m = points_m.mean(axis=0)
        radius_m = float(np.linalg.norm(points_m - middle_m, axis=1).max()) + 0.015
        return {"around_m": tuple(middle_m + self.rng.uniform(-0.005, 0.005, 3)), "radius_m": radius_m}

    def background(self) -> dict[str, Any]:
        empty = Scene(self.scene.meshes[1:], self.scene.T_camera_world)
        return {"background": empty.capture(self.rng, self.noise_m)[0]}

    @property
    def returned(self) -> Bool[np.ndarray, "h w"]:
        return np.asarray(self.seen & self.frame.valid)


WALLS = (block((-1.5, 0.35, 0.0), (1.5, 0.4, 1.2)), block((-0.6, -1.5, 0.0), (-0.55, 1.5, 1.2)))
FLOOR = table(6.0).apply_translation([0.0, 0.0, -0.75])
TRAY = [
    block((-0.16, -0.12, 0.0), (0.16, 0.12, 0.003)),
    block((-0.165, -0.125, 0.0), (-0.16, 0.125, 0.025)),
    block((0.16, -0.125, 0.0), (0.165, 0.125, 0.025)),
    block((-0.165, -0.125, 0.0), (0.165, -0.12, 0.025)),
    block((-0.165, 0.12, 0.0), (0.165, 0.125, 0.025)),
]
FINGERS = [
    block((-0.075, -0.012, -0.02), (-0.055, 0.012, 0.1)),
    block((0.055, -0.012, -0.02), (0.075, 0.012, 0.1)),
    block((-0.09, -0.03, 0.1), (0.09, 0.03, 0.2)),
]


def parts(rng: Generator, source: Any, gap_m: float, count: int = 4) -> list[trimesh.Trimesh]:
    """Other parts around an object at the origin of about 10 cm."""
    placed = []
    for i in range(count):
        mesh = lying(source.load(source.names[int(rng.integers(len(source.names)))]), rng, rng.uniform(0.05, 0.12))
        radius_m = float(np.linalg.norm(mesh.bounds[1, :2]))
        angle_rad = 2 * np.pi * (i + rng.uniform(-0.15, 0.15)) / count
        away_m = 0.055 + gap_m + radius_m
        placed.append(mesh.apply_transform(spin(0.0, (away_m * np.cos(angle_rad), away_m * np.sin(angle_rad), 0.0))))
    return placed


def held(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, list[trimesh.Trimesh]]:
    """An object between two fingers above the table."""
    mesh = mesh.copy().apply_scale(0.11 / float(np.ptp(mesh.bounds[:, 0])))
    mesh.apply_translation([0, 0, 0.2 - mesh.bounds.mean(axis=0)[2]])
    return mesh, [finger.copy().apply_translation([0, 0, 0.2]) for finger in FINGERS]


def sloppy_mask(bench: Bench, gripper: int) -> Bool[np.ndarray, "h w"]:
    """A mask with 2 pixels of background around the object, but none of the meshes from this index on."""
    _, owner = bench.scene.capture(np.random.default_rng(0), 0.0)
    return np.asarray(ndimage.binary_dilation(bench.seen, np.ones((3, 3)), 2) & (owner < gripper))


Options = Callable[[Bench], tuple[dict[str, Any], Any]]
PLANE = {"remove_plane": True}
FRAMES: dict[str, Options] = {
    "table": lambda b: (PLANE, None),
    "low object on a table, walls": lambda b: (PLANE | b.box(), None),
    "table and walls": lambda b: (PLANE | b.sphere(), None),
    "edge of a table, floor, walls": lambda b: (PLANE | b.box(), None),
    "parts beside it": lambda b: (PLANE | b.sphere(), None),
    "parts beside it, in a box": lambda b: (PLANE | b.box(), None),
    "tray": lambda b: (PLANE | b.box(), None),
    "tray and parts, empty frame": lambda b: (b.background(), None),
    "gripper, empty frame": lambda b: (b.background(), None),
    "gripper, sloppy mask": lambda b: ({}, sloppy_mask(b, 2)),
}


def drawn(name: str, rng: Generator, source: Any, noise_m: float) -> Bench:
    """A frame with at least 400 returns from the object, most of them of parts at least 5 pixels wide: no wires."""
    while True:
        mesh = lying(source.load(source.names[int(rng.integers(len(source.names)))]), rng, 0.11)
        if name.startswith("low"):
            mesh = block((-0.045, -0.03, 0.0), (0.045, 0.02, 0.006)).union(
                block((0.02, -0.03, 0.0), (0.045, 0.04, 0.006))
            )
        elif np.ptp(mesh.bounds[:, 2]) < 0.02:
            continue
        rest: list[trimesh.Trimesh] = [block((-0.3, -0.4, -0.03), (0.3, 0.25, 0.0)) if "edge" in name else table()]
        if "gripper" in name:
            mesh, fingers = held(mesh)
            rest = [rest[0], *WALLS, *fingers] if "empty" in name else [rest[0], *fingers]
        if "walls" in name:
            rest += WALLS
        if "edge" in name:
            rest.append(FLOOR)
        if "tray" in name:
            rest += TRAY
            mesh.apply_translation([0.0, 0.0, 0.003])
        if "parts" in name:
            rest += parts(rng, source, 0.16 if "tray" in name else 0.03)
        target_m = np.array([0.0, 0.0, float(mesh.bounds[:, 2].mean())])
        T = camera_above(rng, np.radians(rng.uniform(35, 65)), rng.uniform(0.45, 0.65), target_m)
        if "walls" in name:  # from the side of the table that has none
            T = camera_towards_walls(rng, target_m)
        scene = Scene((mesh, *rest), T)
        frame, owner = scene.capture(rng, noise_m)
        seen = owner == 0
        thick = ndimage.binary_opening(seen, np.ones((5, 5)))
        if np.count_nonzero(seen & frame.valid) >= 400 and np.count_nonzero(thick) > 0.8 * np.count_nonzero(seen):
            return Bench(scene, rng, noise_m, frame, seen)


def camera_towards_walls(rng: Generator, target_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    while True:
        T = camera_above(rng, np.radians(rng.uniform(25, 45)), rng.uniform(0.45, 0.6), target_m)
        towards = T[2, :3]
        if towards[1] > 0.5 and towards[0] < 0:
            return T


def main(config: BenchScenes) -> None:
    """All rows, the pictures, then the summary."""
    make_folder(config.out.parent)
    source = config.source.open()
    rows: list[dict[str, Any]] = []
    for name in track(FRAMES, "frames"):
        for draw in range(config.draws):
            rng = np.random.default_rng([*name.encode(), draw])
            bench = drawn(name, rng, source, config.noise_mm / 1000)
            options, mask = FRAMES[name](bench)
            row: dict[str, Any] = {
                "frame": name,
                "draw": draw,
                "options": " ".join([*options, *(["mask"] if mask is not None else [])]),
            }
            try:
                isolated = Isolation(**options)(bench.frame, mask)
                row |= {"iou": f"{iou(isolated.valid, bench.returned):.4f}", "refusal": ""}
            except ReorientError as error:
                row |= {"iou": "0", "refusal": str(error)}
                isolated = Isolation(**options, allow_touching=True)(bench.frame, mask)
            rows.append(row)
            if config.show is not None and (draw == 0 or float(row["iou"]) < 0.95):
                make_folder(config.show)
                picture([(name, bench.frame, isolated)]).save(config.show / f"{name.replace(' ', '-')}-{draw}.png")
    write_table(config.out, [{key: str(value) for key, value in row.items()} for row in rows])
    for name in FRAMES:
        mine = [row for row in rows if row["frame"] == name]
        shares = np.array([float(row["iou"]) for row in mine])
        refusals = "; ".join(row["refusal"] for row in mine if row["refusal"])
        print(f"{name:30s} IoU {np.round(shares, 3)} {refusals[:300]}")


if __name__ == "__main__":
    main(parse(BenchScenes, "benchmarks/bench_scenes.py", sys.argv[1:]))
