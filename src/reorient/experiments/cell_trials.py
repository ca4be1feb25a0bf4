"""One trial of the cell experiment: an object in the gripper, its goal image, the rotation away from it, the loop back.

Trials are drawn from seeds, so that each system (an estimator and a strategy) meets the same ones, and any can be run
again to be shown.
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator

from reorient import so3
from reorient.controller import OrientResult, Step, orient
from reorient.errors import ReorientError, StationError, check_angles, check_counts, check_distinct, check_range
from reorient.experiments.cached import cached_object
from reorient.experiments.systems import load_system
from reorient.extras import extras_named
from reorient.imaging import DepthImage
from reorient.perception.calibration import read_calibration
from reorient.perception.colour import ColourRange
from reorient.perception.segmentation import object_mask
from reorient.world.objects import ObjectSource
from reorient.world.statistics import is_distinctive

MAX_IMAGES = 50  # K of the paper's physical experiment
LEAST_VISIBLE = 0.7  # of the object's silhouette, in goal and start (paper: "not significantly occluded")
_ROTATIONS = 200  # drawn for a start before another goal is tried
_PLACES = 5  # goals tried


@dataclass(frozen=True)
class Experiment:
    """Trials to run."""

    source: ObjectSource = field(default_factory=lambda: ObjectSource(count=60, object_seed=100))
    """Source of the objects."""
    objects: int = 5
    """Number of objects, drawn by a hash of the name among those without symmetry that the gripper can hold."""
    trials: int = 10
    """Number of goals and starts of each object."""
    systems: tuple[str, ...] = ("default/fusing", "gicp/direct")
    """Systems, each an estimator and a strategy: fusing, algorithm1 or direct (eta 1). At most 50 images."""
    ranges_deg: tuple[tuple[float, float], ...] = ((30, 30),)
    """Ranges of the angle between start and goal, in pairs: 0 30 30 60 is 0 to 30 and 30 to 60 degrees."""
    noise_mm: float = 0.5
    """Standard deviation of the depth noise."""
    slip_nm: float | None = None
    """Torque at which the object slips in the fingers, by default never."""
    segmentation: str = "shape"
    """Means to remove the gripper: shape (its known shape) or colour (as in the paper)."""
    gripper_hue_deg: tuple[float, float] | None = None
    """Range of the gripper's hue. With one of saturation it replaces the colours learned from the empty gripper,
    with --segmentation colour and in the scores of the masks."""
    gripper_saturation: tuple[float, float] | None = None
    """Range of the gripper's saturation, between 0 and 1."""
    calibration: Path | None = None
    """Calibration file of the cell's cameras, by default the true one with errors of 1 mm and 0.3 degrees."""
    arm: Path | None = None
    """MJCF file of another arm, by default the YuMi's left one."""
    seed: int = 0
    """Seed of the goals, the starts and the cell's errors."""

    def __post_init__(self) -> None:
        """Raises ReorientError for what cannot be run."""
        for system in self.systems:
            load_system(system)
        check_angles(self, "ranges_deg", above=True)
        check_counts(self, "objects", "trials")
        check_distinct(self, "systems", "ranges_deg")
        check_range(self, "seed")
        check_range(self, "noise_mm", high=100, below=True)
        check_range(self, "slip_nm", above=True)
        if not self.systems:
            raise ReorientError("no systems: expected at least one")


class Witness:
    """A cell as the controller sees it, that notes the truth at every image."""

    def __init__(self, cell: Any, R_goal: Float[np.ndarray, "3 3"]) -> None:
        self.cell, self._R_goal = cell, R_goal
        self.errors_deg: list[float] = []
        """At each image."""

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"] | None:
        """The cell's."""
        pivot_m: np.ndarray | None = self.cell.pivot_m
        return pivot_m

    def capture(self) -> DepthImage:
        """The cell's image."""
        self.errors_deg.append(self.error_deg())
        image: DepthImage = self.cell.capture()
        return image

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The cell's move."""
        return np.asarray(self.cell.rotate(R_step))

    def reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """The cell's reach."""
        return bool(self.cell.reachable(R_step))

    def error_deg(self) -> float:
        """The true angle between the object and its goal."""
        return float(np.degrees(so3.angle_difference(self.cell.plant.R_world_object, self._R_goal)))


@dataclass(frozen=True, eq=False)
class Stage:
    """A cell before its loop: the goal image taken, the object rotated away from it."""

    cell: Any
    goal: DepthImage
    R_goal: Float[np.ndarray, "3 3"]
    """The object's true orientation in the goal image, world axes."""
    masks: tuple[dict[str, Any], ...]
    """How well goal and start are segmented; none unless asked for."""


def stage(
    config: Experiment, name: str, trial: int, range_deg: tuple[float, float], score_masks: bool = False
) -> Stage:
    """Set up one trial; the same arguments make the same trial. Raises ReorientError where the arm cannot.

    The rotation away has an angle uniform in the range and a random axis, such that the arm can make it and at least
    70% of the object stay visible.
    """
    low, high = range_deg
    rng = np.random.default_rng([config.seed, zlib.crc32(name.encode()), trial, round(1000 * low), round(1000 * high)])
    mesh, _ = cached_object(config.source, name)
    cell = open_cell(config, rng)
    for _ in range(_PLACES):
        cell.plant.hold(mesh, LEAST_VISIBLE)
        R_away = _rotation_away(cell, rng, np.radians(low), np.radians(high))
        if R_away is not None:
            break
    else:
        raise ReorientError(f"the arm cannot rotate the object away by {low:g} to {high:g} degrees and still show it")
    masks = [_score_masks(cell, "goal")] if score_masks else []
    goal, R_goal = cell.capture(), cell.plant.R_world_object
    cell.rotate(R_away)
    masks += [_score_masks(cell, "start")] if score_masks else []
    return Stage(cell, goal, R_goal, tuple(masks))


def close_loop(
    config: Experiment, staged: Stage, system: str, subscribers: Sequence[Callable[[Step], None]] = ()
) -> tuple[OrientResult, list[float]]:
    """One loop from a stage, and the true angle left at each image and, last, at the end; degrees."""
    estimator, strategy = load_system(system, max_images=MAX_IMAGES)
    witness = Witness(staged.cell, staged.R_goal)
    result = orient(witness, staged.goal, estimator, strategy, subscribers=subscribers)
    return result, [*witness.errors_deg[: len(result.steps)], witness.error_deg()]


def chosen(config: Experiment) -> tuple[str, ...]:
    """The objects: in an order by a hash of the name, the first without symmetry that the gripper can hold in view."""
    objects = config.source.open()
    cell = open_cell(config, np.random.default_rng(config.seed))
    found: list[str] = []
    for name in sorted(objects.names, key=lambda name: zlib.crc32(f"cell {name}".encode())):
        mesh = objects.load(name)
        if is_distinctive(mesh) and _can_hold(cell, mesh):
            found.append(name)
        if len(found) == config.objects:
            return tuple(found)
    raise ReorientError(
        f"{len(found)} of {len(objects.names)} objects can be used: expected {config.objects} without symmetry that "
        "the gripper can hold in view"
    )


def open_cell(config: Experiment, rng: Generator) -> Any:
    """The cell, its gripper still empty. Raises ReorientError where the extra is not installed or an input is bad."""
    with extras_named():
        from reorient.stations.cell import CellConfig, PlantConfig, SimulatedCell
        from reorient.stations.cell.drive import Errors
    plant = PlantConfig(noise_m=config.noise_mm / 1000, errors=Errors(slip_nm=config.slip_nm))
    colour = None
    if config.gripper_hue_deg or config.gripper_saturation:
        colour = ColourRange(config.gripper_hue_deg or (0.0, 360.0), config.gripper_saturation or (0.0, 1.0))
    return SimulatedCell(
        rng,
        CellConfig(
            plant if config.arm is None else replace(plant, arm=config.arm),
            config.segmentation,
            colour,
            None if config.calibration is None else read_calibration(config.calibration),
        ),
    )


def _can_hold(cell: Any, mesh: trimesh.Trimesh) -> bool:
    try:
        cell.plant.hold(mesh, LEAST_VISIBLE)
    except ReorientError:
        return False
    return True


def _rotation_away(cell: Any, rng: Generator, low_rad: float, high_rad: float) -> Float[np.ndarray, "3 3"] | None:
    """A rotation of the gripper that the arm can make and that leaves the object in view; None if none is found."""
    for _ in range(_ROTATIONS):
        R: np.ndarray = so3.matrix_from_quat(so3.sample_bounded(rng, 1, low_rad, high_rad))[0]
        try:
            joints_rad = cell.plan(R)
        except StationError:
            continue
        if cell.plant.is_visible(joints_rad, LEAST_VISIBLE):
            return R
    return None


def _score_masks(cell: Any, image: str) -> dict[str, Any]:
    """Overlap of each segmentation with the object: with its returns, and with all pixels whose ray hits it.

    By the gripper's shape once without colours, and once with them to fill in what did not return.
    """
    frame = cell.frame(colour=True)
    hit, returned = cell.plant.shows_object(), frame.depth.valid
    row: dict[str, Any] = {
        "image": image,
        "pixels": int(hit.sum()),
        "returned": f"{(hit & returned).sum() / hit.sum():.4f}",
    }
    by_shape = cell.segmentations["shape"]
    ways = {"shape": (by_shape, replace(frame, color=None))}
    if "colour" in cell.segmentations:
        ways |= {"shape_coloured": (by_shape, frame), "colour": (cell.segmentations["colour"], frame)}
    for name, (segmentation, seen) in ways.items():
        try:
            mask = object_mask(seen, cell.calibration, segmentation)
        except ReorientError:
            mask = np.zeros_like(hit)
        row[f"iou_{name}"] = f"{_iou(mask & returned, hit & returned):.4f}"
        row[f"iou_{name}_all"] = f"{_iou(mask, hit):.4f}"
    return row


def _iou(mask: Bool[np.ndarray, "h w"], truth: Bool[np.ndarray, "h w"]) -> float:
    return float((mask & truth).sum() / max((mask | truth).sum(), 1))
