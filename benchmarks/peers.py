"""Global registration by others, on the same pairs as ``reorient evaluate`` draws: rows as its own, a table on screen.

    pip install 'reorient[peers]'
    python benchmarks/peers.py out/peers --count 100 --pairs 60
    python benchmarks/peers.py results/peers --meshes FOLDER --only results/household-reporting.txt

All are given the points of the two images and nothing else: none has a use for a pivot. ``gicp120`` is GICP from 120
rotations. Their settings are the best of ``--tuning``, which measures what was tried; chosen on 45 pairs of objects of
results/household-tuning.txt (15 for each of 30-60, 60-90 and 90-180 degrees, 1 mm; ``gicp120`` on 30).
A peer that does not import here (open3d needs the system's libusb and libGL) is named below the table, and left out.
"""

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console

from registration import Fast, Features, Kiss, Peer, Ransac, Starts, optional
from reorient.cli.arguments import Positional, parse
from reorient.cli.progress import show_progress
from reorient.errors import ReorientError
from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.reporting import print_tables, read_rows
from reorient.runs.pool import Pool

PEERS = {
    "gicp120": Peer(Starts(), coarse=True),
    "kiss-matcher": Peer(Kiss()),
    "fpfh-ransac": Peer(Ransac()),
    "fgr": Peer(Fast()),
}
NEEDS = {"kiss-matcher": "kiss_matcher", "fpfh-ransac": "open3d", "fgr": "open3d"}
TUNING = (
    {
        "gicp120, best by score": Peer(Starts(), coarse=True),
        "gicp120, best by inliers": Peer(Starts(), "inliers", coarse=True),
        "gicp120, middles on each other": Peer(Starts(behind=0.0), coarse=True),
        "gicp120, not coarse first": Peer(Starts()),
    }
    | {
        f"kiss-matcher, voxel {voxel:g}, radii {normal:g} {feature:g}, noise {noise:g}": Peer(
            Kiss(voxel, normal, feature, noise)
        )
        for voxel in (0.015, 0.02, 0.03, 0.04, 0.06)
        for normal, feature in ((3.0, 5.0), (4.0, 7.0))
        for noise in (0.5, 1.0, 2.0)
    }
    | {
        f"fpfh-ransac, voxel {voxel:g}, radius {feature:g}, inliers {distance:g}{', mutual' if mutual else ''}": Peer(
            Ransac(Features(voxel, 2.0, feature), distance, mutual)
        )
        for voxel in (0.02, 0.03, 0.04)
        for feature in (5.0, 8.0)
        for distance in (1.0, 1.5)
        for mutual in (True, False)
    }
    | {
        f"fgr, voxel {voxel:g}, radius {feature:g}, alike {alike:g}": Peer(Fast(Features(voxel, 2.0, feature), alike))
        for voxel in (0.02, 0.03, 0.04)
        for feature in (5.0, 8.0)
        for alike in (0.7, 0.8, 0.9, 0.95)
    }
)
"""All that was tried, by name."""


@dataclass(frozen=True)
class Peers:
    """What to run."""

    out: Positional[Path]
    """Folder for config.json and rows.csv.gz."""
    config: Evaluation = field(
        default_factory=lambda: Evaluation(
            estimators=("kiss-matcher", "fpfh-ransac", "fgr", "gicp", "icp"),
            ranges_deg=((0, 30), (30, 60), (60, 90), (90, 180)),
            noise_mm=(1.0,),
        )
    )
    tuning: bool = False
    """Instead of the named estimators, all variants of those among them that are peers."""
    pool: Pool = field(default_factory=Pool)


def main(config: Peers) -> None:
    """Measure those that can be, then print the tables."""
    missing: dict[str, str] = {}
    for name in config.config.estimators:
        if name in NEEDS:
            try:
                optional(NEEDS[name])
            except ReorientError as error:
                missing[name] = str(error)
    names = [name for name in config.config.estimators if name not in missing]
    own = PEERS
    if config.tuning:
        own = {name: peer for name, peer in TUNING.items() if name.split(",")[0] in names}
        names = list(own)
    own = {name: own[name] for name in names if name in own}
    asked = replace(config.config, estimators=tuple(names))
    show_progress("pairs", evaluate(asked, config.out, config.pool, own))
    print_tables(read_rows(config.out), Console(width=140))
    for name, why in missing.items():
        print(f"{name}: not installable here: {why}")


if __name__ == "__main__":
    main(parse(Peers, "benchmarks/peers.py", sys.argv[1:]))
