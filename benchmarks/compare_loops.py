"""The same 200 closed loops on two versions of the code: every move of each, compared.

    git worktree add /tmp/base 289823d
    PYTHONPATH=/tmp/base/src python benchmarks/compare_loops.py run /tmp/base.jsonl
    python benchmarks/compare_loops.py run /tmp/now.jsonl
    python benchmarks/compare_loops.py diff /tmp/base.jsonl /tmp/now.jsonl

The loops start from any orientation, with generated objects that nothing was tuned on: 80 without faults, 60 with
faults and 60 with symmetric objects, half of which have faults, too. A run continues where it stopped. ``run`` imports
either layout of the package, so that this file also drives commits before the packages.
"""

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

OBJECTS, OBJECT_SEED = 1100, 300
NOISE_M = 0.001
FAULTS = 0.1
LAYOUTS = {  # name: the package's module, and the module of 289823d
    "ObjectSource": ("world.objects", "objects"),
    "is_distinctive": ("world.statistics", "statistics"),
    "load_world": ("world.rendering", "rendering"),
    "randomised": ("world.sensing", "sensing"),
    "rotation_group": ("world.symmetry", "symmetry"),
    "symmetric_error": ("world.symmetry", "symmetry"),
    "RenderedStation": ("stations.rendered", "stations.rendered"),
    "FaultyStation": ("stations.faulty", "stations.faulty"),
    "orient": ("controller", "controller"),
    "Fusing": ("controller", "controller"),
    "Limits": ("controller", "controller"),
    "load_estimator": ("estimators", "estimators"),
    "so3": ("", ""),
}


def found(name: str) -> Any:
    """An object of the package, by its present place or that of 289823d."""
    for module in LAYOUTS[name]:
        try:
            return getattr(import_module(f"reorient.{module}".rstrip(".")), name)
        except (ImportError, AttributeError):
            continue
    raise ImportError(name)


def loop(objects: Any, name: str, index: int, faults: float) -> dict[str, Any]:
    """One loop: every move in degrees (rotation vector, camera axes), how it ended and the true error left."""
    so3 = found("so3")
    mesh = objects.load(name)
    rng = np.random.default_rng([300, index])
    station = found("RenderedStation")(mesh, found("load_world")("benchmark"), found("randomised")(NOISE_M), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    station.rotate(so3.sample_uniform(rng, 1)[0])
    seen = found("FaultyStation")(station, np.random.default_rng([300, index, 1]), faults, 0.0)
    limits = found("Limits")(wait_s=0.0)
    result = found("orient")(seen, goal, found("load_estimator")("default"), found("Fusing")(), limits=limits)
    left = R_goal @ station.R_camera_object.T
    error = found("symmetric_error")(found("rotation_group")(mesh), np.eye(3), left, station.R_camera_object)
    moves = [
        None if s.R_executed is None else np.degrees(so3.log(s.R_executed)).round(6).tolist() for s in result.steps
    ]
    return {
        "moves": moves,
        "converged": bool(result.converged),
        "confidence": None if result.confidence is None else round(result.confidence, 6),
        "error_deg": round(float(np.degrees(error)), 4),
    }


def run(out: Path) -> None:
    """All loops, a line each."""
    done = len(out.read_text().splitlines()) if out.is_file() else 0
    objects = found("ObjectSource")(count=OBJECTS, object_seed=OBJECT_SEED).open()
    kinds: dict[bool, list[str]] = {True: [], False: []}
    for name in objects.names:
        kinds[found("is_distinctive")(objects.load(name))].append(name)
    tasks = [(name, 0.0) for name in kinds[True][:80]] + [(name, FAULTS) for name in kinds[True][80:140]]
    tasks += [(name, FAULTS * (k % 2)) for k, name in enumerate(kinds[False][:60])]
    for index, (name, faults) in list(enumerate(tasks))[done:]:
        row = {"object": name, "faults": faults} | loop(objects, name, index, faults)
        with out.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{index + 1} of {len(tasks)}", end="\r", file=sys.stderr)


def diff(one: Path, other: Path) -> None:
    """How many loops made the same moves, and how both ended."""
    pairs = [
        (json.loads(a), json.loads(b))
        for a, b in zip(one.read_text().splitlines(), other.read_text().splitlines(), strict=False)
    ]
    same = [a == b for a, b in pairs]
    print(f"{sum(same)} of {len(pairs)} loops are identical, move by move")
    for index, ((a, b), equal) in enumerate(zip(pairs, same, strict=True)):
        if not equal:
            print(f"  {index} {a['object']}: " + "; ".join(f"{k} {a[k]} -> {b[k]}" for k in a if a[k] != b[k]))
    for label, rows in (("first", [a for a, _ in pairs]), ("second", [b for _, b in pairs])):
        error = np.array([row["error_deg"] for row in rows])
        said = np.array([row["converged"] for row in rows])
        moves = np.array([sum(move is not None for move in row["moves"]) for row in rows])
        print(
            f"{label}: median {np.median(error):.3f} degrees, {np.mean(error <= 1):.1%} within 1; converged "
            f"{said.mean():.1%}, falsely (above 5 degrees) {np.mean(said & (error > 5)):.1%}; moves median "
            f"{np.median(moves):g}, in all {moves.sum()}"
        )


if __name__ == "__main__":
    verb, *paths = sys.argv[1:]
    run(*map(Path, paths)) if verb == "run" else diff(*map(Path, paths))
