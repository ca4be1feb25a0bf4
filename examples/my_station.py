"""A station of your own: a class with capture(), rotate(R_step) and pivot_m. Copy, and put your drivers in.

    reorient capture goal.npz --station examples.my_station:TurntableStation
    reorient orient goal.npz --station examples.my_station:TurntableStation

This one is a simulated turntable, so that the example runs without hardware: it holds a generated object 25 degrees
away from where it was taught, and can only turn about the camera's vertical axis, which it honestly reports.
"""

import numpy as np

from reorient import DepthImage, so3
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import generated
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised


class TurntableStation:
    """One axis, and no more than 10 degrees a move."""

    def __init__(self) -> None:
        objects = generated(1)
        rng = np.random.default_rng(0)
        self._cell = RenderedStation(objects.load(objects.names[0]), load_world("benchmark"), randomised(), rng)

    @property
    def pivot_m(self) -> np.ndarray:
        """Where the table's axis passes through the object, camera axes; good to about 1 cm."""
        return self._cell.pivot_m

    def capture(self) -> DepthImage:
        """Ask your camera for depth in metres, and isolate the object (reorient.imaging.isolate)."""
        return self._cell.capture()

    def rotate(self, R_step: np.ndarray) -> np.ndarray:
        """Turn as far as the table can, and return what was really done: here, the part about the vertical axis."""
        about_y = float(np.clip(so3.log(R_step)[1], np.radians(-10), np.radians(10)))
        return self._cell.rotate(so3.exp(np.array([0.0, about_y, 0.0])))
