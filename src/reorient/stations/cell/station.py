"""The station over a simulated cell: it knows what a real one would, encoders, images and a calibration a bit off."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import se3, so3
from reorient.errors import ReorientError, StationError, unknown_name
from reorient.imaging import DepthImage
from reorient.perception.calibration import Calibration, MountedCamera
from reorient.perception.colour import ColourRange
from reorient.perception.recalibration import corrected
from reorient.perception.segmentation import (
    ByColour,
    ByShape,
    Frame,
    Segmentation,
    isolate_object,
    learn_gripper_colour,
)
from reorient.stations.cell.arm import merged, turned
from reorient.stations.cell.plant import Plant, PlantConfig

SEGMENTATIONS = ("shape", "colour")


@dataclass(frozen=True)
class CellConfig:
    """What the station is given. Raises ReorientError for an unknown segmentation."""

    plant: PlantConfig = field(default_factory=PlantConfig)
    """What the cell is really like."""
    segmentation: str = "shape"
    """How the gripper is removed: by its known shape, or by its colour as in the paper."""
    gripper_colour: ColourRange | None = None
    """None: learned from a frame of the empty gripper."""
    calibration: Calibration | None = None
    """None: the true one, wrong by ``astray_m`` and ``astray_rad`` for each camera."""
    astray_m: float = 0.001
    astray_rad: float = float(np.radians(0.3))

    def __post_init__(self) -> None:
        if self.segmentation not in SEGMENTATIONS:
            raise unknown_name("segmentation", self.segmentation, list(SEGMENTATIONS))


class SimulatedCell:
    """One arm below two cameras. ``plant`` is the truth: ``plant.hold(mesh)`` puts an object into the gripper.

    Made with the gripper empty: the first frame of it corrects the calibration and teaches the gripper's colour.
    """

    def __init__(self, rng: Generator, config: CellConfig | None = None) -> None:
        self.config = config = config or CellConfig()
        self.plant = Plant(config.plant, rng)
        self.arm = self.plant.arm
        self.calibration = config.calibration or Calibration(
            *(_astray(camera, config, rng) for camera in (self.plant.depth, self.plant.color))
        )
        empty = self.frame(colour=True)
        self.calibration = corrected(self.calibration, empty)
        self.segmentations: dict[str, Segmentation] = {"shape": ByShape()}
        if self.calibration.color is not None:
            colour = config.gripper_colour or learn_gripper_colour(empty, self.calibration)
            self.segmentations["colour"] = ByColour(colour)
        if config.segmentation not in self.segmentations:
            raise ReorientError("segmentation by colour without a colour camera: expected 'color' in the calibration")

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"]:
        """The tool centre in camera axes, by encoders and calibration."""
        return se3.apply(self.calibration.depth.T_camera_world, self.arm.tcp(self.plant.read())[:3, 3])

    def capture(self) -> DepthImage:
        """The object alone, as the cameras see it now."""
        name = self.config.segmentation
        return isolate_object(self.frame(name == "colour"), self.calibration, self.segmentations[name])

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Turn the gripper about the tool centre; returns what the encoders say. Raises StationError out of reach."""
        before_rad = self.plant.read()
        self.plant.move(self.plan(R_step))
        R_world = self.arm.tcp(self.plant.read())[:3, :3] @ self.arm.tcp(before_rad)[:3, :3].T
        return self._R_world_camera.T @ R_world @ self._R_world_camera

    def clock_s(self) -> float:
        """The plant's clock; what frames are stamped with."""
        return self.plant.time_s

    def reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """Whether ``rotate`` would do it."""
        try:
            self.plan(R_step)
        except StationError:
            return False
        return True

    def plan(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " n"]:
        """Joint positions after such a turn. Raises StationError where there are none."""
        if not so3.is_rotation(np.asarray(R_step)):
            raise StationError("refused to rotate: expected a (3, 3) rotation matrix")
        now_rad = self.plant.read()
        R_step_world = self._R_world_camera @ R_step @ self._R_world_camera.T
        target = turned(self.arm.tcp(now_rad), R_step_world, self.plant.tool_m)
        return self.arm.solve(target, now_rad, self.plant.fingers_m)

    def frame(self, colour: bool) -> Frame:
        """What cameras and encoders say now; the colour camera is asked only if ``colour``."""
        depth, color = self.plant.images(colour)
        joints_rad = self.plant.read()
        robot = [part for part in self.arm.parts(joints_rad, self.plant.fingers_m) if part.name != "world"]
        return Frame(
            replace(depth, stamp_s=self.plant.time_s),
            color,
            merged(robot),
            self.arm.tcp(joints_rad)[:3, 3],
        )

    @property
    def _R_world_camera(self) -> Float[np.ndarray, "3 3"]:
        return self.calibration.depth.T_world_camera[:3, :3]


def _astray(camera: MountedCamera, config: CellConfig, rng: Generator) -> MountedCamera:
    direction, axis = so3.sample_axes(rng, 2)
    T = se3.transform(so3.exp(axis * config.astray_rad), direction * config.astray_m)
    return replace(camera, T_world_camera=camera.T_world_camera @ T)
