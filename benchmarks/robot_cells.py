"""How well a robot cell is calibrated by the object that it holds, and whether a check names its mistakes.

    python benchmarks/robot_cells.py calibrate results/robot-calibration.csv.gz --meshes FOLDER --only NAMES
    python benchmarks/robot_cells.py check results/robot-check.csv.gz --meshes FOLDER --only NAMES
    python benchmarks/robot_cells.py loops results/robot-loops.csv.gz --meshes FOLDER --only NAMES

Simulated cells: a random camera mounting, tool orientation and grasp, 1 mm of noise. ``calibrate``: one row a cell.
``check``: one row a cell, first right ones, then those with each planted mistake. ``loops``: two rows a cell, of a loop
from 60 degrees away with the true calibration and with the one found, from the same start.
"""

import sys
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.progress import track

from reorient import Limits, load_estimator, orient, se3, so3
from reorient.cli.arguments import Positional, parse
from reorient.errors import ReorientError
from reorient.perception.robot_calibration import RobotCalibration
from reorient.runs.files import make_folder, write_table
from reorient.stations.calibrating import calibrate
from reorient.stations.checking import check
from reorient.stations.faulty_cell import PLANTED, planted, random_calibration
from reorient.stations.guarded import GuardedArm, RobotLimits
from reorient.stations.robot import RobotStation
from reorient.stations.simulated import SimulatedArm, SimulatedCamera, SimulatedCell
from reorient.world.objects import ObjectSet, ObjectSource
from reorient.world.sensing import randomised

AT_ONCE = RobotLimits(settle_s=0.0)


@dataclass(frozen=True)
class RobotCells:
    """Which measurement, on which objects."""

    what: Positional[Literal["calibrate", "check", "loops"]]
    out: Positional[Path]
    """CSV.gz to write."""
    source: ObjectSource = field(default_factory=ObjectSource)
    cells: int = 40
    """Cells to calibrate or to run loops in, and right cells to check; each with an object drawn at random."""
    planted: int = 20
    """Cells with each mistake, for ``check``."""
    noise_mm: float = 1.0
    estimator: str = "default"
    start_deg: float = 60.0
    """Of the loops."""
    seed: int = 0


def main(config: RobotCells) -> None:
    """Measure and print."""
    make_folder(config.out.parent)
    objects = config.source.open()
    measure = {"calibrate": _calibrate, "check": _check, "loops": _loops}[config.what]
    rows = list(measure(config, objects))
    write_table(config.out, rows)
    {"calibrate": _print_calibrations, "check": _print_checks, "loops": _print_loops}[config.what](rows)


def _cell(config: RobotCells, objects: ObjectSet, kind: str, index: int) -> tuple[str, SimulatedCell]:
    rng = np.random.default_rng([config.seed, zlib.crc32(kind.encode()), index])
    name = objects.names[int(rng.integers(len(objects.names)))]
    return name, SimulatedCell(objects.load(name), rng, randomised(config.noise_mm / 1000))


def _calibrate(config: RobotCells, objects: ObjectSet) -> Iterator[dict[str, Any]]:
    estimator = load_estimator(config.estimator)
    for index in track(range(config.cells), "cells"):
        name, cell = _cell(config, objects, "calibrate", index)
        arm, begin_s = GuardedArm(SimulatedArm(cell), AT_ONCE), time.perf_counter()
        row: dict[str, Any] = {"cell": index, "object": name}
        try:
            found = calibrate(SimulatedCamera(cell), arm, estimator=estimator)
            values = _errors(cell, found, arm)
            refusal = ""
        except ReorientError as error:
            values, refusal = dict.fromkeys(_COLUMNS, ""), str(error)
        yield row | values | {"seconds": f"{time.perf_counter() - begin_s:.1f}", "refusal": refusal}


_COLUMNS = ("error_deg", "se_deg", "pivot_mm", "pivot_se_mm", "place_mm", "residual_deg", "motions", "motions_tried")


def _errors(cell: SimulatedCell, found: RobotCalibration, arm: GuardedArm) -> dict[str, Any]:
    pivot_m = se3.apply(se3.inverse(cell.T_base_camera) @ arm.pose(), found.p_tool_object_m)
    error_rad = so3.angle_difference(found.T_base_camera[:3, :3], cell.T_base_camera[:3, :3])
    values = (
        np.degrees(error_rad),
        found.rotation_se_deg,
        1000 * np.linalg.norm(found.pivot_m(arm.pose()) - pivot_m),
        1000 * (found.pivot_se_m or 0.0),
        1000 * np.linalg.norm(found.p_tool_object_m - cell.T_tool_object[:3, 3]),
        found.residual_deg,
    )
    texts = [f"{value:.4f}" for value in values]
    return dict(zip(_COLUMNS, [*texts, found.motions, found.motions_tried], strict=True))


def _check(config: RobotCells, objects: ObjectSet) -> Iterator[dict[str, Any]]:
    estimator = load_estimator(config.estimator)
    for mistake, count in {"": config.cells, **dict.fromkeys(PLANTED, config.planted)}.items():
        for index in track(range(count), mistake or "right"):
            name, cell = _cell(config, objects, f"check {mistake}", index)
            row: dict[str, Any] = {"planted": mistake, "cell": index, "object": name}
            camera, arm, calibration = planted(mistake, cell, random_calibration(cell, cell.rng))
            guarded = GuardedArm(arm, AT_ONCE, calibration.p_tool_object_m)
            try:
                found = check(camera, guarded, calibration, estimator=estimator)
                named, message = found.mistake, found.message
            except ReorientError as error:
                named, message = "refused", str(error)
            yield row | {"named": named, "right": int(named == mistake), "message": message}


def _loops(config: RobotCells, objects: ObjectSet) -> Iterator[dict[str, Any]]:
    estimator = load_estimator(config.estimator)
    for index in track(range(config.cells), "cells"):
        name, cell = _cell(config, objects, "loops", index)
        camera, arm = SimulatedCamera(cell), GuardedArm(SimulatedArm(cell), AT_ONCE)
        true = RobotCalibration(cell.T_base_camera, cell.T_tool_object[:3, 3])
        try:
            found = calibrate(camera, arm, estimator=estimator)
        except ReorientError:
            continue
        home, goal = arm.pose(), camera.capture()
        R_goal = cell.T_camera_object[:3, :3]
        axis = so3.sample_axes(cell.rng, 1)[0]
        for kind, calibration in (("true", true), ("found", found)):
            arm.move_to(home)
            RobotStation(camera, arm, true).rotate(so3.exp(axis * np.radians(config.start_deg)))
            station = RobotStation(camera, arm, calibration)
            result = orient(station, goal, estimator, limits=Limits(wait_s=0.0))
            away_rad = so3.angle_difference(cell.T_camera_object[:3, :3], R_goal)
            yield {
                "cell": index,
                "object": name,
                "calibration": kind,
                "status": result.status,
                "final_deg": f"{np.degrees(away_rad):.4f}",
                "moves": result.moves,
                "images": len(result.steps),
            }


def _print_calibrations(rows: list[dict[str, Any]]) -> None:
    done = [row for row in rows if not row["refusal"]]
    print(f"{len(done)} of {len(rows)} calibrated")
    for name, unit in (("error_deg", "deg"), ("pivot_mm", "mm"), ("place_mm", "mm")):
        values = np.array([float(row[name]) for row in done])
        print(f"{name:10s} median {np.median(values):.2f} {unit}, 95% below {np.percentile(values, 95):.2f} {unit}")
    ratio = [float(row["error_deg"]) / float(row["se_deg"]) for row in done]
    print(f"error over standard error: RMS {np.sqrt(np.mean(np.square(ratio))):.2f}")


def _print_checks(rows: list[dict[str, Any]]) -> None:
    for mistake in dict.fromkeys(row["planted"] for row in rows):
        mine = [row for row in rows if row["planted"] == mistake]
        print(f"{mistake or 'none':20s} {sum(row['right'] for row in mine)} of {len(mine)}")


def _print_loops(rows: list[dict[str, Any]]) -> None:
    for kind in ("true", "found"):
        mine = [row for row in rows if row["calibration"] == kind]
        final = np.array([float(row["final_deg"]) for row in mine])
        converged = sum(row["status"] == "converged" for row in mine)
        moves = np.mean([row["moves"] for row in mine])
        print(
            f"{kind} calibration: {len(mine)} loops, {converged} converged, median {np.median(final):.2f} deg, "
            f"{np.mean(final < 1):.0%} within 1 deg, {moves:.1f} moves"
        )


if __name__ == "__main__":
    main(parse(RobotCells, "benchmarks/robot_cells.py", sys.argv[1:]))
