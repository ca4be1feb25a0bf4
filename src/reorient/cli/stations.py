"""The choice of a station."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from reorient.cli.arguments import Metavar
from reorient.errors import ReorientError, check_range

if TYPE_CHECKING:
    from reorient.controller.station import Station


@dataclass(frozen=True)
class StationChoice:
    """Choice of the station."""

    station: Annotated[str | None, Metavar("STATION")] = None
    """A robot.toml, or a class of your own as module:Class, importable from here and made without arguments, or
    'rendered' for the simulator."""
    object_index: int = 0
    """Number of the generated object at the simulated station."""
    pose_seed: int = 0
    """Seed of the first pose of the simulated object."""
    start_deg: float = 0.0
    """Angle by which the simulated object is rotated from its first pose, about a random axis."""
    noise_mm: float = 0.0
    """Standard deviation of the simulated depth noise."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "object_index", "pose_seed", "noise_mm")
        check_range(self, "start_deg", high=180)

    @property
    def own(self) -> bool:
        """Whether it is a class of the user's own, not the simulator."""
        return self.station != "rendered"

    def open(self) -> "Station":
        """The station, ready. Raises ReorientError where it cannot be made, or none is named."""
        from reorient.stations import load_station

        name = self.check()
        if name.endswith(".toml"):
            from reorient.stations.robot_file import read_robot_file

            return read_robot_file(name).open_station()
        return load_station(name) if self.own else self._rendered()

    def check(self) -> str:
        """The name of the station. Raises ReorientError for none, or a wrong one."""
        if self.station is None:
            raise ReorientError(
                "--station is missing: expected a robot.toml, my_module:MyStation, or 'rendered' for the simulator"
            )
        if self.own and ":" not in self.station and not self.station.endswith(".toml"):
            raise ReorientError(f"station {self.station!r}: expected 'rendered', a robot.toml or my_module:MyStation")
        return self.station

    def _rendered(self) -> "Station":
        from reorient.stations.rendered import RenderedStation
        from reorient.world.objects import generated
        from reorient.world.rendering import load_world
        from reorient.world.sensing import randomised

        objects = generated(self.object_index + 1)
        rng, sensor = np.random.default_rng(self.pose_seed), randomised(self.noise_mm / 1000)
        station = RenderedStation(objects.load(objects.names[-1]), load_world("benchmark"), sensor, rng)
        rotate_away(station, self.start_deg, rng)
        return station


def rotate_away(station: Any, angle_deg: float, rng: np.random.Generator) -> None:
    """Rotate the object of a simulated station about a random axis."""
    from reorient import so3

    angle_rad = np.radians(angle_deg)
    station.rotate(so3.matrix_from_quat(so3.sample_bounded(rng, 1, angle_rad, angle_rad))[0])
