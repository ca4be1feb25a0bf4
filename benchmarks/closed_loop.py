"""The closed loop: how close, how many moves, and whether failures are announced. Raw rows, then a table on screen.

    python benchmarks/closed_loop.py out/loops --meshes FOLDER --only NAMES --systems default/fusing --starts-deg 30 0
    python benchmarks/closed_loop.py out/faults --meshes FOLDER --only NAMES --faults 0.1 --systems default/fusing

A start of 0 degrees means any rotation, uniform over SO(3). The goal image is unoccluded, each current image bears a
new rectangle, and the pivot is up to 1 cm wrong along each axis. Every system meets the same starts. Errors are
symmetry-aware and of the true pose. A run that is interrupted goes on where it stopped; one folder holds all systems.
"""

import csv
import gzip
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.progress import track

from reorient import Limits, load_estimator, load_strategy, orient, so3
from reorient.controller import Strategy
from reorient.errors import ReorientError
from reorient.runs.files import make_folder, write_table
from reorient.stations.faulty import FaultyStation
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import ObjectSource
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised
from reorient.world.statistics import is_distinctive
from reorient.world.symmetry import SymmetryGroup, rotation_group, symmetric_error

STRATEGIES: dict[str, Strategy] = {
    "algorithm1": load_strategy("algorithm1"),  # K = 100, eta = 0.2, delta = 0.5 degrees: the paper's simulation
    "fusing": load_strategy("fusing"),
    "fusing-history": load_strategy("fusing", history=True),
    # As many captures as fusing takes (rounded up), each followed by the whole estimated rotation:
    "memoryless": load_strategy("direct", max_images=9, delta_rad=0.0, history=False),
}
KEY = ("object", "trial", "noise_mm", "start_deg", "slack_deg", "faults", "system")


@dataclass(frozen=True)
class ClosedLoop:
    """What to run."""

    out: tyro.conf.Positional[Path]
    """Folder for rows.csv.gz."""
    source: tyro.conf.OmitArgPrefixes[ObjectSource] = field(default_factory=ObjectSource)
    objects: int = 22
    """How many objects of the source, drawn by a hash of the name."""
    trials: int = 20
    """Starts and goals of each."""
    systems: tuple[str, ...] = ("default/fusing", "default/memoryless", "default/algorithm1", "gicp/algorithm1")
    """Each an estimator and a strategy: fusing, fusing-history, memoryless or algorithm1."""
    starts_deg: tuple[float, ...] = (30.0, 0.0)
    """Angles between start and goal; 0: any rotation."""
    noise_mm: tuple[float, ...] = (1.0,)
    slack_deg: float = 0.0
    """Error of a turn of 30 degrees or more, unknown to the robot; less in proportion for smaller ones."""
    faults: float = 0.0
    """Chance of a fault at each capture and each move, of every kind that a station knows."""
    symmetric: bool = False
    """Take objects with a symmetry (or flat, or of few faces), instead of all that the source names."""


def main(config: ClosedLoop) -> None:
    """All trials, then the summary."""
    for system in config.systems:
        _system(system)
    make_folder(config.out)
    names = _names(config)
    cells = [
        (name, noise, start, index)
        for index in range(config.trials)
        for name in names
        for noise in config.noise_mm
        for start in config.starts_deg
    ]
    path = config.out / "rows.csv.gz"
    rows = _read(path)
    known = {tuple(row[key] for key in KEY) for row in rows}
    for count, cell in enumerate(track(cells, "loops")):
        rows += _rows(config, *cell, known)
        if count % 20 == 19:
            write_table(path, rows)
    write_table(path, rows)
    summarise(rows)


def _rows(
    config: ClosedLoop, name: str, noise_mm: float, start_deg: float, index: int, known: set[tuple[str, ...]]
) -> Iterator[dict[str, str]]:
    for system in config.systems:
        key = (
            name,
            str(index),
            f"{noise_mm:g}",
            f"{start_deg:g}",
            f"{config.slack_deg:g}",
            f"{config.faults:g}",
            system,
        )
        if key not in known:
            yield dict(zip(KEY, key, strict=True)) | _loop(config, name, noise_mm, start_deg, index, system)


def _loop(config: ClosedLoop, name: str, noise_mm: float, start_deg: float, index: int, system: str) -> dict[str, str]:
    """One loop from one start."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), index])
    mesh, group = _object(config.source, name)
    station = RenderedStation(mesh, load_world("benchmark"), randomised(noise_mm / 1000), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    turn = np.radians(start_deg)
    away = (
        so3.matrix_from_quat(so3.sample_bounded(rng, 1, turn, turn))[0] if start_deg else so3.sample_uniform(rng, 1)[0]
    )
    station.rotate(away)

    def left_deg() -> float:
        return float(
            np.degrees(symmetric_error(group, np.eye(3), R_goal @ station.R_camera_object.T, station.R_camera_object))
        )

    seen = FaultyStation(
        station,
        np.random.default_rng([zlib.crc32(name.encode()), index, 1]),
        config.faults,
        np.radians(config.slack_deg),
    )
    angle_deg, begin = left_deg(), time.process_time()
    estimator, strategy = _system(system)
    result = orient(seen, goal, estimator, strategy, limits=Limits(wait_s=0.0))
    plain = np.degrees(so3.angle_difference(station.R_camera_object, R_goal))
    return {
        "angle_deg": f"{angle_deg:.4f}",
        "moves": str(result.moves),
        "images": str(len(result.steps)),
        "converged": str(int(result.converged)),
        "confidence": "" if result.confidence is None else f"{result.confidence:.4f}",
        "final_deg": f"{left_deg():.4f}",
        "final_plain_deg": f"{plain:.4f}",
        "seconds": f"{time.process_time() - begin:.3f}",
        "faults_met": " ".join(seen.met),
        "reason": result.reason,
    }


def summarise(rows: list[dict[str, str]]) -> None:
    """A line for each start, noise and system."""
    groups: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in KEY[2:]), []).append(row)
    for (noise, start, slack, faults, system), chosen in sorted(groups.items()):
        final = np.array([float(row["final_deg"]) for row in chosen])
        moves, images = (np.array([int(row[key]) for row in chosen]) for key in ("moves", "images"))
        sure = np.array([row["converged"] == "1" and float(row["confidence"] or 1) >= 0.5 for row in chosen])
        failed = final > 1
        told = f"{np.mean(~sure[failed]):.0%} of {failed.sum()}" if failed.any() else "none failed"
        where = f"start {'any' if start == '0' else start + ' degrees'}, {noise} mm"
        where += f", slack {slack}" * (slack != "0") + f", faults {faults}" * (faults != "0")
        shares = ", ".join(f"{np.mean(final <= limit):.1%} within {limit:g}" for limit in (0.6, 1, 5))
        seconds = np.mean([float(row["seconds"]) for row in chosen])
        print(
            f"{system}, {where}, n={len(final)}: final error median {np.median(final):.2f}, "
            f"p90 {np.percentile(final, 90):.2f} degrees; {shares}; above 30: {np.mean(final > 30):.1%}; "
            f"moves median {np.median(moves):.0f}, at most {moves.max()}; images median {np.median(images):.0f}; "
            f"failures announced (above 1 degree): {told}; falsely converged above 5 degrees: "
            f"{np.mean(sure & (final > 5)):.1%}; {seconds:.1f} s (CPU) a loop"
        )


def _names(config: ClosedLoop) -> list[str]:
    objects = config.source.open()
    names = sorted(objects.names, key=lambda name: zlib.crc32(f"loop {name}".encode()))
    if config.symmetric:
        names = [name for name in names[: 6 * config.objects] if not is_distinctive(objects.load(name))]
    return names[: config.objects]


@lru_cache(maxsize=64)
def _object(source: ObjectSource, name: str) -> tuple[Any, SymmetryGroup]:
    mesh = source.open().load(name)
    return mesh, rotation_group(mesh)


@lru_cache
def _system(system: str) -> tuple[Any, Strategy]:
    estimator, _, strategy = system.partition("/")
    if strategy not in STRATEGIES:
        raise ReorientError(f"system {system!r}: expected an estimator and one of {', '.join(STRATEGIES)}")
    return load_estimator(estimator), STRATEGIES[strategy]


def _read(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with gzip.open(path, "rt", newline="") as file:
        return list(csv.DictReader(file))


if __name__ == "__main__":
    main(tyro.cli(ClosedLoop, description=__doc__))
