"""Of two poses that both match the goal, which is chosen? By inlier ratios, and by depth differences.

    python benchmarks/lookalikes.py results/lookalikes.csv.gz --meshes FOLDER --only results/household-tuning.txt

Objects without symmetry are seen from random sides; a half or quarter turn about a principal axis that, free of noise,
shows nearly the same makes a look-alike. Both poses are then captured as a loop would, within 0.2 degrees an axis of
the goal's and of the look-alike's. One row a look-alike and number of captures: what speaks for the right pose.
"""

import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float
from rich.progress import track

from reorient import load_estimator, so3
from reorient.cli.arguments import Positional, parse
from reorient.controller.arrival import ArrivalTest, Observation, PreparedImage
from reorient.estimators.base import Estimator
from reorient.registration import DepthView, build_problem, refine
from reorient.runs.files import make_folder, write_table
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import ObjectSource
from reorient.world.rendering import load_world
from reorient.world.sensing import Sensor, randomised
from reorient.world.statistics import is_distinctive

WORLD = load_world("benchmark")
ALIKE_RMS_M, FAR_OFF_M, MOST_FAR_OFF = 0.002, 0.01, 0.06  # what counts as nearly the same
TOLERANCES = (0.06, 0.04, 0.025, 0.015, 0.01, 0.006, 0.004)  # relative to the object diameter
TEST = ArrivalTest()
ARRIVAL_RAD = float(np.radians(0.2))


@dataclass(frozen=True)
class Lookalikes:
    """Of two poses that both match the goal, which is chosen? By inlier ratios, and by depth differences."""

    out: Positional[Path]
    """CSV.gz to write."""
    source: ObjectSource = field(default_factory=ObjectSource)
    views: int = 16
    """Of each object."""
    draws: int = 2
    """Of the noise."""
    captures: tuple[int, ...] = (2, 4)
    """Of each pose."""
    noise_mm: float = 1.0


def main(config: Lookalikes) -> None:
    """All rows, then the summary."""
    make_folder(config.out.parent)
    source, estimator = config.source.open(), load_estimator()
    rows = []
    for name in track(source.names, "look-alikes"):
        mesh = source.load(name)
        if not is_distinctive(mesh):
            continue
        for view in range(config.views):
            rng = np.random.default_rng([zlib.crc32(name.encode()), view])
            station = RenderedStation(mesh, WORLD, Sensor(), rng)
            found = _lookalike(station, mesh)
            if found is None:
                continue
            R_other, rms_mm = found
            arrivals = RenderedStation(
                mesh, WORLD, randomised(config.noise_mm / 1000), rng, station.R_camera_object.copy()
            )
            arrivals.placement, arrivals.pivot_m = station.placement, station.pivot_m
            for draw in range(config.draws):
                for captures, nats, fits in _compared(
                    arrivals, station.R_camera_object, R_other, estimator, config, rng
                ):
                    rows.append(
                        {
                            "object": name,
                            "view": view,
                            "draw": draw,
                            "difference_mm": f"{rms_mm:.3f}",
                            "captures": captures,
                            "by_depths": f"{nats:.3f}",
                            "by_share": f"{fits:.3f}",
                        }
                    )
    write_table(config.out, [{key: str(value) for key, value in row.items()} for row in rows])
    for captures in config.captures:
        for low, high in ((0.0, 0.6), (0.6, 1.0), (1.0, 1.5), (1.5, 2.0)):
            cell = [r for r in rows if r["captures"] == captures and low <= float(str(r["difference_mm"])) < high]
            _summarise(f"{captures} captures, {low:g}-{high:g} mm", cell)
        _summarise(f"{captures} captures, all", [r for r in rows if r["captures"] == captures])


def _summarise(title: str, rows: list[dict[str, object]]) -> None:
    if not rows:
        return
    words = []
    for column, name in (("by_depths", "by depths"), ("by_share", "by inlier ratios")):
        for_right = np.array([float(str(row[column])) for row in rows])
        wrong = ", ".join(
            f"{np.mean(np.abs(for_right) > limit):.0%} decided by {limit} ({np.sum(for_right < -limit)} wrong)"
            for limit in (2, 3)
        )
        words.append(f"{name} {np.mean(for_right > 0):.0%} right, {wrong}")
    print(f"{title}, n={len(rows)}: {'; '.join(words)}")


def _lookalike(station: RenderedStation, mesh: trimesh.Trimesh) -> tuple[Float[np.ndarray, "3 3"], float] | None:
    """The orientation that looks most like the station's, settled, and the RMS depth difference in mm."""
    goal, R_goal = station.capture_goal(), station.R_camera_object
    found: list[tuple[float, Float[np.ndarray, "3 3"]]] = []
    try:
        axes = mesh.principal_inertia_vectors @ R_goal.T
        for rotation in (*so3.exp(np.pi * axes), *so3.exp(np.pi / 2 * axes)):
            station.R_camera_object = rotation @ R_goal
            image = station.capture_goal()
            problem = build_problem(image, goal, None)
            aligned = refine(problem, problem.start(np.eye(3)[None]), TOLERANCES, 1500)
            if float(so3.angle(aligned.R[0])) > TEST.same_rad:
                continue
            warped = DepthView(image).warp(((goal.points() - aligned.t_m[0]) @ aligned.R[0]).T)
            missing = warped.silhouette_violation()
            off = np.minimum(np.abs(warped.difference_m[~missing]), FAR_OFF_M)
            far_off = np.mean(missing | (np.abs(warped.difference_m) > FAR_OFF_M))
            if off.size and far_off < MOST_FAR_OFF and np.sqrt(np.mean(off**2)) < ALIKE_RMS_M:
                found.append((1000 * float(np.sqrt(np.mean(off**2))), aligned.R[0] @ rotation @ R_goal))
    except np.linalg.LinAlgError:  # a mesh without inertia
        return None
    finally:
        station.R_camera_object = R_goal
    best = min(found, key=lambda pair: pair[0], default=None)
    return None if best is None else (best[1], best[0])


def _compared(
    station: RenderedStation,
    R_goal: Float[np.ndarray, "3 3"],
    R_other: Float[np.ndarray, "3 3"],
    estimator: Estimator,
    config: Lookalikes,
    rng: np.random.Generator,
) -> Iterator[tuple[int, float, float]]:
    """By number of captures: log-odds of the right pose against the other, by depths and by inlier ratios."""
    station.R_camera_object = R_goal
    goal = PreparedImage(station.capture_goal())
    observed: list[list[Observation]] = []
    for R in (R_goal, R_other):
        station.R_camera_object = so3.exp(rng.normal(0, ARRIVAL_RAD, 3)) @ R
        images = [station.capture() for _ in range(max(config.captures))]
        observed.append([Observation(x, estimator.estimate(x, goal.image, station.pivot_m)) for x in images])
    for count in config.captures:
        right, other = (x[:count] for x in observed)
        if any(all(x.estimate.angle_rad > TEST.same_rad for x in pose) for pose in (right, other)):
            continue  # not an arrival: no estimate stays
        nats = count * (TEST.depth_nll(other, goal) - TEST.depth_nll(right, goal))
        yield count, nats, TEST.log_odds(right, goal) - TEST.log_odds(other, goal)


if __name__ == "__main__":
    main(parse(Lookalikes, "benchmarks/lookalikes.py", sys.argv[1:]))
