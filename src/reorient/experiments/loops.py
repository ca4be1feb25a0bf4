"""Closed loops in simulation: objects x trials x systems (paper, "Controller Experiments on Simulated Objects").

The goal image is unoccluded, each current image has a new occluding rectangle, and the pivot is up to 1 cm wrong along
each axis. All systems start from the same orientation towards the same goal image, and meet faults of the same seed.
A resumable run (``reorient.runs``), a task for each object, trial, noise and start.
"""

import time
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller import Limits, Step, orient
from reorient.errors import MOST, OutOfRange, ReorientError, check_counts, check_distinct, check_range
from reorient.experiments.cached import cached_object
from reorient.experiments.systems import load_system, names_of
from reorient.imaging import DepthImage, Goal, GoalView
from reorient.imaging.averaging import mean_image
from reorient.runs.pool import Pool
from reorient.runs.run import Progress, Row, RowStore, Tables, resumable
from reorient.stations.faulty import FaultyStation
from reorient.stations.rendered import RenderedStation
from reorient.world.goals import ALL_ROUND, rotations_away
from reorient.world.objects import ObjectSource
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised
from reorient.world.statistics import is_distinctive
from reorient.world.symmetry import SymmetryGroup, symmetric_error

COLUMNS = [
    *("object", "trial", "noise_mm", "start_deg", "slack_deg", "faults", "estimator", "strategy", "angle_deg"),
    *("moves", "images", "status", "converged", "confidence", "error_deg", "error_sym_deg", "trajectory_deg"),
    *("seconds", "faults_met", "reason", "expected_deg", "bound_deg"),
]
"""``angle_deg``: symmetry-aware start angle; ``error_deg``, ``error_sym_deg``: final error, plain and symmetry-aware;
``trajectory_deg``: plain error at the start and after each move; ``seconds``: processor time of the loop;
``expected_deg``: root mean square of the final error as expected before the first move; ``bound_deg``: its printed 95%
bound. Rows of earlier versions lack the last two."""
_SYMMETRIC_AMONG = 6  # times as many objects are searched for those with a symmetry


@dataclass(frozen=True)
class Loops:
    """Closed loops to run."""

    source: ObjectSource = field(default_factory=ObjectSource)
    """Where the objects come from."""
    systems: tuple[str, ...] = ("default/fusing", "gicp/algorithm1")
    """Systems, each an estimator and a strategy: fusing, algorithm1 (eta 0.2, delta 0.5 deg) or direct (eta 1)."""
    objects: int = 22
    """Number of objects, drawn from the source by a hash of the name."""
    trials: int = 20
    """Number of goals and starts of each object."""
    start_deg: tuple[str, ...] = ("30", "any")
    """Angles between start and goal, or any for starts that are uniform over SO(3)."""
    noise_mm: tuple[float, ...] = (1.0,)
    """Standard deviation of the depth noise."""
    faults: float = 0.0
    """Probability of a fault at each capture (stale, empty or no frame) and each move (slip, refused or partial)."""
    slack_deg: float = 0.0
    """Unreported execution error of each rotation of 30 degrees or more, in proportion less for smaller rotations."""
    goal_views: int = 1
    """Number of goal views: the primary one and others 60 degrees away; six are all round."""
    goal_captures: int = 1
    """Number of images that each goal view is the mean of; ``reorient capture`` takes five."""
    symmetric: bool = False
    """Use objects with a symmetry (or flat, or with few faces) instead of all."""
    world: str = "benchmark"
    """Preset of camera, size and distance: benchmark or paper."""
    seed: int = 0
    """Seed of the goals, the starts, the noise and the faults."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range, unknown systems and an unknown world."""
        if load_world(self.world).in_hand is not None:
            raise ReorientError(
                f"--world {self.world}: expected benchmark or paper, no station has the losses of this one"
            )
        for system in self.systems:
            load_system(system)
        for start in self.start_deg:
            if start != "any" and not 0 < _number(start) <= 180:
                raise OutOfRange("start_deg", self.start_deg, "degrees above 0, at most 180, or 'any'")
        check_range(self, "noise_mm", "slack_deg", "seed")
        check_range(self, "faults", high=1)
        check_counts(self, "objects", "trials", "goal_captures")
        check_range(self, "goal_views", low=1, high=ALL_ROUND)
        check_distinct(self, "systems", "start_deg", "noise_mm")
        if self.objects * self.trials > MOST:
            raise OutOfRange("trials", self.trials, f"with {self.objects} objects at most {MOST // self.objects}")
        if not (self.systems and self.start_deg):
            raise ReorientError("expected at least one system and one start")


@dataclass(frozen=True)
class Trial:
    """One task: a start and a goal of one object."""

    config: Loops
    object: str
    trial: int
    noise_mm: float
    start_deg: str


def run_loops(config: Loops, out: Path, pool: Pool | None = None) -> Progress:
    """Run; yields (trials done, trials in all). The rows are in ``out/rows.csv.gz`` when it ends.

    Raises ReorientError as ``resumable``.
    """
    yield from resumable(out, config, trials(config), run_trial, RowStore(), pool)


def trials(config: Loops) -> dict[str, Trial]:
    """The tasks, ordered by trial: a part of a run is spread over all objects."""
    names = _chosen(config)
    return {
        f"{name}, trial {index}, {noise_mm:g} mm, start {start_deg}": Trial(config, name, index, noise_mm, start_deg)
        for index in range(config.trials)
        for name in names
        for noise_mm in config.noise_mm
        for start_deg in config.start_deg
    }


def run_trial(trial: Trial) -> Tables:
    """One loop, and one row, for each system."""
    return {"rows": [_loop(trial, system) for system in trial.config.systems]}


def _loop(trial: Trial, system: str) -> Row:
    config, key = trial.config, zlib.crc32(trial.object.encode())
    mesh, group = cached_object(config.source, trial.object)
    rng, rng_faults = (np.random.default_rng([key, trial.trial, stream, config.seed]) for stream in (0, 1))
    station = RenderedStation(mesh, load_world(config.world), randomised(trial.noise_mm / 1000), rng)
    primary, R_goal = _goal_view(station, config.goal_captures), station.R_camera_object
    R_start = _start(rng, trial.start_deg)
    goal = Goal(primary, _further_views(station, rng, config))
    station.rotate(R_start)
    faulty = FaultyStation(station, rng_faults, config.faults, float(np.radians(config.slack_deg)))
    angle_deg, trajectory_deg = _error_sym_deg(station, R_goal, group), [_error_deg(station, R_goal)]

    def record(step: Step) -> None:
        if step.R_executed is not None:
            trajectory_deg.append(_error_deg(station, R_goal))

    begin = time.process_time()
    estimator, strategy = load_system(system)
    result = orient(faulty, goal, estimator, strategy, limits=Limits(wait_s=0.0), subscribers=[record])
    seconds = time.process_time() - begin
    names = names_of(system)
    row: dict[str, Any] = {
        "object": trial.object,
        "trial": trial.trial,
        "noise_mm": f"{trial.noise_mm:g}",
        "start_deg": trial.start_deg,
        "slack_deg": f"{config.slack_deg:g}",
        "faults": f"{config.faults:g}",
        "estimator": names[0],
        "strategy": names[1],
        "angle_deg": f"{angle_deg:.4f}",
        "moves": result.moves,
        "images": len(result.steps),
        "status": result.status,
        "converged": int(result.converged),
        "confidence": "" if result.confidence is None else f"{result.confidence:.4f}",
        "error_deg": f"{_error_deg(station, R_goal):.4f}",
        "error_sym_deg": f"{_error_sym_deg(station, R_goal, group):.4f}",
        "trajectory_deg": " ".join(f"{error:.2f}" for error in trajectory_deg),
        "seconds": f"{seconds:.3f}",
        "faults_met": " ".join(faulty.met),
        "reason": result.reason,
        "expected_deg": _degrees(result.expected_rad),
        "bound_deg": _degrees(result.bound_rad),
    }
    return {column: str(row[column]) for column in COLUMNS}


def _goal_view(station: RenderedStation, captures: int) -> DepthImage:
    """The mean of several images of the goal pose."""
    return mean_image([station.capture_goal() for _ in range(captures)])


def _further_views(station: RenderedStation, rng: np.random.Generator, config: Loops) -> tuple[GoalView, ...]:
    """Rotate the object away, capture, and rotate it back; views that show nothing are left out."""
    found = []
    for R in rotations_away(rng, config.goal_views):
        station.rotate(R)
        with suppress(ReorientError):
            found.append(GoalView(_goal_view(station, config.goal_captures), R.T))
        station.rotate(R.T)
    return tuple(found)


def _start(rng: np.random.Generator, start_deg: str) -> Float[np.ndarray, "3 3"]:
    """The rotation from the goal to the start."""
    if start_deg == "any":
        return np.asarray(so3.sample_uniform(rng, 1)[0])
    angle_rad = float(np.radians(float(start_deg)))
    return np.asarray(so3.matrix_from_quat(so3.sample_bounded(rng, 1, angle_rad, angle_rad))[0])


def _degrees(angle_rad: float | None) -> str:
    return "" if angle_rad is None else f"{np.degrees(angle_rad):.4f}"


def _number(word: str) -> float:
    """NaN for other words."""
    try:
        return float(word)
    except ValueError:
        return float("nan")


def _error_deg(station: RenderedStation, R_goal: Float[np.ndarray, "3 3"]) -> float:
    return float(np.degrees(so3.angle_difference(station.R_camera_object, R_goal)))


def _error_sym_deg(station: RenderedStation, R_goal: Float[np.ndarray, "3 3"], group: SymmetryGroup) -> float:
    remaining = R_goal @ station.R_camera_object.T
    return float(np.degrees(symmetric_error(group, np.eye(3), remaining, station.R_camera_object)))


def _chosen(config: Loops) -> list[str]:
    """Names of the objects."""
    objects = config.source.open()
    names = sorted(objects.names, key=lambda name: zlib.crc32(f"loop {name}".encode()))
    if config.symmetric:
        among = names[: _SYMMETRIC_AMONG * config.objects]
        names = [name for name in among if not is_distinctive(objects.load(name))]
        if not names:
            raise ReorientError(f"none of {len(among)} objects has a symmetry: expected other objects, or more")
    return names[: config.objects]
