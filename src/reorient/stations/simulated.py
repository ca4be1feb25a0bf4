"""A simulated cell behind the driver protocols: an arm that holds an object before a fixed camera.

The camera ray-casts the whole frame, with or without a table; the arm moves as commanded, up to a repeatability error.
It is a cell to try ``robot.toml`` on without hardware, and the ground truth for calibration.
"""

import time
from functools import cache

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import se3, so3
from reorient.errors import ReorientError, StationError
from reorient.imaging import Camera, DepthImage
from reorient.se3 import Transform
from reorient.world.meshes import Mesh, bounding_radius
from reorient.world.objects import generated
from reorient.world.rendering import Placement, Renderer
from reorient.world.sensing import Sensor, randomised, sense

CAMERA = Camera(320, 240, 331.0, 331.0, 160.0, 120.0)
HOME_M = np.array([0.45, 0.1, 0.4])  # of the held object in base axes
_REACH_M = 0.9  # from the base to the tool
_DISTANCE_M = (0.55, 0.7)  # from the camera to the object
_LARGEST_OFFSET_M = 0.03  # of the object's centre from the tool's origin, along each axis
_TABLE_M = -0.35  # height of the table below the object


class SimulatedCell:
    """The state that camera and arm share, and the truth that an evaluation may read."""

    def __init__(
        self,
        mesh: Mesh,
        rng: Generator,
        sensor: Sensor | None = None,
        radius_m: float = 0.1,
        table: bool = False,
        repeatability: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """``sensor`` None: noise of 1 mm without the occluding rectangle. ``radius_m``: of the object's bounding
        sphere. ``repeatability``: standard deviations of each reached pose, unknown to the arm, in metres and radians.

        Drawn at random: the camera's mounting, above the table, within 4 degrees of the object's direction; the tool's
        orientation; how the object is held.
        """
        self.rng, self.sensor, self.table = rng, sensor or randomised(0.001), table
        self.renderer = Renderer(mesh)
        self.scale_m = radius_m / bounding_radius(self.renderer.mesh)
        self.camera = CAMERA
        R_tool, R_object = so3.sample_uniform(rng, 2)
        self.T_tool_object = se3.transform(R_object, rng.uniform(-1, 1, 3) * _LARGEST_OFFSET_M)
        self.T_base_tool = se3.transform(R_tool, HOME_M - R_tool @ self.T_tool_object[:3, 3])
        self.T_base_camera = _mounting(rng)
        self.repeatability = repeatability

    @property
    def T_camera_object(self) -> Transform:
        """The true pose of the object."""
        return np.asarray(se3.inverse(self.T_base_camera) @ self.T_base_tool @ self.T_tool_object)

    def frame(self) -> DepthImage:
        """A depth image of the whole view, now. Raises ReorientError where nothing is in view."""
        T = self.T_camera_object
        try:
            image = sense(
                self.rng, self.renderer, self.camera, T[:3, :3], Placement(self.scale_m, T[:3, 3]), self.sensor
            )
            depth_m = image.depth_m
        except ReorientError:
            depth_m = np.zeros((self.camera.height, self.camera.width), np.float32)
        if self.table:
            behind_m = self._table_m()
            depth_m = np.where((depth_m == 0) | ((behind_m > 0) & (behind_m < depth_m)), behind_m, depth_m)
        return DepthImage(depth_m, self.camera, time.monotonic())

    def _table_m(self) -> Float[np.ndarray, "height width"]:
        """Depth of the table, with noise."""
        up = self.T_base_camera[2]
        with np.errstate(divide="ignore"):
            depth_m = (HOME_M[2] + _TABLE_M - up[3]) / (self.camera.rays() @ up[:3])
        noise_m = self.rng.normal(0, self.sensor.noise_m, depth_m.shape) if self.sensor.noise_m else 0.0
        return np.where((depth_m > 0) & (depth_m < 2), depth_m + noise_m, 0).astype(np.float32)


def _mounting(rng: Generator) -> Transform:
    """A camera pose that has the object near the image centre, from a random direction above, with a random roll."""
    z = -so3.sample_axes(rng, 1)[0] * np.array([1, 1, -1])
    z[2] = -abs(z[2])
    x = np.cross(z, so3.sample_axes(rng, 1)[0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z], axis=1) @ so3.exp(rng.uniform(-1, 1, 3) * np.radians(4))
    return se3.transform(R, HOME_M - rng.uniform(*_DISTANCE_M) * z)


@cache
def cell_of(seed: int) -> SimulatedCell:
    """The cell of a number, the same for camera and arm: a generated object in a random mounting."""
    objects = generated(seed + 1)
    return SimulatedCell(objects.load(objects.names[seed]), np.random.default_rng(seed), table=True)


class SimulatedCamera:
    """The camera of a simulated cell."""

    def __init__(self, cell: SimulatedCell | int = 0) -> None:
        """``cell``: the cell, or the number of one."""
        self.cell = cell_of(cell) if isinstance(cell, int) else cell

    def capture(self) -> DepthImage:
        """The whole frame, now."""
        return self.cell.frame()

    def clock_s(self) -> float:
        """The host's clock: frames and moves take no time of their own."""
        return time.monotonic()


class SimulatedArm:
    """The arm of a simulated cell."""

    def __init__(self, cell: SimulatedCell | int = 0, start_deg: float = 0.0) -> None:
        """``cell``: the cell, or the number of one. ``start_deg``: angle by which the object is rotated at first."""
        self.cell = cell_of(cell) if isinstance(cell, int) else cell
        self.moves = 0
        axis = np.array([2.0, -1.0, 2.0]) / 3
        center_m = se3.apply(self.cell.T_base_tool, self.cell.T_tool_object[:3, 3])
        R = so3.exp(axis * np.radians(start_deg))
        self._commanded = se3.transform(R, center_m - R @ center_m) @ self.cell.T_base_tool
        self.cell.T_base_tool = self._commanded

    def pose(self) -> Transform:
        """The pose of the tool, without the repeatability error."""
        return np.array(self._commanded)

    def move_to(self, T_base_tool: Transform) -> Transform:
        """Move there at once."""
        if not self.reachable(T_base_tool):
            raise StationError("the simulated arm does not reach that pose")
        self.moves += 1
        self._commanded = np.array(T_base_tool)
        position, angle = self.cell.rng.standard_normal((2, 3)) * np.array(self.cell.repeatability)[:, None]
        self.cell.T_base_tool = self._commanded @ se3.transform(so3.exp(angle), position)
        return self.pose()

    def stop(self) -> None:
        """Nothing to do: it never moves on."""

    def reachable(self, T_base_tool: Transform) -> bool:
        """Whether the tool would be within reach of the base."""
        return float(np.linalg.norm(T_base_tool[:3, 3])) <= _REACH_M
