"""Algorithm 1 in the closed loop: how close, how many moves. Raw rows as CSV.gz, a table on screen.

    python benchmarks/closed_loop.py out/loop.csv.gz --only NAMES --count 400 --object-seed 100
    python benchmarks/closed_loop.py out/loop.csv.gz --only NAMES --meshes FOLDER

Start 30 degrees from the goal, K=100, eta=0.2, delta=0.5 degrees as in the paper's simulation.
The goal image is unoccluded, each current image bears a new rectangle, the pivot is up to 1 cm wrong along each axis,
and the object turns exactly as asked. Errors are plain: name objects without symmetry.
"""

import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro
from rich.progress import track

from reorient import load_estimator, orient, so3
from reorient.files import make_folder, write_table
from reorient.objects import ObjectSource
from reorient.rendering import load_world
from reorient.sensing import randomised
from reorient.stations.rendered import RenderedStation


@dataclass(frozen=True)
class ClosedLoop:
    """What to run."""

    out: tyro.conf.Positional[Path]
    """CSV.gz to write."""
    source: tyro.conf.OmitArgPrefixes[ObjectSource] = field(default_factory=ObjectSource)
    objects: int = 20
    """How many objects of the source, drawn by a hash of the name."""
    trials: int = 20
    """Starts and goals of each."""
    noise_mm: tuple[float, ...] = (0.0, 1.0)
    estimator: str = "gicp"
    start_deg: float = 30.0


def trial(config: ClosedLoop, name: str, noise_mm: float, index: int) -> dict[str, object]:
    """One loop from one start."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), index])
    mesh = config.source.open().load(name)
    station = RenderedStation(mesh, load_world("benchmark"), randomised(noise_mm / 1000), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    turn = np.radians(config.start_deg)
    station.rotate(so3.matrix_from_quat(so3.sample_bounded(rng, 1, turn, turn))[0])
    result = orient(station, goal, load_estimator(config.estimator))
    error_deg = np.degrees(so3.angle_difference(station.R_camera_object, R_goal))
    return {
        "object": name,
        "trial": index,
        "noise_mm": noise_mm,
        "estimator": config.estimator,
        "start_deg": config.start_deg,
        "moves": result.moves,
        "converged": int(result.converged),
        "final_deg": f"{error_deg:.4f}",
        "reason": result.reason,
    }


def main(config: ClosedLoop) -> None:
    """All trials, then the summary."""
    make_folder(config.out.parent)
    names = sorted(config.source.open().names, key=lambda name: zlib.crc32(f"loop {name}".encode()))[: config.objects]
    cells = [(name, noise, index) for noise in config.noise_mm for name in names for index in range(config.trials)]
    rows = [trial(config, *cell) for cell in track(cells, "loops")]
    write_table(config.out, rows)
    for noise in config.noise_mm:
        chosen = [row for row in rows if row["noise_mm"] == noise]
        final = np.array([float(str(row["final_deg"])) for row in chosen])
        moves = np.array([int(str(row["moves"])) for row in chosen])
        shares = ", ".join(f"{np.mean(final <= limit):.1%} within {limit:g}" for limit in (0.6, 1, 5))
        print(
            f"{config.estimator}, {noise:g} mm, n={len(final)}: final error median {np.median(final):.2f}, "
            f"p90 {np.percentile(final, 90):.2f} degrees; {shares}; above 30: {np.mean(final > 30):.1%}; "
            f"moves median {np.median(moves):.0f}, at most {moves.max()}"
        )


if __name__ == "__main__":
    main(tyro.cli(ClosedLoop, description=__doc__))
