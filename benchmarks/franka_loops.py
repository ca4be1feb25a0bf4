"""The whole procedure on the simulated Franka cell, by the commands of a user: calibrate, check, teach, orient.

    python benchmarks/franka_loops.py out/robot                       # once, with all that the commands print
    python benchmarks/franka_loops.py out/robot --trials 20 --rows results/robot-franka.csv.gz

The arm is franky-sim behind libfranka's protocol, on the dynamics of MuJoCo; the camera ray-casts the held object over
a table. Object, grasp and mounting of the camera are drawn anew in each trial. The goal is taught where the object is;
then the arm rotates it away, about a random axis. The final error is that of MuJoCo's poses. Needs the extras franka
and franka-sim.
"""

import gc
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reorient import so3
from reorient.cli.arguments import Positional, parse
from reorient.perception.robot_calibration import read_robot_calibration
from reorient.runs.files import make_folder, write_table
from reorient.se3 import Transform
from reorient.stations.franka_cell import FrankaCell
from reorient.stations.robot_file import read_robot_file


@dataclass(frozen=True)
class FrankaLoops:
    """How many trials, and from how far away."""

    out: Positional[Path]
    """Folder; each trial writes its robot.toml, calibration, goal, record and page to one in it."""
    trials: int = 1
    start_deg: float = 60.0
    """Angle by which the object is rotated away from its goal."""
    seed: int = 2
    """Of the first trial."""
    rows: Path | None = None
    """CSV.gz to write."""


def main(config: FrankaLoops) -> None:
    """Run the trials, print each, and then the medians."""
    rows = []
    for seed in range(config.seed, config.seed + config.trials):
        rows.append(_trial(config, seed))
        if config.rows is not None:
            write_table(config.rows, rows)
    if failed := [row for row in rows if row["status"] != "converged"]:
        print(f"{len(failed)} of {len(rows)} loops did not converge")
    final_deg = [float(row["final_deg"]) for row in rows if row["final_deg"]]
    if final_deg:
        print(
            f"{len(final_deg)} of {len(rows)} loops ended, by MuJoCo's poses {np.median(final_deg):.2f} deg (median) "
            f"and at most {max(final_deg):.2f} deg from the goal"
        )
    if config.trials == 1:
        sys.exit(bool(failed))


def _trial(config: FrankaLoops, seed: int) -> dict[str, Any]:
    begin_s = time.perf_counter()
    folder = make_folder(config.out / f"cell{seed}")
    row: dict[str, Any] = {"seed": seed, "status": "", "calibration_deg": "", "final_deg": "", "moves": ""}
    with FrankaCell(folder, seed) as cell:
        robot, goal, record = str(cell.robot_file), str(folder / "goal.npz"), folder / "record"
        codes = [_reorient("calibrate", robot, "--yes")]
        if not codes[0]:
            found = read_robot_calibration(folder / "calibration.json").T_base_camera
            row["calibration_deg"] = f"{_apart_deg(found, cell.T_base_camera):.3f}"
            codes += [_reorient("check", robot, "--yes"), _reorient("capture", goal, "--station", robot)]
        if not codes[-1]:
            T_goal = cell.T_camera_object
            _rotate_away(cell, config.start_deg, np.random.default_rng(seed))
            started_deg = _apart_deg(cell.T_camera_object, T_goal)
            print(f"the arm rotated the object away: {started_deg:.2f} deg by MuJoCo's poses", flush=True)
            words = ("--record", str(record), "--out", str(folder / "page"), "--yes")
            codes.append(_reorient("orient", goal, "--station", robot, *words))
            final_deg = _apart_deg(cell.T_camera_object, T_goal)
            print(f"final error by MuJoCo's poses: {final_deg:.2f} deg", flush=True)
            outcome = json.loads((record / "record.json").read_text())
            row |= {"status": outcome["status"], "final_deg": f"{final_deg:.3f}", "moves": _moves(outcome)}
        else:
            row["status"] = "refused"  # by calibration or capture, which says why
    return row | {"exit_codes": " ".join(map(str, codes)), "seconds": f"{time.perf_counter() - begin_s:.0f}"}


def _reorient(*words: str) -> int:
    """Run a command as a user does; its exit code."""
    print("$ reorient", *words, flush=True)
    return subprocess.run([sys.executable, "-m", "reorient", *words], check=False).returncode


def _rotate_away(cell: FrankaCell, angle_deg: float, rng: np.random.Generator) -> None:
    """Rotate the object about a random axis that the arm's joints allow, and disconnect."""
    station = read_robot_file(cell.robot_file).open_station()
    axes = so3.sample_axes(rng, 100)
    station.rotate(next(R for R in so3.exp(axes * np.radians(angle_deg)) if station.reachable(R)))
    del station
    gc.collect()  # the controller accepts one client


def _moves(outcome: dict[str, Any]) -> int:
    return sum("rotate" in act for act in outcome["acts"])


def _apart_deg(T_a: Transform, T_b: Transform) -> float:
    return float(np.degrees(so3.angle_difference(T_a[:3, :3], T_b[:3, :3])))


if __name__ == "__main__":
    main(parse(FrankaLoops, "benchmarks/franka_loops.py", sys.argv[1:]))
