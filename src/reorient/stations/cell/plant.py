"""What is really there: the arm as it moves, the object as it is held, the cameras where they are.

A station may read the encoders, ask for moves and take images; all else in here is the truth, for placing objects and
for scores.
"""

import colorsys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator

from reorient import se3, so3
from reorient.errors import ReorientError, StationError
from reorient.imaging import Camera, DepthImage
from reorient.perception.calibration import MountedCamera
from reorient.perception.segmentation import ColorImage
from reorient.se3 import Transform
from reorient.stations.cell.arm import YUMI, Arm, Part
from reorient.stations.cell.drive import Drive, Errors, Load
from reorient.stations.cell.grasp import Grasp, find_grasp
from reorient.stations.cell.scene import NAME, Scene, mounted_above, projector_of, structured_light, window

_FRAME_S = 0.1  # a depth camera of this kind takes some 10 frames a second
_REACH_M = 0.115  # of the window of the images around the tool centre
_DENSITY_KG_M3 = 150.0  # of the object's bounding box: most things are hollow or of plastic
_SHOW_EMPTY = so3.exp(np.array([0.0, np.radians(75.0), 0.0]))  # R_world_tcp of the empty gripper in view
_PLACINGS = 300
_FEWEST_PX = 2000  # of the object, some 6 square centimetres: less of it asks nothing of an estimator
_STEEPEST_RAD = np.radians(50.0)  # of the approach, up or down: nearly horizontal, so that the arm hides little


@dataclass(frozen=True)
class PlantConfig:
    """What the cell is really like."""

    arm: Path = YUMI
    """MJCF of the arm; stations/cell/yumi.xml says what it needs."""
    tool_m: tuple[float, float, float] = (0.4, 0.15, 0.22)
    """Where the tool centre is kept, world axes: some 0.6 m below the cameras."""
    noise_m: float = 0.0005
    """Standard deviation of the depth noise."""
    errors: Errors = field(default_factory=Errors)
    """What is wrong with the arm's motion."""


class Plant:
    """The cell, its gripper empty and in view until it is given something to hold."""

    def __init__(self, config: PlantConfig, rng: Generator) -> None:
        self._rng, self._config = rng, config
        self.arm = Arm(config.arm)
        self.tool_m = np.array(config.tool_m)
        self.depth, self.color = mounted_above(self.tool_m)
        self._sensor = structured_light(config.noise_m)
        self._grasp: Grasp | None = None
        self._rgb = np.array(colorsys.hsv_to_rgb(rng.uniform(), rng.uniform(0.5, 0.9), rng.uniform(0.4, 0.9)))
        self._zero_rad = config.errors.encoder_zero_rad * rng.standard_normal(len(self.arm.joints))
        joints_rad = self.arm.solve(se3.transform(_SHOW_EMPTY, self.tool_m), self.arm.home_rad, self.fingers_m)
        self._drive = Drive(self.arm, joints_rad, self.fingers_m, None, config.errors, self._zero_rad, rng)

    # --- what a station may use -------------------------------------------------------------------------------------

    def read(self) -> Float[np.ndarray, " n"]:
        """Joint positions by the encoders."""
        return self._drive.read()

    def move(self, joints_rad: Float[np.ndarray, " n"]) -> None:
        """Bring the encoders there as well as the servos can."""
        self._drive.move(joints_rad)

    @property
    def fingers_m(self) -> float:
        """How far each finger is from closed."""
        return self.arm.stroke_m / 2 if self._grasp is None else self._grasp.fingers_m

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self._drive.time_s

    def images(self, colour: bool) -> tuple[DepthImage, ColorImage | None]:
        """What the cameras see a frame later, in a window around the gripper; the colour camera's only where asked
        for."""
        self._drive.wait(_FRAME_S)
        scene = self.scene()
        depth = scene.depth(self._rng, self.depth, self._window(self.depth), self._sensor)
        return depth, scene.color(self.color, self._window(self.color), self._rng) if colour else None

    # --- the truth --------------------------------------------------------------------------------------------------

    @property
    def R_world_object(self) -> Float[np.ndarray, "3 3"]:
        """The object's orientation, by true forward kinematics and what has slipped."""
        return (self._drive.true_held() @ self._held.T_tcp_object)[:3, :3]

    def scene(self) -> Scene:
        """All there is, as it is."""
        parts = self._drive.true_parts()
        return Scene(parts if self._grasp is None else [*parts, self._object(self._drive.true_held())])

    def shows_object(self) -> Bool[np.ndarray, "h w"]:
        """The pixels of the depth camera's window whose ray hits the object."""
        return self.scene().shows_object(self.depth, self._window(self.depth))

    def is_seen(self, joints_rad: Float[np.ndarray, " n"], least_share: float) -> bool:
        """Whether, there, that share of the object's silhouette shows past arm and fingers.

        To the depth camera, and to its projector: what is not lit has no depth.
        """
        thing = self._object(self.arm.tcp(joints_rad))
        alone, among = Scene([thing]), Scene([*self.arm.parts(joints_rad, self.fingers_m), thing])
        for eye in (self.depth, projector_of(self.depth)):
            camera = self._window(eye)
            camera = camera.resized(camera.width // 4, camera.height // 4)
            silhouette, shown = (scene.shows_object(eye, camera).sum() for scene in (alone, among))
            if shown < max(least_share * silhouette, _FEWEST_PX / 4**2):
                return False
        return True

    def hold(self, mesh: trimesh.Trimesh, least_share: float = 0.7) -> None:
        """Put an object, scaled to the gripper, between the fingers, in a random pose in which the camera sees it.

        Raises ReorientError for what cannot be held or cannot be seen.
        """
        for _ in range(_PLACINGS // 10):
            self._grasp = find_grasp(mesh, self._rng, self.arm.stroke_m)
            for _ in range(10):
                joints_rad = self._somewhere()
                if joints_rad is not None and self.is_seen(joints_rad, least_share):
                    self._drive = Drive(
                        self.arm,
                        joints_rad,
                        self.fingers_m,
                        self._load(),
                        self._config.errors,
                        self._zero_rad,
                        self._rng,
                    )
                    return
        raise ReorientError(
            f"no pose of the gripper in {_PLACINGS} shows {least_share:.0%} of the object, and {_FEWEST_PX} pixels: "
            "expected an object that reaches out of the fingers"
        )

    def _somewhere(self) -> Float[np.ndarray, " n"] | None:
        """Joint positions of a random pose, the approach nearly horizontal; None where the arm cannot reach it."""
        rise = self._rng.uniform(-_STEEPEST_RAD, _STEEPEST_RAD)
        R = so3.exp(self._rng.uniform(-np.pi, np.pi) * np.array([0.0, 0.0, 1.0]))
        R = R @ so3.exp((np.pi / 2 - rise) * np.array([0.0, 1.0, 0.0]))
        R = R @ so3.exp(self._rng.uniform(-np.pi, np.pi) * np.array([0.0, 0.0, 1.0]))
        try:
            return self.arm.solve(se3.transform(R, self.tool_m), self.arm.home_rad, self.fingers_m)
        except StationError:
            return None

    def _load(self) -> Load:
        """As of a box: meshes may be open or flat."""
        extents_m = np.ptp(self._held.mesh.vertices, axis=0)
        return Load(
            mass_kg=max(_DENSITY_KG_M3 * float(np.prod(extents_m)), 0.005),
            center_m=self._held.T_tcp_object[:3, 3],
            gyration_m=max(float(np.linalg.norm(extents_m)) / np.sqrt(12), 0.005),
        )

    def _object(self, T_world_tcp: Transform) -> Part:
        return Part(NAME, self._held.mesh, self._rgb, T_world_tcp @ self._held.T_tcp_object)

    @property
    def _held(self) -> Grasp:
        if self._grasp is None:
            raise ReorientError("the gripper is empty: expected hold(mesh) before")
        return self._grasp

    def _window(self, mounted: MountedCamera) -> Camera:
        return window(mounted, self.tool_m, _REACH_M)
