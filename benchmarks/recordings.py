"""Estimators on folders of real recordings with known rotations; nothing is tuned on them.

    python benchmarks/recordings.py FOLDER results/recordings.csv --estimators paper swift icp gicp default

``FOLDER`` holds ``NAME.npz`` with ``depth_m`` (n, h, w), metres, 0 = not the object or no return; ``camera`` = width,
height, fx, fy, cx, cy with pixel centres at integers; ``R_camera_object`` (n, 3, 3); ``tool_m``, the rotation centre in
camera axes (3,), or a point that moves with the object (n, 3): the pivot. Optional: ``unknown`` (n, h, w). A file
``pairs.csv`` with the columns recording, current, goal lists the pairs; without it all pairs of a recording's frames
are measured. One raw row for each pair, estimator and pivot (given or not), appended as they are measured, so that an
interrupted run continues; then a Markdown table. The pivot is given only where it is one point: of a rotation about
another point the images would contradict it.
"""

import csv
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from growing_table import grow
from jaxtyping import Float
from scipy.stats import binomtest

from reorient import Camera, DepthImage, load_estimator, so3
from reorient.cli.arguments import Positional, parse
from reorient.errors import ReorientError
from reorient.estimators.base import Estimator, as_estimate
from reorient.runs.provenance import commit
from reorient.runs.run import Row

COLUMNS = (
    *("recording", "current", "goal", "angle_deg", "estimator", "pivot", "error_deg", "confidence"),
    *("inlier_ratio", "free_space_violation", "silhouette_violation", "occluded", "seconds", "message", "commit"),
)
SURE = 0.9
"""Confidence from which an answer counts as sure."""


@dataclass(frozen=True)
class Recording:
    """The frames of one run."""

    name: str
    images: tuple[DepthImage, ...]
    R_camera_object: Float[np.ndarray, "n 3 3"]
    pivot_m: Float[np.ndarray, "3"] | None
    """None where the object's rotation centre moved."""


@dataclass(frozen=True)
class Recordings:
    """Measure estimators on real recordings with known rotations."""

    folder: Positional[Path]
    """Folder of recordings."""
    out: Positional[Path]
    """File for the raw rows (.csv)."""
    estimators: tuple[str, ...] = ("paper", "swift", "icp", "gicp", "default")
    """Names of estimators."""
    edges_deg: tuple[float, ...] = (0, 33, 60, 90, 180)
    """Limits of the ranges of the angle in the table."""


def read(file: Path) -> Recording:
    """One recording. Raises ReorientError where an array is missing or has another shape."""
    try:
        with np.load(file) as arrays:
            width, height, fx, fy, cx, cy = (float(x) for x in arrays["camera"])
            depth_m, R = arrays["depth_m"], arrays["R_camera_object"].astype(float)
            tool_m = arrays["tool_m"].astype(float) if "tool_m" in arrays else None
            unknown = arrays["unknown"] if "unknown" in arrays else np.zeros(depth_m.shape, bool)
    except (KeyError, ValueError) as error:
        raise ReorientError(
            f"{str(file)!r} is no recording ({error}): expected depth_m, camera, R_camera_object"
        ) from error
    if R.shape != (len(depth_m), 3, 3):
        raise ReorientError(f"{str(file)!r}: R_camera_object of shape {R.shape}, expected {(len(depth_m), 3, 3)}")
    camera = Camera(int(width), int(height), fx, fy, cx + 0.5, cy + 0.5)
    images = tuple(DepthImage(frame, camera, unknown=lost) for frame, lost in zip(depth_m, unknown, strict=True))
    return Recording(file.stem, images, R, tool_m if tool_m is not None and tool_m.shape == (3,) else None)


def pairs_of(folder: Path, recordings: dict[str, Recording]) -> list[tuple[str, int, int]]:
    """The pairs to measure: recording, current frame, goal frame."""
    listed = folder / "pairs.csv"
    if listed.is_file():
        with listed.open(newline="") as file:
            return [(row["recording"], int(row["current"]), int(row["goal"])) for row in csv.DictReader(file)]
    return [(name, a, b) for name, each in recordings.items() for a, b in combinations(range(len(each.images)), 2)]


def rows_of(config: Recordings, done: set[tuple[str, ...]]) -> Iterator[dict[str, Any]]:
    """The rows that are not done yet."""
    recordings = {file.stem: read(file) for file in sorted(config.folder.glob("*.npz"))}
    if not recordings:
        raise ReorientError(f"no recordings in {str(config.folder)!r}: expected .npz files")
    estimators = {name: load_estimator(name) for name in config.estimators}
    version = commit()
    for name, current, goal in pairs_of(config.folder, recordings):
        for estimator, loaded in estimators.items():
            for pivot in (False, True):
                recording = recordings[name]
                key = (name, str(current), str(goal), estimator, str(int(pivot)))
                if key in done or (pivot and recording.pivot_m is None):
                    continue
                row = dict(zip(("recording", "current", "goal", "estimator", "pivot"), key, strict=True))
                yield row | _measured(recording, current, goal, loaded, pivot) | {"commit": version}


def _measured(recording: Recording, current: int, goal: int, estimator: Estimator, pivot: bool) -> dict[str, Any]:
    """The cells of one estimate. One that is refused counts as the estimate "no rotation"; ``message`` is the error."""
    images = recording.images[current], recording.images[goal]
    R_true = recording.R_camera_object[goal] @ recording.R_camera_object[current].T
    begin = time.process_time()
    cells: dict[str, Any] = {}
    try:
        estimate = as_estimate(estimator.estimate(*images, recording.pivot_m if pivot else None), *images)
    except ReorientError as error:
        R, message = np.eye(3), str(error)
    else:
        R, message = estimate.R_goal_current, ""
        for name in ("inlier_ratio", "free_space_violation", "silhouette_violation", "occluded"):
            cells[name] = f"{getattr(estimate.evidence, name):.4f}"
        cells["confidence"] = "" if estimate.confidence is None else f"{estimate.confidence:.4f}"
    return cells | {
        "angle_deg": f"{np.degrees(so3.angle(R_true)):.3f}",
        "error_deg": f"{np.degrees(so3.angle_difference(R, R_true)):.4f}",
        "seconds": f"{time.process_time() - begin:.5f}",
        "message": message,
    }


def measure(config: Recordings) -> list[Row]:
    """All rows, those of an earlier run of the same file included."""
    key = ("recording", "current", "goal", "estimator", "pivot")
    return grow(config.out, COLUMNS, lambda rows: rows_of(config, {tuple(row[x] for x in key) for row in rows}))


HEAD = (
    *("recordings", "range", "estimator", "pivot", "pairs", "median°", "p90°", "< 5° (95%)", "< 10°"),
    *("sure", "sure and right (95%)", "ms"),
)


def summarise(rows: Sequence[Row], edges_deg: Sequence[float]) -> str:
    """The table: for each camera (the recordings' names up to "_") and range of angles, every estimator."""
    lines = [HEAD, ["---"] * 4 + ["---:"] * (len(HEAD) - 4)]
    for camera in dict.fromkeys(row["recording"].split("_")[0] for row in rows):
        for low, high in pairwise(edges_deg):
            inside = [
                row for row in rows if row["recording"].startswith(camera) and low <= float(row["angle_deg"]) < high
            ]
            for estimator, pivot in dict.fromkeys((row["estimator"], row["pivot"]) for row in inside):
                chosen = [row for row in inside if (row["estimator"], row["pivot"]) == (estimator, pivot)]
                head = (camera, f"{low:g}–{high:g}°", estimator, "given" if pivot == "1" else "")
                lines.append([*head, *_figures(chosen)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _figures(rows: Sequence[Row]) -> list[str]:
    error_deg = np.array([float(row["error_deg"]) for row in rows])
    confidence = np.array([float(row["confidence"] or "nan") for row in rows])
    sure = confidence >= SURE
    rated = bool(np.isfinite(confidence).any())
    return [
        str(len(rows)),
        f"{np.median(error_deg):.2f}",
        f"{np.percentile(error_deg, 90):.2f}",
        _share(error_deg < 5),
        f"{np.mean(error_deg < 10):.1%}",
        f"{sure.mean():.1%}" if rated else "–",
        _share(error_deg[sure] < 5) if rated else "–",
        f"{1000 * np.median([float(row['seconds']) for row in rows]):.0f}",
    ]


def _share(right: np.ndarray) -> str:
    if not len(right):
        return "0 of 0"
    low, high = binomtest(int(right.sum()), len(right)).proportion_ci(method="wilson")
    return f"{right.mean():.1%} of {len(right)} ({100 * low:.1f}–{100 * high:.1f})"


def main(config: Recordings) -> None:
    """Measure, then print the table."""
    print(summarise(measure(config), config.edges_deg))


if __name__ == "__main__":
    main(parse(Recordings, "benchmarks/recordings.py", sys.argv[1:]))
