"""The paper's experiment on physical objects, in the simulated cell: objects x trials x systems, raw rows first.

For each trial an object is put into the gripper in a random pose in which at least 70% of it is seen, the goal image is
taken, the arm turns away, and each system closes the loop from the same start. A run folder holds ``config.json``,
``rows.csv.gz`` (one row an image, and one for the end of each loop) and ``masks.csv.gz`` (how well goal and start were
segmented).
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from reorient import so3
from reorient.controller import OrientResult
from reorient.errors import ReorientError
from reorient.experiments.cell_trials import Experiment, chosen, close_loop, estimator_and_strategy, stage
from reorient.experiments.evaluation import Row
from reorient.runs.files import make_folder, replacing, whole_lines, write_table
from reorient.runs.pool import check_workers, processes
from reorient.runs.provenance import run_record

NOT_STAGED = "not staged"
COLUMNS = [
    *("object", "trial", "low_deg", "high_deg", "estimator", "strategy", "image", "error_deg", "predicted_deg"),
    *("turned_deg", "returns", "score", "confidence", "moves", "converged", "reason"),
]
END = "end"  # in the column ``image``, of the row after the last image


def run(config: Experiment, out: Path, workers: int = 1) -> Iterator[tuple[int, int]]:
    """Run all, yielding (trials done, trials in all); rows and masks are in ``out`` when it ends.

    Each finished trial is kept in ``trials.jsonl`` until then, so that an interrupted run goes on where it stopped.
    Raises ReorientError where ``out`` holds another experiment.
    """
    check_workers(workers)
    names = _begun(config, make_folder(out), workers)
    tasks = [
        (config, name, trial, limits)
        for limits in config.ranges_deg
        for name in names
        for trial in range(config.trials)
    ]
    partial, finished = out / "trials.jsonl", out / "rows.csv.gz"
    if finished.is_file():
        yield len(tasks), len(tasks)
        return
    trials = [json.loads(line) for line in whole_lines(partial)]
    yield len(trials), len(tasks)
    with processes(workers) as pool, partial.open("a") as file:
        left = tasks[len(trials) :]
        for trial in pool.map(_run_trial, left) if workers > 1 else map(_run_trial, left):
            file.write(json.dumps(trial) + "\n")
            file.flush()
            trials.append(trial)
            yield len(trials), len(tasks)
    if masks := [row for _, more in trials for row in more]:
        write_table(out / "masks.csv.gz", masks)
    write_table(finished, [row for rows, _ in trials for row in rows])
    partial.unlink()


def _begun(config: Experiment, out: Path, workers: int) -> list[str]:
    """The names of the objects, as an earlier run of the same config chose them or else chosen now."""
    file = out / "config.json"
    record = run_record(config, workers=workers)
    if file.is_file():
        try:
            earlier = json.loads(file.read_text())
            same = earlier["config"] == record["config"]
            names = [str(name) for name in earlier["names"]]
        except (ValueError, KeyError, TypeError) as error:
            raise ReorientError(f"broken {str(file)!r} ({error}): expected what `reorient cell` wrote") from error
        if not same:
            raise ReorientError(
                f"{str(out)!r} holds an experiment of another config: expected the same, or a new folder"
            )
        return names
    names = list(chosen(config))
    with replacing(file) as temporary:
        temporary.write_text(json.dumps(record | {"names": names}, indent=2) + "\n")
    return names


def _run_trial(task: tuple[Experiment, str, int, tuple[float, float]]) -> tuple[list[Row], list[Row]]:
    config, name, trial, limits = task
    head = {"object": name, "trial": trial, "low_deg": limits[0], "high_deg": limits[1]}
    rows: list[dict[str, Any]] = []
    masks: tuple[dict[str, Any], ...] = ()
    for index, system in enumerate(config.systems):
        estimator, strategy = estimator_and_strategy(system)
        mine = head | {"estimator": estimator, "strategy": strategy}
        try:
            staged = stage(config, name, trial, limits, score_masks=index == 0)
        except ReorientError as error:
            rows.append(dict.fromkeys(COLUMNS, "") | mine | {"image": END, "reason": f"{NOT_STAGED}: {error}"})
            continue
        masks += staged.masks
        rows += [dict.fromkeys(COLUMNS, "") | mine | row for row in _loop_rows(*close_loop(config, staged, system))]
    return _as_text(rows), _as_text([head | row for row in masks])


def _as_text(rows: list[dict[str, Any]]) -> list[Row]:
    return [{column: str(cell) for column, cell in row.items()} for row in rows]


def _loop_rows(result: OrientResult, errors_deg: list[float]) -> Iterator[dict[str, Any]]:
    for step, error_deg in zip(result.steps, errors_deg, strict=False):
        yield {
            "image": step.index,
            "error_deg": f"{error_deg:.4f}",
            "predicted_deg": f"{np.degrees(step.estimate.angle_rad):.4f}",
            "turned_deg": "" if step.R_executed is None else f"{np.degrees(so3.angle(step.R_executed)):.4f}",
            "returns": int(np.count_nonzero(step.image.depth_m)),
            "score": f"{step.estimate.evidence.score:.4f}",
            "confidence": "" if step.estimate.confidence is None else f"{step.estimate.confidence:.4f}",
        }
    yield {
        "image": END,
        "error_deg": f"{errors_deg[-1]:.4f}",
        "moves": result.moves,
        "converged": int(result.converged),
        "reason": result.reason,
    }
