"""The station of the simulated cell: encoders, images and a slightly wrong calibration, as in a real cell."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import se3, so3
from reorient.controller.station import rigid
from reorient.errors import ReorientError, StationError, unknown_name
from reorient.imaging import DepthImage
from reorient.perception.calibration import Calibration, MountedCamera
from reorient.perception.colour import ColourRange
from reorient.perception.frame import Frame
from reorient.perception.recalibration import corrected_calibration
from reorient.perception.segmentation import (
    ByColour,
    ByShape,
    Segmentation,
    isolate_object,
    learn_gripper_colour,
)
from reorient.stations.cell.arm import merged, rotated_pose
from reorient.stations.cell.plant import Plant, PlantConfig

SEGMENTATIONS = ("shape", "colour")


@dataclass(frozen=True)
class CellConfig:
    """Parameters of the station. Raises ReorientError for an unknown segmentation."""

    plant: PlantConfig = field(default_factory=PlantConfig)
    """Parameters of the true cell."""
    segmentation: str = "shape"
    """Segmentation that removes the gripper: by its known shape, or by its colour as in the paper."""
    gripper_colour: ColourRange | None = None
    """None: learned from a frame of the empty gripper."""
    calibration: Calibration | None = None
    """None: the true one, perturbed for each camera by ``calibration_error_m`` and ``calibration_error_rad``."""
    calibration_error_m: float = 0.001
    """Translation of a camera from its true position, in a random direction."""
    calibration_error_rad: float = float(np.radians(0.3))
    """Rotation of a camera from its true orientation, about a random axis."""

    def __post_init__(self) -> None:
        if self.segmentation not in SEGMENTATIONS:
            raise unknown_name("segmentation", self.segmentation, list(SEGMENTATIONS))


class SimulatedCell:
    """One arm below two cameras. ``plant`` is the true state: ``plant.hold(mesh)`` puts an object into the gripper.

    It starts with an empty gripper. The first frame corrects the calibration and gives the gripper's colour.
    """

    def __init__(self, rng: Generator, config: CellConfig | None = None) -> None:
        self.config = config = config or CellConfig()
        self.plant = Plant(config.plant, rng)
        self.arm = self.plant.arm
        self._tool_m = np.array(self.plant.tool_m)  # where rotations leave the tool centre
        self.calibration = config.calibration or Calibration(
            *(_perturbed(camera, config, rng) for camera in (self.plant.depth, self.plant.color))
        )
        empty = self.frame(colour=True)
        self.calibration = corrected_calibration(self.calibration, empty)
        self.segmentations: dict[str, Segmentation] = {"shape": ByShape()}
        if self.calibration.color is not None:
            colour = config.gripper_colour or learn_gripper_colour(empty, self.calibration)
            self.segmentations["colour"] = ByColour(colour)
        if config.segmentation not in self.segmentations:
            raise ReorientError("segmentation by colour without a colour camera: expected 'color' in the calibration")

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"]:
        """The tool centre in camera axes, metres, from encoders and calibration."""
        return se3.apply(self.calibration.depth.T_camera_world, self.arm.tcp(self.plant.read())[:3, 3])

    def capture(self) -> DepthImage:
        """Depth of the object alone, now."""
        name = self.config.segmentation
        return isolate_object(self.frame(name == "colour"), self.calibration, self.segmentations[name])

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Rotate the gripper about the tool centre. Returns the rotation measured by the encoders, camera axes.

        Raises StationError out of reach.
        """
        before_rad = self.plant.read()
        self.plant.move(self.plan(R_step))
        R_world = self.arm.tcp(self.plant.read())[:3, :3] @ self.arm.tcp(before_rad)[:3, :3].T
        return np.asarray(self._R_world_camera.T @ R_world @ self._R_world_camera)

    def move(self, T_step: se3.Transform) -> se3.Transform:
        """Move the gripper (camera axes, left). Returns the motion measured by the encoders, camera axes.

        Raises StationError out of reach.
        """
        T_camera = self.calibration.depth.T_camera_world
        before_rad = self.plant.read()
        before = self.arm.tcp(before_rad)
        target = se3.inverse(T_camera) @ rigid(T_step) @ T_camera @ before
        self.plant.move(self.arm.solve(target, before_rad, self.plant.fingers_m))
        self._tool_m = target[:3, 3]
        T_world = self.arm.tcp(self.plant.read()) @ se3.inverse(before)
        return np.asarray(T_camera @ T_world @ se3.inverse(T_camera))

    def clock_s(self) -> float:
        """The simulated time, the clock of the stamps."""
        return self.plant.time_s

    def reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """Whether ``rotate`` can execute this rotation."""
        try:
            self.plan(R_step)
        except StationError:
            return False
        return True

    def plan(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " n"]:
        """Joint positions after this rotation, camera axes. Raises StationError if there are none."""
        if not so3.is_rotation(np.asarray(R_step)):
            raise StationError("refused to rotate: expected a (3, 3) rotation matrix")
        now_rad = self.plant.read()
        R_step_world = self._R_world_camera @ R_step @ self._R_world_camera.T
        target = rotated_pose(self.arm.tcp(now_rad), R_step_world, self._tool_m)
        return self.arm.solve(target, now_rad, self.plant.fingers_m)

    def frame(self, colour: bool) -> Frame:
        """Measurements of cameras and encoders now; a colour image only if ``colour``."""
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
        return np.asarray(self.calibration.depth.T_world_camera[:3, :3])


def _perturbed(camera: MountedCamera, config: CellConfig, rng: Generator) -> MountedCamera:
    direction, axis = so3.sample_axes(rng, 2)
    T = se3.transform(so3.exp(axis * config.calibration_error_rad), direction * config.calibration_error_m)
    return replace(camera, T_world_camera=camera.T_world_camera @ T)
