"""Tracking on simulated sequences: errors, lost objects and time, a raw row for each image.

    python benchmarks/tracking.py out/tracking.csv --meshes FOLDER --only results/household-tuning.txt --sequences 100

A sequence (``tracking_sequences.py``) begins by an estimate; then images are tracked, and estimated again where the
object is lost. ``state``: ``tracked``, ``lost``, or ``searched`` where an estimate without initial guess was made;
``confidence`` is that of the tracked rotation. Every ``--compare``-th image of a plain sequence is estimated as well.
Time is processor time of the one thread. An interrupted run continues where it stopped.
"""

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from growing_table import grow
from scipy.stats import binomtest
from tracking_sequences import KINDS, Frame
from tracking_sequences import Sequence as Images

from reorient import load_estimator, so3
from reorient.cli.arguments import Positional, parse
from reorient.errors import ReorientError
from reorient.estimators.base import Estimator
from reorient.estimators.tracking import Tracker
from reorient.runs.provenance import commit
from reorient.runs.run import Row
from reorient.world.objects import ObjectSource

COLUMNS = (
    *("sequence", "object", "kind", "image", "event", "there", "angle_deg", "state", "error_deg", "confidence"),
    *("seconds", "estimate_error_deg", "estimate_seconds", "commit"),
)
FLAGGED_AFTER = 3  # images


@dataclass(frozen=True)
class Measure:
    """Measure tracking on simulated sequences."""

    out: Positional[Path]
    """File for the raw rows (.csv)."""
    objects: ObjectSource = field(default_factory=ObjectSource)
    sequences: int = 100
    """Number of sequences; they take the kinds in turn."""
    images: int = 90
    """Images of a sequence."""
    fps: float = 30.0
    """Images a second."""
    compare: int = 30
    """Every so many images of a plain sequence ``estimate`` is measured on the same image; 0: never."""
    seed: int = 0
    """Seed of the sequences."""


def rows_of(config: Measure, done: int) -> Iterator[dict[str, Any]]:
    """The rows of the sequences that are not done yet."""
    objects = config.objects.open()
    order = np.random.default_rng(config.seed).permutation(len(objects.names))
    estimator, version = load_estimator(), commit()
    for number in range(done, config.sequences):
        name, kind = objects.names[order[number % len(order)]], KINDS[number % len(KINDS)]
        images = Images(objects, name, kind, config.seed + number, config.images, config.fps)
        tracker = Tracker(estimator, images.goal)
        rows = []
        for frame in images:
            compared = kind == "plain" and config.compare and frame.index % config.compare == config.compare - 1
            cells = _tracked(tracker, images, frame) | (_estimated(estimator, images, frame) if compared else {})
            angle_deg = np.degrees(so3.angle(images.truth(frame.R_camera_object)))
            about = {"sequence": number, "object": name, "kind": kind, "image": frame.index, "event": images.event}
            rows.append(about | {"there": int(frame.there), "angle_deg": f"{angle_deg:.2f}", "commit": version} | cells)
        yield from rows  # whole sequences


def _tracked(tracker: Tracker, images: Images, frame: Frame) -> dict[str, Any]:
    searching, begin = tracker.searches_next, time.process_time()
    estimate = tracker.update(frame.image)
    seconds = time.process_time() - begin
    state = "searched" if searching and seconds > 0.1 else "lost" if estimate is None else "tracked"
    cells: dict[str, Any] = {"state": state, "seconds": f"{seconds:.5f}"}
    if estimate is None:
        return cells
    error_deg = images.error_deg(estimate.R_goal_current, frame)
    return cells | {"error_deg": f"{error_deg:.4f}", "confidence": f"{estimate.confidence:.4f}"}


def _estimated(estimator: Estimator, images: Images, frame: Frame) -> dict[str, Any]:
    begin = time.process_time()
    try:
        R = estimator.estimate(frame.image, images.goal).R_goal_current
    except ReorientError:
        R = np.eye(3)
    seconds = time.process_time() - begin
    return {
        "estimate_error_deg": f"{images.error_deg(R, frame):.4f}",
        "estimate_seconds": f"{seconds:.3f}",
    }


def measure(config: Measure) -> list[Row]:
    """All rows, those of an earlier run of the same file included."""

    def more(rows: list[Row]) -> Iterator[dict[str, Any]]:
        return rows_of(config, 1 + max((int(row["sequence"]) for row in rows), default=-1))

    return grow(config.out, COLUMNS, more, "sequence")


def summarise(rows: Sequence[Row]) -> str:
    """The figures of a run, a line each."""
    error_deg = np.array([float(row["error_deg"] or "inf") for row in rows])
    known = np.array([row["error_deg"] != "" for row in rows])
    there = np.array([row["there"] == "1" for row in rows])
    image, event = (np.array([int(row[name]) for row in rows]) for name in ("image", "event"))
    kind = np.array([row["kind"] for row in rows])
    milliseconds = 1000 * np.array([float(row["seconds"]) for row in rows])
    local = np.array([row["state"] == "tracked" for row in rows])
    lines = [
        f"tracked images: median {np.median(milliseconds[local]):.1f} ms of processor time, "
        f"90% below {np.percentile(milliseconds[local], 90):.1f} ms"
    ]
    moving = np.isin(kind, ("plain", "crossing", "jump"))
    for name, chosen in (("plain", kind == "plain"), ("crossing", kind == "crossing"), ("jump", kind == "jump")):
        lines.append(f"{name}: {_errors(error_deg[chosen])}")
    lines.append(f"all three: {_errors(error_deg[moving])}")
    flagged = there | ~known
    late = ~there & (image >= event + FLAGGED_AFTER - 1)
    for name in ("swap", "hidden"):
        lines.append(f"{name}: flagged from the {FLAGGED_AFTER}rd image on in {_share(flagged[late & (kind == name)])}")
    first = {row["sequence"]: int(row["image"]) for row in reversed(rows) if row["error_deg"]}
    begun = np.array([int(row["image"]) >= first.get(row["sequence"], 10**6) for row in rows])
    steady = begun & np.isin(kind, ("plain", "crossing"))
    lines.append(f"false alarms (plain, crossing; after the first estimate): {_share(~known[steady])}")
    back = there & (image > event) & np.isin(kind, ("swap", "hidden"))
    lines.append(f"object back: {_errors(error_deg[back])}")
    compared = np.array([row["estimate_error_deg"] != "" for row in rows])
    estimate = np.array([float(row["estimate_error_deg"] or "inf") for row in rows])[compared]
    lines.append(f"images compared, track: {_errors(error_deg[compared])}")
    lines.append(f"images compared, estimate: {_errors(estimate)}")
    return "\n".join(lines + list(_reliability(rows)))


def _reliability(rows: Sequence[Row]) -> Iterator[str]:
    """Confidence against the share of right rotations."""
    chosen = [row for row in rows if row["confidence"] and row["state"] == "tracked"]
    confidence = np.array([float(row["confidence"]) for row in chosen])
    right = np.array([row["there"] == "1" and float(row["error_deg"]) < 5 for row in chosen])
    for low, high in ((0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        inside = (confidence >= low) & (confidence < high)
        if inside.any():
            yield f"confidence {low:g}-{min(high, 1):g}: mean {confidence[inside].mean():.3f}, {_share(right[inside])}"


def _errors(error_deg: np.ndarray) -> str:
    """An image without a known rotation counts as an infinite error."""
    if not len(error_deg):
        return "none"
    within = ", ".join(f"{np.mean(error_deg < limit):.1%} within {limit}" for limit in (1, 2, 5))
    return f"{len(error_deg)} images, median {np.median(error_deg):.2f} deg, {within}"


def _share(right: np.ndarray) -> str:
    if not len(right):
        return "0 of 0"
    low, high = binomtest(int(right.sum()), len(right)).proportion_ci(method="wilson")
    return f"{right.mean():.2%} of {len(right)} ({100 * low:.1f}-{100 * high:.1f})"


def main(config: Measure) -> None:
    """Measure, then print the figures."""
    print(summarise(measure(config)))


if __name__ == "__main__":
    main(parse(Measure, "benchmarks/tracking.py", sys.argv[1:]))
