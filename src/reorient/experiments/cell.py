"""The paper's experiment on physical objects, in the simulated cell: objects x trials x systems, raw rows first.

For each trial an object is put into the gripper in a random pose in which at least 70% of it is seen, the goal image is
taken, the arm rotates it away, and each system closes the loop from the same start. A run folder holds ``config.json``,
``rows.csv.gz`` (one row an image, and one for the end of each loop) and ``masks.csv.gz`` (how well goal and start were
segmented).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from reorient import so3
from reorient.controller import OrientResult
from reorient.errors import ReorientError
from reorient.experiments.cell_trials import Experiment, chosen, close_loop, stage
from reorient.experiments.systems import names_of
from reorient.runs.pool import Pool
from reorient.runs.run import Progress, Row, RowStore, Tables, resumable

NOT_STAGED = "not_staged"  # in the column ``status``: the arm could not set up the trial
COLUMNS = [
    *("object", "trial", "low_deg", "high_deg", "estimator", "strategy", "image", "error_deg", "predicted_deg"),
    *("rotated_deg", "returns", "score", "confidence", "moves", "status", "converged", "reason"),
]
END = "end"  # in the column ``image``, of the row after the last image


def run(config: Experiment, out: Path, pool: Pool | None = None) -> Progress:
    """Run; yields (trials done, trials in all). Rows and masks are in ``out`` when it ends.

    Raises ReorientError as ``resumable``, and where the extra ``cell`` is not installed.
    """
    names = chosen(config)
    tasks = {
        f"{name}, trial {trial}, {low:g} to {high:g} degrees": (config, name, trial, (low, high))
        for low, high in config.ranges_deg
        for name in names
        for trial in range(config.trials)
    }
    yield from resumable(out, config, tasks, _run_trial, RowStore(), pool, names=list(names))


def _run_trial(task: tuple[Experiment, str, int, tuple[float, float]]) -> Tables:
    config, name, trial, limits = task
    head = {"object": name, "trial": trial, "low_deg": limits[0], "high_deg": limits[1]}
    rows: list[dict[str, Any]] = []
    masks: tuple[dict[str, Any], ...] = ()
    for index, system in enumerate(config.systems):
        estimator, strategy = names_of(system)
        mine = head | {"estimator": estimator, "strategy": strategy}
        try:
            staged = stage(config, name, trial, limits, score_masks=index == 0)
        except ReorientError as error:
            rows.append(dict.fromkeys(COLUMNS, "") | mine | {"image": END, "status": NOT_STAGED, "reason": str(error)})
            continue
        masks += staged.masks
        rows += [dict.fromkeys(COLUMNS, "") | mine | row for row in _loop_rows(*close_loop(config, staged, system))]
    return {"rows": _as_text(rows), "masks": _as_text([head | row for row in masks])}


def _as_text(rows: list[dict[str, Any]]) -> list[Row]:
    return [{column: str(cell) for column, cell in row.items()} for row in rows]


def _loop_rows(result: OrientResult, errors_deg: list[float]) -> Iterator[dict[str, Any]]:
    for step, error_deg in zip(result.steps, errors_deg, strict=False):
        yield {
            "image": step.index,
            "error_deg": f"{error_deg:.4f}",
            "predicted_deg": f"{np.degrees(step.estimate.angle_rad):.4f}",
            "rotated_deg": "" if step.R_executed is None else f"{np.degrees(so3.angle(step.R_executed)):.4f}",
            "returns": int(np.count_nonzero(step.image.depth_m)),
            "score": f"{step.estimate.evidence.score:.4f}",
            "confidence": "" if step.estimate.confidence is None else f"{step.estimate.confidence:.4f}",
        }
    yield {
        "image": END,
        "error_deg": f"{errors_deg[-1]:.4f}",
        "moves": result.moves,
        "status": result.status,
        "converged": int(result.converged),
        "reason": result.reason,
    }
