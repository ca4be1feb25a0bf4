"""Estimators on pairs of views of a BOP dataset: one raw row for each pair and estimator, resumable.

A pair is two views of one instance in one scene: current and goal. The truth is the change of its pose in camera axes.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import ReorientError, check_counts, check_distinct, check_range, reason_of
from reorient.estimators import load_estimator
from reorient.experiments.bop_data import View, load_model, views
from reorient.experiments.cached import cached_estimator
from reorient.experiments.cells import COLUMNS, measured
from reorient.runs.pool import Pool
from reorient.runs.run import Progress, RowStore, Tables, resumable

BOP_COLUMNS = [*COLUMNS, "scene", "image", "image_goal", "annotation", "annotation_goal", "mssd_mm", "diameter_mm"]
RANGES_DEG = ((0, 30), (30, 60), (60, 90), (90, 180))  # of the rotation between the views, in the tables
_LIST = ("scene_id", "obj_id", "im_id", "im_id_goal")
_TRIES = 10  # for each pair wanted, before a dataset has too few


@dataclass(frozen=True)
class BopEvaluation:
    """Pairs of views of a BOP dataset, and estimators to measure."""

    dataset: Path
    split: str = "test"
    objects: tuple[int, ...] = ()
    """Object numbers; all where none is given."""
    pair_list: Path | None = None
    """CSV with scene_id, obj_id, im_id, im_id_goal and optionally gt_id, gt_id_goal; None: random pairs."""
    pairs: int = 300
    """Number of random pairs."""
    estimators: tuple[str, ...] = ("gicp", "icp")
    seed: int = 0
    """Seed of the random pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for what cannot be measured."""
        check_range(self, "seed")
        check_counts(self, "pairs")
        check_distinct(self, "estimators", "objects")
        if not self.estimators:
            raise ReorientError("no estimators: expected at least one")


def evaluate_bop(config: BopEvaluation, out: Path, pool: Pool | None = None) -> Progress:
    """Run; yields (pairs done, pairs in all). The rows are in ``out/rows.csv.gz`` when it ends.

    Raises ReorientError as ``resumable``, for an unknown estimator, and for files that are missing or not in the
    layout.
    """
    for name in config.estimators:
        load_estimator(name)
    found = views(config.dataset, config.split, config.objects)
    chosen = _random_pairs(config, found) if config.pair_list is None else _listed_pairs(config.pair_list, found)
    for obj_id in sorted({current.obj_id for current, _ in chosen}):
        load_model(config.dataset, obj_id)
    tasks = {str(index): (config, index, current, goal) for index, (current, goal) in enumerate(chosen)}
    yield from resumable(out, config, tasks, _measure, RowStore(), pool)


def _random_pairs(config: BopEvaluation, found: list[View]) -> list[tuple[View, View]]:
    """Different pairs of an instance's views, the objects in turn. Raises ReorientError where there are too few."""
    instances: dict[int, dict[tuple[int, int], list[View]]] = {}
    for view in found:
        instances.setdefault(view.obj_id, {}).setdefault((view.scene, view.annotation), []).append(view)
    seen_twice = {
        obj_id: several for obj_id, each in instances.items() if (several := [x for x in each.values() if len(x) > 1])
    }
    if not seen_twice:
        raise ReorientError("no object is seen in two images of a scene: expected pairs of views")
    rng = np.random.default_rng(config.seed)
    pairs: dict[tuple[View, View], None] = {}
    for attempt in range(_TRIES * config.pairs):
        if len(pairs) == config.pairs:
            break
        several = seen_twice[sorted(seen_twice)[attempt % len(seen_twice)]]
        of_instance = several[rng.integers(len(several))]
        first, second = rng.choice(len(of_instance), 2, replace=False)
        pairs[of_instance[first], of_instance[second]] = None
    if len(pairs) < config.pairs:
        raise ReorientError(f"{len(pairs)} different pairs found: expected {config.pairs}; use --pairs {len(pairs)}")
    return list(pairs)


def _listed_pairs(path: Path, found: list[View]) -> list[tuple[View, View]]:
    """The pairs of a CSV file. Raises ReorientError for missing columns, and for views that the dataset lacks."""
    if not path.is_file():
        raise ReorientError(f"no list of pairs at {str(path)!r}: expected CSV with {', '.join(_LIST)}")
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = list(csv.DictReader(file, skipinitialspace=True))
    if not rows or not set(_LIST) <= set(rows[0]):
        raise ReorientError(f"{str(path)!r} lacks columns or rows: expected {', '.join(_LIST)}")
    places: dict[tuple[int, int, int], list[View]] = {}
    for view in found:
        places.setdefault((view.scene, view.obj_id, view.image), []).append(view)
    return [
        (_view(path, line, row, "", places), _view(path, line, row, "_goal", places))
        for line, row in enumerate(rows, start=2)
    ]


def _view(
    path: Path, line: int, row: dict[str, Any], which: str, places: dict[tuple[int, int, int], list[View]]
) -> View:
    try:
        key = int(row["scene_id"]), int(row["obj_id"]), int(row[f"im_id{which}"])
        annotation = int(row[f"gt_id{which}"]) if row.get(f"gt_id{which}") else None
    except (TypeError, ValueError) as error:
        raise ReorientError(f"line {line} of {str(path)!r}: expected whole numbers ({reason_of(error)})") from error
    fitting = [view for view in places.get(key, []) if annotation in (None, view.annotation)]
    if len(fitting) != 1:
        raise ReorientError(
            f"line {line} of {str(path)!r}: {len(fitting)} views of object {key[1]} in image {key[2]} of scene "
            f"{key[0]}, expected one (several: add gt_id{which}; none: hidden by more than 90%, or not in the dataset)"
        )
    return fitting[0]


def _measure(task: tuple[BopEvaluation, int, View, View]) -> Tables:
    config, index, current, goal = task
    T_current, T_goal = current.pose(), goal.pose()
    T_true = T_goal @ se3.inverse(T_current)
    angle_deg = float(np.degrees(so3.angle(T_true[:3, :3])))
    low, high = next((low, high) for low, high in RANGES_DEG if angle_deg <= high)
    cell = {
        "object": f"obj_{current.obj_id:06d}",
        "pair": index,
        "world": f"{config.dataset.name}/{config.split}",
        "noise_mm": 0,
        "low_deg": low,
        "high_deg": high,
        "angle_deg": f"{angle_deg:.4f}",
        "scene": current.scene,
        "image": current.image,
        "image_goal": goal.image,
        "annotation": current.annotation,
        "annotation_goal": goal.annotation,
    }
    return {"rows": [_row(cell | answer) for answer in _answers(config, current, goal)]}


def _answers(config: BopEvaluation, current: View, goal: View) -> Iterator[dict[str, Any]]:
    """Cells of each estimator. A view that cannot be isolated counts as refused by all."""
    model = load_model(config.dataset, current.obj_id)
    T_current, T_goal = current.pose(), goal.pose()
    T_true = T_goal @ se3.inverse(T_current)
    try:
        images, refused = (current.depth(), goal.depth()), ""
    except ReorientError as error:
        images, refused = None, str(error)
    for name in config.estimators:
        if images is None:
            T, cells = np.eye(4), {"seconds": "0", "message": refused}
        else:
            estimate, cells = measured(cached_estimator(name), *images)
            T = np.eye(4) if estimate is None else estimate.T_goal_current
        T_answer = T @ T_current
        errors = {
            "error_deg": f"{np.degrees(so3.angle_difference(T[:3, :3], T_true[:3, :3])):.5f}",
            "error_sym_deg": f"{np.degrees(model.rotation_error(T_answer[:3, :3], T_goal[:3, :3])):.5f}",
            "mssd_mm": f"{1000 * model.mssd_m(T_answer, T_goal):.4f}",
            "diameter_mm": f"{1000 * model.diameter_m:.4f}",
        }
        quaternion = zip("wxyz", so3.quat_from_matrix(T[:3, :3]), strict=True)
        yield {"estimator": name} | cells | errors | {f"q{part}": f"{x:.9f}" for part, x in quaternion}


def _row(cells: dict[str, Any]) -> dict[str, str]:
    return {column: str(cells.get(column, "")) for column in BOP_COLUMNS}
