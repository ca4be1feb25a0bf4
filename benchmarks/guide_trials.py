"""Trials of the guide with the simulated hand: how many match, how soon, and the true error then.

    python benchmarks/guide_trials.py out/guide.csv --meshes FOLDER --only results/household-reporting.txt --trials 100

Objects are drawn from the folder; each begins 10-60 degrees from the goal, which is the mean of five images, as
``reorient capture`` takes it. A trial ends at the match, or after 60 seconds of the hand's time. The error is
symmetry-aware. An interrupted run continues where it stopped.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from growing_table import grow

from reorient import load_estimator
from reorient.cli.arguments import Positional, parse
from reorient.controller.guide_log import GuideLog
from reorient.controller.guiding import Guide, GuideState
from reorient.estimators.base import Estimator
from reorient.estimators.tracking import Tracker
from reorient.imaging.averaging import mean_image
from reorient.runs.provenance import commit
from reorient.runs.run import Row
from reorient.stations.rendered_hand import RenderedHand
from reorient.world.objects import ObjectSource
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised
from reorient.world.symmetry import rotation_group, symmetric_error

START_DEG = (10.0, 60.0)
LONGEST_S = 60.0
CAPTURES = 5  # of the goal
COLUMNS = (
    *("trial", "object", "start_deg", "status", "seconds", "error_deg", "confidence", "losses", "images", "cpu_s"),
    "commit",
)


@dataclass(frozen=True)
class Trials:
    """Measure the guide with the simulated hand."""

    out: Positional[Path]
    """File for the raw rows (.csv)."""
    objects: ObjectSource = field(default_factory=ObjectSource)
    trials: int = 100
    """Number of trials."""
    seed: int = 0
    """Seed of objects, poses and hands."""


def rows_of(config: Trials, done: int) -> Iterator[dict[str, Any]]:
    """The rows of the trials that are not done yet."""
    objects = config.objects.open()
    order = np.random.default_rng(config.seed).permutation(len(objects.names))
    estimator, version = load_estimator(), commit()
    for number in range(done, config.trials):
        name = objects.names[order[number % len(order)]]
        rng = np.random.default_rng([config.seed, number])
        start_deg = rng.uniform(*START_DEG)
        mesh = objects.load(name)
        hand = RenderedHand(mesh, load_world("benchmark"), randomised(0.001), rng, float(np.radians(start_deg)))
        begin = time.process_time()
        state, log = _trial(hand, estimator)
        truth = hand.R_goal @ hand.R_camera_object.T
        error_rad = symmetric_error(rotation_group(mesh), np.eye(3), truth, hand.R_camera_object)
        yield dict(
            zip(
                COLUMNS,
                (
                    *(number, name, f"{start_deg:.2f}", state.status, f"{state.time_s:.2f}"),
                    *(f"{np.degrees(error_rad):.4f}", "" if state.confidence is None else f"{state.confidence:.4f}"),
                    *(log.trial.losses, state.index + 1, f"{time.process_time() - begin:.2f}", version),
                ),
                strict=True,
            )
        )


def _trial(hand: RenderedHand, estimator: Estimator) -> tuple[GuideState, GuideLog]:
    """The last state, at which the hand still is, and the counts."""
    log = GuideLog(None)
    goal = mean_image([hand.goal() for _ in range(CAPTURES)])
    for state in Guide(Tracker(estimator, goal)).states(hand.frames()):
        hand(state)
        log(state)
        if state.status == "matched" or state.time_s > LONGEST_S:
            return state, log
    raise AssertionError("a hand has images without end")


def measure(config: Trials) -> list[Row]:
    """All rows, those of an earlier run of the same file included."""
    return grow(config.out, COLUMNS, lambda rows: rows_of(config, len(rows)), "trial")


def main(config: Trials) -> None:
    """Measure, then print the figures."""
    rows = measure(config)
    matched = [row for row in rows if row["status"] == "matched"]
    error_deg = np.array([float(row["error_deg"]) for row in matched])
    print(f"{len(matched)} of {len(rows)} matched, {np.sum(error_deg <= 1)} with a true error of at most 1 degree")
    print(f"matched with more than 1: {np.sum(error_deg > 1)}, 2: {np.sum(error_deg > 2)}, 5: {np.sum(error_deg > 5)}")
    print(f"median true error {np.median(error_deg):.2f} deg, largest {error_deg.max():.2f}")
    print(f"median time to match {np.median([float(row['seconds']) for row in matched]):.1f} s of the hand's time")


if __name__ == "__main__":
    main(parse(Trials, "benchmarks/guide_trials.py", sys.argv[1:]))
