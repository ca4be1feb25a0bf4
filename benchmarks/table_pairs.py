"""Objects on a table that is in the image: by which options is the rotation found, and when is the frame refused?

    python benchmarks/table_pairs.py results/table-pairs.csv.gz --meshes FOLDER --only results/household-reporting.txt

An object of 3-15 cm lies on a table that a camera like a RealSense sees at 30-70 degrees from above, with noise of
1-2 mm. It is rotated by 20-180 degrees about the table's normal; the table stays. One row for each pair and way of
isolating it: the exact mask; a box and a largest depth, as in the README; the plane removed from the whole frame;
the plane removed within the box; the difference to a frame of the empty table.
"""

import sys
import time
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from rich.progress import track
from tabletop import Scene, box_around, camera_above, iou, lying, spin, table

from reorient import load_estimator
from reorient.cli.arguments import Positional, parse
from reorient.errors import ReorientError
from reorient.estimators.base import Estimator
from reorient.imaging import DepthImage, Isolation
from reorient.runs.files import make_folder, write_table
from reorient.so3 import angle_difference
from reorient.world.objects import ObjectSource
from reorient.world.symmetry import rotation_group, symmetric_error

WAYS = ("mask", "limits", "plane", "box and plane", "background")
RIGHT_DEG, SURE = 5.0, 0.9
FEWEST_PX = 300  # returns that an object shows at least in both frames


@dataclass(frozen=True)
class TablePairs:
    """Rotations of objects on a table that stays, by the way of isolating them."""

    out: Positional[Path]
    """CSV.gz to write."""
    source: ObjectSource = field(default_factory=ObjectSource)
    pairs: int = 300
    ways: tuple[str, ...] = WAYS
    estimator: str = "default"
    seed: int = 0


@dataclass(frozen=True)
class TablePair:
    """Two raw frames and what is known about them."""

    frames: tuple[DepthImage, DepthImage]
    seen: tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]
    """The pixels that show the object."""
    empty: DepthImage
    R_camera_object: Float[np.ndarray, "3 3"]
    """Of the current frame."""
    R_goal_current: Float[np.ndarray, "3 3"]
    about: dict[str, Any]


def main(config: TablePairs) -> None:
    """All rows, then the summary."""
    make_folder(config.out.parent)
    source, estimator = config.source.open(), load_estimator(config.estimator)
    rows: list[dict[str, Any]] = []
    for index in track(range(config.pairs), "pairs"):
        name = source.names[index % len(source.names)]
        rng = np.random.default_rng([config.seed, index, zlib.crc32(name.encode())])
        mesh, pair = drawn(rng, source.load(name))
        group = rotation_group(mesh)
        for way in config.ways:
            cells = measured(pair, isolations(pair, way, rng), estimator)
            if (R := cells.pop("R")) is not None:
                error = symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object)
                cells["error_sym_deg"] = f"{np.degrees(error):.3f}"
                cells["error_deg"] = f"{np.degrees(angle_difference(R, pair.R_goal_current)):.3f}"
            rows.append({"pair": index, "object": name, "way": way} | pair.about | cells)
        columns = list(dict.fromkeys(column for row in rows for column in row))
        write_table(config.out, [{column: str(row.get(column, "")) for column in columns} for row in rows])
    for way in config.ways:
        print(summary(way, [row for row in rows if row["way"] == way]))


def drawn(rng: np.random.Generator, mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, TablePair]:
    """The object as it lies, and a pair in which it shows enough returns."""
    for _ in range(50):
        lain = lying(mesh, rng, rng.uniform(0.03, 0.15))
        elevation_deg, distance_m = rng.uniform(30, 70), rng.uniform(0.35, 0.7)
        noise_m, angle_rad = rng.uniform(0.001, 0.002), np.radians(rng.uniform(20, 180)) * rng.choice([-1, 1])
        T = camera_above(rng, np.radians(elevation_deg), distance_m, np.array([0, 0, 0.02]))
        moved = lain.copy().apply_transform(spin(angle_rad, (*rng.uniform(-0.02, 0.02, 2), 0.0)))
        scenes = [Scene((table(), each), T) for each in (lain, moved)]
        (now, now_owner), (goal, goal_owner) = (scene.capture(rng, noise_m) for scene in scenes)
        seen = now_owner == 1, goal_owner == 1
        height_mm = 1000 * float(np.ptp(lain.bounds[:, 2]))
        if (
            height_mm < 5
            or min(np.count_nonzero(x.valid & s) for x, s in zip((now, goal), seen, strict=True)) < FEWEST_PX
        ):
            continue
        empty, _ = Scene((table(),), T).capture(rng, noise_m)
        R = T[:3, :3]
        about = {
            "elevation_deg": f"{elevation_deg:.1f}",
            "distance_m": f"{distance_m:.3f}",
            "noise_mm": f"{1000 * noise_m:.2f}",
            "angle_deg": f"{abs(np.degrees(angle_rad)):.2f}",
            "height_mm": f"{height_mm:.1f}",
            "pixels": np.count_nonzero(now.valid & seen[0]),
        }
        return lain, TablePair((now, goal), seen, empty, R, R @ spin(angle_rad)[:3, :3] @ R.T, about)
    raise ReorientError("an object shows fewer than 300 returns in 50 pairs: expected a larger surface")


def isolations(pair: TablePair, way: str, rng: np.random.Generator) -> list[tuple[Isolation, Any]]:
    """For each frame the isolation and the mask."""
    if way == "mask":
        return [(Isolation(), seen) for seen in pair.seen]
    if way == "background":
        return [(Isolation(background=pair.empty), None)] * 2
    if way == "plane":
        return [(Isolation(remove_plane=True), None)] * 2
    box_px = box_around(pair.seen[0] | pair.seen[1], int(rng.integers(10, 60)))
    if way == "box and plane":
        return [(Isolation(box_px=box_px, remove_plane=True), None)] * 2
    farthest_m = max(float(x.depth_m[s].max()) for x, s in zip(pair.frames, pair.seen, strict=True))
    far_m = rng.choice([0.9, farthest_m + rng.uniform(0.0, 0.05)])
    return [(Isolation(box_px=box_px, far_m=float(far_m)), None)] * 2


def measured(pair: TablePair, ways: list[tuple[Isolation, Any]], estimator: Estimator) -> dict[str, Any]:
    """The cells of a row; R is None where the frames were refused."""
    begin = time.process_time()
    cells: dict[str, Any] = {"R": None}
    try:
        images = [isolate(frame, mask) for (isolate, mask), frame in zip(ways, pair.frames, strict=True)]
        cells["isolation_s"] = f"{time.process_time() - begin:.3f}"
        for name, image, frame, seen in zip(("now", "goal"), images, pair.frames, pair.seen, strict=True):
            cells[f"iou_{name}"] = f"{iou(image.valid, seen & frame.valid):.4f}"
        estimate = estimator.estimate(images[0], images[1])
    except ReorientError as error:
        return cells | {"refusal": str(error)}
    return cells | {"R": estimate.R_goal_current, "confidence": f"{estimate.confidence or 0:.4f}"}


def summary(way: str, rows: list[dict[str, Any]]) -> str:
    answers = [row for row in rows if "refusal" not in row]
    right = [float(row["error_sym_deg"]) < RIGHT_DEG for row in answers]
    sure = [ok for row, ok in zip(answers, right, strict=True) if float(row["confidence"]) >= SURE]
    overlap = np.array([float(row[f"iou_{name}"]) for row in answers for name in ("now", "goal")])
    return (
        f"{way:14s} {len(rows)} pairs, {len(rows) - len(answers)} refused, {sum(right)} right, sure {len(sure)} of "
        f"which {sum(sure)} right; IoU median {np.median(overlap) if len(overlap) else np.nan:.3f}, "
        f"below 0.9: {np.mean(overlap < 0.9) if len(overlap) else np.nan:.0%}"
    )


if __name__ == "__main__":
    main(parse(TablePairs, "benchmarks/table_pairs.py", sys.argv[1:]))
