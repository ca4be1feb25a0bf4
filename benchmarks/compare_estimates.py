"""Two versions of the package on the same pairs, in one run: right answers and time of their default estimator.

    git worktree add /tmp/base 289823d
    python benchmarks/compare_estimates.py out/versions.csv --old /tmp/base/src --meshes FOLDER \
        --only results/household-reporting.txt --pairs 300

The pairs are those of ``reorient evaluate`` with the same options. Each version runs in a process of its own, one
thread each, and both take every pair one after the other, so that the machine's speed is the same for both. A run
continues where it stopped. The summary has the share within 5 degrees of both with Wilson intervals, the pairs that
only one gets right with McNemar's exact test, medians, confidence, and processor time with the ratio pair by pair.
"""

import csv
import os
import pickle
import subprocess
import sys
import time
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

WORKER = """
import pickle, sys, time
from reorient import Camera, DepthImage, load_estimator
estimator = load_estimator(sys.argv[1])
out = sys.stdout.buffer
while True:
    try:
        current, goal, camera, pivot_m = pickle.load(sys.stdin.buffer)
    except EOFError:
        break
    images = [DepthImage(depth, Camera(*camera)) for depth in (current, goal)]
    begin = time.process_time()
    estimate = estimator.estimate(*images, pivot_m)
    seconds = time.process_time() - begin
    pickle.dump((estimate.R_goal_current, estimate.confidence, seconds), out)
    out.flush()
"""
SOURCE = str(Path(__file__).parents[1] / "src")
RANGES_DEG = ((0, 30), (30, 60), (60, 90), (90, 180))
COLUMNS = ("object", "pair", "low_deg", "pivot", "version", "error_sym_deg", "confidence", "seconds")


class Version:
    """One version of the package in a process of its own."""

    def __init__(self, source: str, estimator: str) -> None:
        env = os.environ | {"PYTHONPATH": source, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-c", WORKER, estimator]
        self._process = subprocess.Popen(command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def estimate(self, task: Any) -> tuple[np.ndarray, float | None, float]:
        """Rotation, confidence and processor time of one pair."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        pickle.dump(task, self._process.stdin)
        self._process.stdin.flush()
        answer: tuple[np.ndarray, float | None, float] = pickle.load(self._process.stdout)
        return answer


def measure(args: Any) -> None:
    """A row for each pair, with and without pivot, and version."""
    from reorient.world.objects import ObjectSource
    from reorient.world.pairs import sample_pair
    from reorient.world.rendering import Renderer, load_world
    from reorient.world.sensing import randomised
    from reorient.world.symmetry import rotation_group, symmetric_error

    objects = ObjectSource(meshes=args.meshes, only=args.only, count=args.count, object_seed=args.object_seed).open()
    versions = {"old": Version(args.old, args.estimator), "new": Version(args.new, args.estimator)}
    done = len(args.out.read_text().splitlines()) - 1 if args.out.is_file() else 0
    per_pair = 2 * 2 * len(RANGES_DEG)
    begin, first = time.time(), done // per_pair
    with args.out.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if not done:
            writer.writeheader()
        for index in range(first, args.pairs):
            name = objects.names[index % len(objects.names)]
            mesh = objects.load(name)
            group, renderer = rotation_group(mesh), Renderer(mesh)
            for low, high in RANGES_DEG:
                rng = np.random.default_rng([args.seed, index, low * 1000, high * 1000, round(args.noise_mm * 1000)])
                sensor = randomised(args.noise_mm / 1000)
                pair = sample_pair(rng, renderer, load_world("benchmark"), sensor, np.radians(low), np.radians(high))
                camera = tuple(vars(pair.current.camera).values())
                for pivot in (False, True):
                    task = (pair.current.depth_m, pair.goal.depth_m, camera, pair.pivot_m if pivot else None)
                    order = sorted(versions, reverse=bool(index % 2))
                    for version in order:
                        R, confidence, seconds = versions[version].estimate(task)
                        error = symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object)
                        cells = (name, index, low, int(pivot), version, f"{np.degrees(error):.5f}")
                        sure = "" if confidence is None else f"{confidence:.4f}"
                        writer.writerow(dict(zip(COLUMNS, (*cells, sure, f"{seconds:.5f}"), strict=True)))
            file.flush()
            left = (time.time() - begin) / (index + 1 - first) * (args.pairs - index - 1)
            print(f"{index + 1} of {args.pairs}, {left / 60:.0f} minutes left", end="\r", file=sys.stderr)


def summarise(out: Path) -> None:
    """A line for each range, with and without pivot."""
    rows = list(csv.DictReader(out.open(newline="")))
    for pivot in ("0", "1"):
        for low, high in (*RANGES_DEG, (0, 180)):
            whole = (low, high) == (0, 180)
            chosen = [row for row in rows if row["pivot"] == pivot and (whole or row["low_deg"] == str(low))]
            old, new = ([row for row in chosen if row["version"] == version] for version in ("old", "new"))
            errors = [np.array([float(row["error_sym_deg"]) for row in each]) for each in (old, new)]
            right = [error < 5 for error in errors]
            only_old, only_new = int((right[0] & ~right[1]).sum()), int((right[1] & ~right[0]).sum())
            p = binomtest(only_new, only_old + only_new).pvalue if only_old + only_new else 1.0
            seconds = [np.array([float(row["seconds"]) for row in each]) for each in (old, new)]
            text = []
            for version, error, correct, time_s in zip(("old", "new"), errors, right, seconds, strict=True):
                interval = binomtest(int(correct.sum()), len(correct)).proportion_ci(method="wilson")
                text.append(
                    f"{version} {correct.mean():.1%} ({interval.low:.1%}-{interval.high:.1%}), median "
                    f"{np.median(error):.3f} deg, {1000 * np.median(time_s):.0f} ms"
                )
            given = "with" if pivot == "1" else "no"
            print(
                f"{low}-{high} deg, {given} pivot, n={len(old)}: {'; '.join(text)}; only old "
                f"right {only_old}, only new right {only_new} (p={p:.2g}); time new/old, median of the pairs "
                f"{np.median(seconds[1] / seconds[0]):.3f}"
            )


def main() -> None:
    """Measure, then summarise."""
    parser = ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path, help="CSV file of the rows.")
    parser.add_argument("--old", required=True, help="Source folder of the old version.")
    parser.add_argument("--new", default=SOURCE, help="Source folder of the new version.")
    parser.add_argument("--estimator", default="default", help="Name of the estimator.")
    parser.add_argument("--meshes", type=Path, help="Folder of meshes; generated objects where not given.")
    parser.add_argument("--only", type=Path, help="File with the names of the meshes.")
    parser.add_argument("--count", type=int, default=100, help="Number of generated objects.")
    parser.add_argument("--object-seed", type=int, default=100, help="Seed of the generated objects.")
    parser.add_argument("--pairs", type=int, default=300, help="Pairs of each range.")
    parser.add_argument("--noise-mm", type=float, default=1.0, help="Depth noise.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the pairs.")
    args = parser.parse_args()
    measure(args)
    summarise(args.out)


if __name__ == "__main__":
    main()
