"""A station of your own: a class with capture(), rotate(R_step) and pivot_m. Copy it, and put your drivers in.

    reorient capture goal.npz --station examples.my_station:at_goal
    reorient orient goal.npz --station examples.my_station:TurntableStation

This one is a simulated turntable, so that the example runs without hardware. Its object stands 25 degrees away from the
goal. It can only rotate about the camera's vertical axis, at most 10 degrees a move, and reports what it did.
"""

import numpy as np

from reorient import DepthImage, so3
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import generated
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised

LARGEST_MOVE_RAD = np.radians(10)


class TurntableStation:
    """One vertical axis."""

    def __init__(self, start_deg: float = 25.0) -> None:
        objects = generated(5)
        sensor, rng = randomised(noise_m=0.001), np.random.default_rng(0)
        self._cell = RenderedStation(objects.load(objects.names[4]), load_world("benchmark"), sensor, rng)
        self._cell.rotate(about_vertical(np.radians(start_deg)))

    @property
    def pivot_m(self) -> np.ndarray:
        """The point of the object on the axis, camera axes, metres; good to about 1 cm."""
        return self._cell.pivot_m

    def capture(self) -> DepthImage:
        """Get a depth image in metres from your camera, and isolate the object (reorient.imaging.isolate)."""
        return self._cell.capture()

    def rotate(self, R_step: np.ndarray) -> np.ndarray:
        """Rotate as far as the table can, and return the rotation made: here the part about the vertical axis."""
        angle_rad = np.clip(so3.log(R_step)[1], -LARGEST_MOVE_RAD, LARGEST_MOVE_RAD)
        return self._cell.rotate(about_vertical(angle_rad))


def about_vertical(angle_rad: float) -> np.ndarray:
    """The rotation about the camera's y axis."""
    return so3.exp(np.array([0.0, angle_rad, 0.0]))


def at_goal() -> TurntableStation:
    """The station with its object at the goal, to capture the goal image."""
    return TurntableStation(start_deg=0.0)
