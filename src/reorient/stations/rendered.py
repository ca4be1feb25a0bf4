"""A station without a robot: the object floats before a rendered camera and rotates exactly as commanded."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import se3, so3
from reorient.controller.station import rigid
from reorient.errors import StationError
from reorient.imaging import DepthImage
from reorient.se3 import Transform
from reorient.world.meshes import Mesh
from reorient.world.rendering import Renderer, World
from reorient.world.sensing import Sensor, sense

FRAME_S = 0.1  # simulated seconds of a capture or a move


class RenderedStation:
    """The simulator of the paper's controller experiments.

    Captures are occluded by the sensor's rectangle (the gripper); the goal is not. ``R_camera_object`` is the true
    orientation, which only an evaluation may read.
    """

    def __init__(
        self,
        mesh: Mesh,
        world: World,
        sensor: Sensor,
        rng: Generator,
        R_camera_object: Float[np.ndarray, "3 3"] | None = None,
    ) -> None:
        self._renderer = Renderer(mesh)
        self._world = world
        self._sensor = sensor
        self._rng = rng
        self.placement = world.place(rng, self._renderer.mesh)
        self.R_camera_object = so3.sample_uniform(rng, 1)[0] if R_camera_object is None else R_camera_object
        self.pivot_m = self.placement.nominal_pivot_m(rng)
        self._time_s = 0.0

    def capture(self) -> DepthImage:
        """The present depth image, occluded by the gripper's rectangle."""
        return self._sense(occluded=True)

    def capture_goal(self) -> DepthImage:
        """The present depth image without occlusion, for use as a goal."""
        return self._sense(occluded=False)

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Rotate the object exactly (camera axes, left). Raises StationError where R_step is no rotation."""
        if not so3.is_rotation(np.asarray(R_step)):
            raise StationError("refused to rotate: expected a (3, 3) rotation matrix")
        self.R_camera_object = R_step @ self.R_camera_object
        self._time_s += FRAME_S
        return R_step

    def move(self, T_step: Transform) -> Transform:
        """Move the object exactly (camera axes, left). Raises StationError where T_step is no rigid transform."""
        T = rigid(T_step)
        self.R_camera_object = T[:3, :3] @ self.R_camera_object
        self.placement = replace(self.placement, center_m=se3.apply(T, self.placement.center_m))
        self.pivot_m = se3.apply(T, self.pivot_m)
        self._time_s += FRAME_S
        return T

    def clock_s(self) -> float:
        """Simulated seconds since the station was made: the clock of the frames' stamps."""
        return self._time_s

    def _sense(self, occluded: bool) -> DepthImage:
        image = sense(
            self._rng,
            self._renderer,
            self._world.camera,
            self.R_camera_object,
            self.placement,
            self._sensor,
            self._world.quantum_m,
            occluded,
        )
        self._time_s += FRAME_S
        return replace(image, stamp_s=self._time_s)
