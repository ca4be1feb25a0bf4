"""Closed loops in simulation: objects x trials x estimators (paper, "Controller Experiments on Simulated Objects").

The goal image is unoccluded, each current image bears a new rectangle, the pivot is known to 1 cm along each axis, and
the object turns exactly as asked. All estimators start from the same orientation towards the same goal image.
"""

import zlib
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import trimesh

from reorient import so3
from reorient.controller import Step, load_strategy, orient
from reorient.errors import ReorientError
from reorient.estimators import load_estimator
from reorient.estimators.base import Estimator
from reorient.experiments.evaluation import Row
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import ObjectSource
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised
from reorient.world.symmetry import SymmetryGroup, rotation_group, symmetric_error


@dataclass(frozen=True)
class LoopTrials:
    """What to run: the paper's Algorithm 1 with K = 100, eta = 0.2, delta = 0.5 degrees."""

    source: ObjectSource = field(default_factory=ObjectSource)
    estimators: tuple[str, ...] = ("paper", "swift", "gicp", "icp")
    objects: int = 22
    """How many of the source, drawn by a hash of the name."""
    trials: int = 100
    """Starts and goals of each."""
    world: str = "paper"
    noise_mm: float = 0.0
    start_deg: float = 30.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Raises ReorientError for what cannot be run."""
        load_world(self.world)
        if not (self.estimators and min(self.objects, self.trials) >= 1 and self.seed >= 0 and self.noise_mm >= 0):
            raise ReorientError("expected at least one estimator, object and trial, no negative noise, a seed from 0")


def chosen(config: LoopTrials) -> tuple[str, ...]:
    """The objects' names."""
    names = config.source.open().names
    return tuple(sorted(names, key=lambda name: zlib.crc32(f"loop {name}".encode()))[: config.objects])


def tasks(config: LoopTrials) -> list[tuple[LoopTrials, str, int]]:
    """What ``run_trial`` takes, trial by trial: a part of a run is spread over the objects."""
    return [(config, name, trial) for trial in range(config.trials) for name in chosen(config)]


def run_trial(task: tuple[LoopTrials, str, int]) -> list[Row]:
    """One row for each estimator; ``errors_deg``: the true error at each image and after the last move."""
    config, name, trial = task
    mesh, group = _object(config.source, name)
    rows = []
    for estimator in config.estimators:
        rng = np.random.default_rng([config.seed, zlib.crc32(name.encode()), trial])
        station = RenderedStation(mesh, load_world(config.world), randomised(config.noise_mm / 1000), rng)
        goal, R_goal = station.capture_goal(), station.R_camera_object
        turn = np.radians(config.start_deg)
        station.rotate(so3.matrix_from_quat(so3.sample_bounded(rng, 1, turn, turn))[0])
        errors_deg = [_error_deg(station, R_goal)]

        def score(
            step: Step, station: RenderedStation = station, R_goal: np.ndarray = R_goal, kept: list[float] = errors_deg
        ) -> None:
            if step.R_executed is not None:
                kept.append(_error_deg(station, R_goal))

        result = orient(station, goal, _estimator(estimator), load_strategy("algorithm1"), subscribers=[score])
        R_left = R_goal @ station.R_camera_object.T
        aware = symmetric_error(group, np.eye(3), R_left, station.R_camera_object)
        row = {
            "object": name,
            "trial": trial,
            "estimator": estimator,
            "start_deg": config.start_deg,
            "noise_mm": config.noise_mm,
            "moves": result.moves,
            "converged": int(result.converged),
            "final_deg": f"{errors_deg[-1]:.4f}",
            "final_sym_deg": f"{np.degrees(aware):.4f}",
            "errors_deg": " ".join(f"{error:.2f}" for error in errors_deg),
            "reason": result.reason,
        }
        rows.append({column: str(cell) for column, cell in row.items()})
    return rows


def _error_deg(station: RenderedStation, R_goal: np.ndarray) -> float:
    return float(np.degrees(so3.angle_difference(station.R_camera_object, R_goal)))


@lru_cache(maxsize=32)
def _object(source: ObjectSource, name: str) -> tuple[trimesh.Trimesh, SymmetryGroup]:
    mesh = source.open().load(name)
    return mesh, rotation_group(mesh)


@lru_cache
def _estimator(name: str) -> Estimator:
    return load_estimator(name)
