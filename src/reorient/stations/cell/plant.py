"""The true state of the cell: the moving arm, the held object, the cameras.

A station may use the encoders, moves and images. Everything else is the truth, for placing objects and for scoring.
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
from reorient.perception.frame import ColorImage
from reorient.se3 import Transform
from reorient.stations.cell.arm import YUMI, Arm, Part
from reorient.stations.cell.drive import Drive, Errors, Load
from reorient.stations.cell.grasp import Grasp, find_grasp
from reorient.stations.cell.scene import NAME, Scene, mounted_above, projector_of, structured_light, window

_FRAME_S = 0.1  # such a depth camera takes about 10 frames per second
_REACH_M = 0.115  # radius around the tool centre that the images show
_DENSITY_KG_M3 = 150.0  # mass over the volume of the bounding box: most objects are hollow or of plastic
_SHOW_EMPTY = so3.exp(np.array([0.0, np.radians(75.0), 0.0]))  # R_world_tcp of the empty gripper in view
_PLACINGS = 300  # tried poses
_FEWEST_PX = 2000  # smallest visible area of the object, about 6 square centimetres
_STEEPEST_RAD = np.radians(50.0)  # largest slope of the approach; from above the arm would hide the object


@dataclass(frozen=True)
class PlantConfig:
    """Parameters of the true cell."""

    arm: Path = YUMI
    """MJCF of the arm; the head of stations/cell/yumi.xml lists the requirements."""
    tool_m: tuple[float, float, float] = (0.4, 0.15, 0.22)
    """Position of the tool centre, world axes: about 0.6 m below the cameras."""
    noise_m: float = 0.0005
    """Standard deviation of the depth noise."""
    errors: Errors = field(default_factory=Errors)
    """Errors of the arm's motion."""


class Plant:
    """The cell. The gripper is empty and in view until ``hold`` is called."""

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

    # --- available to a station -------------------------------------------------------------------------------------

    def read(self) -> Float[np.ndarray, " n"]:
        """Joint positions from the encoders."""
        return self._drive.read()

    def move(self, joints_rad: Float[np.ndarray, " n"]) -> None:
        """Drive the encoders to these positions, as well as the servos can."""
        self._drive.move(joints_rad)

    @property
    def fingers_m(self) -> float:
        """Opening of each finger from closed."""
        return self.arm.stroke_m / 2 if self._grasp is None else self._grasp.fingers_m

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self._drive.time_s

    def images(self, colour: bool) -> tuple[DepthImage, ColorImage | None]:
        """Images one frame later, in a window around the gripper; a colour image only if ``colour``."""
        self._drive.wait(_FRAME_S)
        scene = self.scene()
        depth = scene.depth(self._rng, self.depth, self._window(self.depth), self._sensor)
        return depth, scene.color(self.color, self._window(self.color), self._rng) if colour else None

    # --- the truth --------------------------------------------------------------------------------------------------

    @property
    def R_world_object(self) -> Float[np.ndarray, "3 3"]:
        """The object's true orientation, slip included."""
        return np.asarray((self._drive.true_held() @ self._held.T_tcp_object)[:3, :3])

    def scene(self) -> Scene:
        """All parts at their true poses."""
        parts = self._drive.true_parts()
        return Scene(parts if self._grasp is None else [*parts, self._object(self._drive.true_held())])

    def shows_object(self) -> Bool[np.ndarray, "h w"]:
        """The pixels of the depth camera's window whose ray hits the object."""
        return self.scene().shows_object(self.depth, self._window(self.depth))

    def is_visible(self, joints_rad: Float[np.ndarray, " n"], least_share: float) -> bool:
        """Whether at these joint positions that share of the object's silhouette is not hidden by arm and fingers.

        For the depth camera and for its projector, since unlit surface returns no depth.
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
        """Put an object, scaled to the gripper, between the fingers, at a random pose visible to the camera.

        Raises ReorientError if there is no grasp or no visible pose.
        """
        for _ in range(_PLACINGS // 10):
            self._grasp = find_grasp(mesh, self._rng, self.arm.stroke_m)
            for _ in range(10):
                joints_rad = self._random_joints()
                if joints_rad is not None and self.is_visible(joints_rad, least_share):
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

    def _random_joints(self) -> Float[np.ndarray, " n"] | None:
        """Joint positions of a random pose with a nearly horizontal approach; None if it is out of reach."""
        rise = self._rng.uniform(-_STEEPEST_RAD, _STEEPEST_RAD)
        R = so3.exp(self._rng.uniform(-np.pi, np.pi) * np.array([0.0, 0.0, 1.0]))
        R = R @ so3.exp((np.pi / 2 - rise) * np.array([0.0, 1.0, 0.0]))
        R = R @ so3.exp(self._rng.uniform(-np.pi, np.pi) * np.array([0.0, 0.0, 1.0]))
        try:
            return self.arm.solve(se3.transform(R, self.tool_m), self.arm.home_rad, self.fingers_m)
        except StationError:
            return None

    def _load(self) -> Load:
        """The load of a homogeneous box, because meshes can be open or flat."""
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
