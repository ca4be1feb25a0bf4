"""Estimators x objects x angles x noise: one raw row each, summaries last.

A resumable run (``reorient.runs``), a task for each pair. ``evaluate`` measures estimators, by name or as objects;
``measure_pairs`` measures anything else of the same pairs. The cells of a row are those of ``cells``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError, check_angles, check_counts, check_distinct, check_range, reason_of
from reorient.estimators import load_estimator
from reorient.estimators.base import Estimator
from reorient.experiments.cached import cached_estimator, cached_object
from reorient.experiments.cells import COLUMNS, estimate_cells
from reorient.imaging.goal import Goal
from reorient.imaging.viewpoints import spread_rotations
from reorient.runs.pool import Pool
from reorient.runs.provenance import read_record
from reorient.runs.run import CONFIG, Progress, Row, RowStore, Tables, resumable
from reorient.world.goals import ALL_ROUND, sample_goal
from reorient.world.mesh_goal import rendered_goal
from reorient.world.objects import ObjectSet, ObjectSource
from reorient.world.pairs import Pair, sample_pair, view_overlap
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised
from reorient.world.symmetry import SymmetryGroup


@dataclass(frozen=True)
class Evaluation:
    """Pairs and estimators to measure."""

    objects: ObjectSource = field(default_factory=ObjectSource)
    """Objects of the pairs."""
    estimators: tuple[str, ...] = ("gicp", "icp")
    """Names of estimators, each with a row for every pair."""
    world: str = "benchmark"
    """Preset of camera, size and distance: benchmark, paper or in_hand."""
    ranges_deg: tuple[tuple[float, float], ...] = ((0, 30), (30, 60))
    """Ranges of the angle between start and goal, in pairs: 0 30 30 60 is 0 to 30 and 30 to 60 degrees."""
    noise_mm: tuple[float, ...] = (0.0, 1.0)
    """Standard deviation of the sensor's depth noise, besides occluded pixels and dropouts."""
    pairs: int = 300
    """Number of pairs for each range and noise, spread over the objects."""
    pivot: bool = False
    """Give the estimators the nominal pivot, up to 1 cm wrong along each axis."""
    goal_views: tuple[int, ...] = (1,)
    """Numbers of goal views, each with a row for every pair: the primary one and others 60 degrees away; six are all
    round."""
    slip_deg: float = 0.0
    """Largest error of the stated rotations of further goal views."""
    cad: bool = False
    """Render the goal views from the mesh, as from CAD: without noise, and with exact motions."""
    seed: int = 0
    """Seed of the pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for what cannot be measured."""
        check_angles(self, "ranges_deg")
        check_range(self, "noise_mm", "seed")
        check_counts(self, "pairs")
        check_range(self, "goal_views", low=1, high=ALL_ROUND)
        check_range(self, "slip_deg", high=180)
        if self.cad and self.slip_deg:
            raise ReorientError(
                f"--cad with --slip-deg {self.slip_deg:g}: expected one of them, rendered views are exact"
            )
        check_distinct(self, "estimators", "ranges_deg", "noise_mm", "goal_views")
        if not self.estimators:
            raise ReorientError("no estimators: expected at least one")


Measure = Callable[[Evaluation, Pair, Goal, SymmetryGroup, Float[np.ndarray, "3"] | None], list[dict[str, Any]]]
"""Measures a pair, given its goal, its object's symmetry and the pivot that may be used: for each of
``config.estimators`` the cells of its row, by those of ``COLUMNS`` that do not describe the pair itself."""


def evaluate(
    config: Evaluation, out: Path, pool: Pool | None = None, own: Mapping[str, Estimator] | None = None
) -> Progress:
    """Run; yields (pairs done, pairs in all). The rows are in ``out/rows.csv.gz`` when it ends.

    ``own``: estimators that are not of the package, by the names under which the config lists them.
    Raises ReorientError as ``resumable``, for an unknown estimator and for refused meshes.
    ``seconds`` of a row is processor time of its process, all threads together.
    """
    own = own or {}
    for name in config.estimators:
        if name not in own:
            load_estimator(name)
    described = {name: _described(estimator) for name, estimator in own.items()}
    yield from measure_pairs(config, out, partial(_estimates, dict(own)), pool, own=repr(described))


def measure_pairs(
    config: Evaluation, out: Path, measure: Measure, pool: Pool | None = None, own: str = "{}"
) -> Progress:
    """As ``evaluate``, with any measure. ``own``: text for ``config.json`` of anything else that the rows depend on."""
    load_world(config.world)
    names = _loadable(config.objects.open(), config.pairs)
    tasks = {str(index): (config, measure, names[index % len(names)], index) for index in range(config.pairs)}
    yield from resumable(out, config, tasks, _measure_pair, RowStore(), pool, own=own)


def read_config(path: Path) -> Evaluation:
    """The config of a run folder. Raises ReorientError where there is none."""
    file = path / CONFIG
    if not file.is_file():
        raise ReorientError(f"no evaluation in {str(path)!r}: expected config.json and rows.csv.gz")
    try:
        data = read_record(file)["config"]
        source = ObjectSource.from_json(data.pop("objects"))
        data["ranges_deg"] = tuple(tuple(x) for x in data["ranges_deg"])
        for name in {"estimators", "noise_mm", "goal_views"} & set(data):
            data[name] = tuple(data[name])
        return Evaluation(source, **data)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ReorientError(
            f"broken {str(file)!r} ({reason_of(error)}): expected the config of an evaluation"
        ) from error


def regenerate(config: Evaluation, row: Row) -> tuple[Pair, Renderer]:
    """The images of a row again, from its seeds, and the renderer of its object."""
    renderer = Renderer(config.objects.open().load(row["object"]))
    pair = _pair(
        config, renderer, int(row["pair"]), float(row["low_deg"]), float(row["high_deg"]), float(row["noise_mm"])
    )
    return pair, renderer


def _measure_pair(task: tuple[Evaluation, Measure, str, int]) -> Tables:
    config, measure, name, index = task
    mesh, group = cached_object(config.objects, name)
    renderer = Renderer(mesh)
    rows = []
    for low, high in config.ranges_deg:
        for noise_mm in config.noise_mm:
            pair = _pair(config, renderer, index, low, high, noise_mm)
            cell = {
                "object": name,
                "pair": index,
                "world": config.world,
                "noise_mm": noise_mm,
                "low_deg": low,
                "high_deg": high,
                "angle_deg": f"{np.degrees(so3.angle(pair.R_goal_current)):.4f}",
                "overlap": f"{view_overlap(renderer, pair):.4f}",
            }
            for views in config.goal_views:
                goal = _goal(config, renderer, pair, index, views, noise_mm)
                measured = measure(config, pair, goal, group, pair.pivot_m if config.pivot else None)
                for estimator, figures in zip(config.estimators, measured, strict=True):
                    own = {"estimator": estimator, "goal_views": views}
                    rows.append(dict.fromkeys(COLUMNS, "") | figures | cell | own)
    return {"rows": [{column: str(row[column]) for column in COLUMNS} for row in rows]}


def _pair(config: Evaluation, renderer: Renderer, index: int, low: float, high: float, noise_mm: float) -> Pair:
    rng = np.random.default_rng([config.seed, index, round(low * 1000), round(high * 1000), round(noise_mm * 1000)])
    return sample_pair(
        rng, renderer, load_world(config.world), randomised(noise_mm / 1000), np.radians(low), np.radians(high)
    )


def _goal(config: Evaluation, renderer: Renderer, pair: Pair, index: int, views: int, noise_mm: float) -> Goal:
    if config.cad:
        R, camera = pair.R_goal_current @ pair.R_camera_object, load_world(config.world).camera
        return rendered_goal(renderer, pair.placement, R, camera, spread_rotations(views - 1))
    rng = np.random.default_rng([config.seed, index, views])
    slip_rad = float(np.radians(config.slip_deg))
    return sample_goal(rng, renderer, load_world(config.world), randomised(noise_mm / 1000), pair, views, slip_rad)


def _estimates(
    own: dict[str, Estimator],
    config: Evaluation,
    pair: Pair,
    goal: Goal,
    group: SymmetryGroup,
    pivot_m: Float[np.ndarray, "3"] | None,
) -> list[dict[str, Any]]:
    """Cells of each estimator."""
    return [
        estimate_cells(own[name] if name in own else cached_estimator(name), pair, group, pivot_m, goal)
        for name in config.estimators
    ]


def _loadable(objects: ObjectSet, most: int) -> tuple[str, ...]:
    """The names, once every mesh that is going to be used has been loaded: better now than after hours."""
    refused = []
    for name in objects.names[:most]:
        try:
            objects.load(name)
        except ReorientError as error:
            refused.append(str(error))
    if refused:
        raise ReorientError(
            f"{len(refused)} of {len(objects.names)} meshes are refused (see `reorient objects check`; name the others "
            f"with --only), the first: {refused[0]}"
        )
    return objects.names


def _described(estimator: Estimator) -> str:
    """An estimator in words that are the same in the next run: a dataclass shows its settings, any other its class."""
    kind = type(estimator)
    return repr(estimator) if is_dataclass(estimator) else f"{kind.__module__}.{kind.__qualname__}"
