"""Position error of a tool pose that ``reorient.transfer`` takes to where the object is.

    python benchmarks/transfer.py results/transfer.csv.gz --meshes FOLDER --only results/household-reporting.txt
    python benchmarks/transfer.py out/transfer.csv.gz --count 60 --object-seed 100 --pairs 50

Pairs of images as of ``reorient evaluate``: the object rotates about its centre, the camera has a random pose in base
axes. The taught pose is 50 mm from the centre, in a random direction. A row for each pair has the error of the
transferred position, the standard deviation that ``transfer`` states for it, the rotation error, and the confidence.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from reorient import load_estimator, se3, so3, transfer
from reorient.cli.arguments import Positional, parse
from reorient.cli.progress import show_progress
from reorient.reporting.rows import numbers
from reorient.runs.files import write_table
from reorient.runs.run import Row
from reorient.se3 import Transform
from reorient.world.objects import ObjectSource
from reorient.world.pairs import Pair, sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised

OFF_CENTRE_M = 0.05
SURE = 0.9


@dataclass(frozen=True)
class Settings:
    """Position error of a tool pose that ``reorient.transfer`` takes to where the object is."""

    out: Positional[Path]
    """Table of rows to write (.csv.gz)."""
    objects: ObjectSource = field(default_factory=ObjectSource)
    pairs: int = 200
    """Number of pairs, of one object each in turn."""
    noise_mm: float = 1.0
    """Standard deviation of the depth noise."""
    range_deg: tuple[float, float] = (0.0, 90.0)
    """Smallest and largest rotation between the images."""
    pivot: bool = False
    """Give the estimator the nominal pivot."""
    estimator: str = "default"
    """Estimator as of ``reorient estimate``."""


def measure(settings: Settings, name: str, index: int) -> Row:
    """The row of a pair."""
    renderer = Renderer(settings.objects.open().load(name))
    rng = np.random.default_rng([7, index])
    low_rad, high_rad = np.radians(settings.range_deg)
    pair = sample_pair(rng, renderer, load_world("benchmark"), randomised(settings.noise_mm / 1000), low_rad, high_rad)
    estimate = load_estimator(settings.estimator).estimate(
        pair.current, pair.goal, pair.pivot_m if settings.pivot else None
    )
    T_base_camera = se3.transform(so3.sample_uniform(rng, 1)[0], rng.uniform(-1, 1, 3))
    on_object_m = pair.placement.center_m + OFF_CENTRE_M * so3.sample_axes(rng, 1)[0]
    taught = T_base_camera @ se3.transform(so3.sample_uniform(rng, 1)[0], on_object_m)
    result = transfer(estimate, T_base_camera, taught)
    truth = T_base_camera @ se3.inverse(_motion(pair)) @ se3.inverse(T_base_camera) @ taught
    error_m = float(np.linalg.norm(result.T_base_tool[0, :3, 3] - truth[:3, 3]))
    std_mm = "" if result.position_std_m is None else f"{1000 * result.position_std_m[0]:.3f}"
    return {
        "object": name,
        "pair": str(index),
        "angle_deg": f"{np.degrees(so3.angle(pair.R_goal_current)):.2f}",
        "error_mm": f"{1000 * error_m:.3f}",
        "std_mm": std_mm,
        "error_deg": f"{np.degrees(so3.angle_difference(estimate.R_goal_current, pair.R_goal_current)):.3f}",
        "confidence": "" if estimate.confidence is None else f"{estimate.confidence:.4f}",
    }


def _motion(pair: Pair) -> Transform:
    """The true T_goal_current: a rotation about the object's centre."""
    center_m = pair.placement.center_m
    return se3.transform(pair.R_goal_current, center_m - pair.R_goal_current @ center_m)


def summary(rows: list[Row]) -> str:
    """The figures in words, of all pairs and of the sure ones."""
    error_mm, confidence = numbers(rows, "error_mm"), np.nan_to_num(numbers(rows, "confidence"))
    lines = []
    for label, chosen in (("all", np.ones(len(rows), bool)), (f"confidence from {SURE}", confidence >= SURE)):
        if chosen.any():
            mine = error_mm[chosen]
            lines.append(
                f"{label}: {chosen.sum()} pairs, median {np.median(mine):.2f} mm, 90% below "
                f"{np.percentile(mine, 90):.2f} mm, within 2 mm {np.mean(mine <= 2):.1%}, error over stated deviation "
                f"{np.median(mine / numbers(rows, 'std_mm')[chosen]):.2f} (median)"
            )
    return "\n".join(lines)


def main(settings: Settings) -> None:
    """Measure, write, print."""
    names = settings.objects.open().names
    rows: list[Row] = []

    def states() -> Iterator[tuple[int, int]]:
        for index in range(settings.pairs):
            rows.append(measure(settings, names[index % len(names)], index))
            yield index + 1, settings.pairs

    show_progress("pairs", states())
    write_table(settings.out, rows)
    print(summary(rows))


if __name__ == "__main__":
    main(parse(Settings, "transfer", sys.argv[1:]))
