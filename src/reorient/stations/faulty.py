"""A station with random faults: for tests of the loop, and for measuring their effect."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.controller.station import Station
from reorient.errors import StationError
from reorient.imaging import DepthImage

CAPTURE_FAULTS = ("stale", "empty", "gone")
MOVE_FAULTS = ("slip", "refused", "partly")
GONE_FOR = 2  # consecutive captures without a frame
LARGEST_SLIP_RAD = float(np.radians(40))
FULL_SLACK_RAD = float(np.radians(30))  # smallest rotation with the whole slack


class FaultyStation:
    """Another station with random or planned faults, and with slack in its rotations.

    Faults of a capture: ``stale``, the frame before once more; ``empty``, a single return; ``gone``, no frame, twice.
    Faults of a move: ``slip``, the object rotates in the gripper, unknown to the robot; ``refused``, no motion;
    ``partly``, a part of the motion, as the robot reports. ``met`` lists the faults that occurred.
    """

    def __init__(
        self,
        station: Station,
        rng: Generator,
        chance: float = 0.0,
        slack_rad: float = 0.0,
        planned: Sequence[str] = (),
    ) -> None:
        """``chance``: probability of a fault at each capture and move. ``slack_rad``: error of each rotation of 30
        degrees or more, unknown to the robot, about a random axis; proportionally less for smaller ones. ``planned``:
        faults that occur in order, each at the next capture or move it fits, after the first act."""
        self._station, self._rng, self._chance, self._slack_rad = station, rng, chance, slack_rad
        self._planned = list(planned)
        self._before: DepthImage | None = None
        self._gone = 0
        self._acts = 0
        self.met: list[str] = []

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"] | None:
        """The station's."""
        return self._station.pivot_m

    def capture(self) -> DepthImage:
        """The station's image, or a fault."""
        fault = "gone" if self._gone else self._fault(CAPTURE_FAULTS if self._before else CAPTURE_FAULTS[1:])
        if fault == "gone":
            self._gone = (self._gone or GONE_FOR) - 1
            raise StationError("no frame: the camera does not answer")
        if fault == "stale" and self._before:
            return self._before
        image = self._station.capture()
        self._before = image
        if fault == "empty":
            depth_m = np.zeros_like(image.depth_m)
            row, column = np.argwhere(image.valid)[0]
            depth_m[row, column] = image.depth_m[row, column]
            return replace(image, depth_m=depth_m)
        return image

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The station's rotation, or a fault; returns the rotation that the robot reports."""
        fault = self._fault(MOVE_FAULTS)
        if fault == "refused":
            raise StationError("refused to move")
        if fault == "partly":
            R_step = so3.exp(self._rng.uniform(0.1, 0.9) * so3.log(R_step))
        slack_rad = self._slack_rad * min(1.0, float(so3.angle(R_step)) / FULL_SLACK_RAD)
        slip_rad = self._rng.uniform(0, LARGEST_SLIP_RAD) if fault == "slip" else 0.0
        slack, slip = so3.exp(so3.sample_axes(self._rng, 2) * np.array([[slack_rad], [slip_rad]]))
        self._station.rotate(slip @ slack @ R_step)
        return R_step

    def __getattr__(self, name: str) -> Any:
        """Optional members of the station: ``reachable``, ``clock_s``."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._station, name)

    def _fault(self, kinds: Sequence[str]) -> str:
        self._acts += 1
        planned = [kind for kind in self._planned if kind in kinds] if self._acts > 1 else []
        if planned:
            self._planned.remove(planned[0])
            self.met.append(planned[0])
        elif self._chance and self._rng.random() < self._chance:
            planned = [str(self._rng.choice(list(kinds)))]
            self.met.append(planned[0])
        return planned[0] if planned else ""
