"""A station whose images are isolated: of a station that captures whole frames."""

from typing import Any

from reorient.controller.station import Station, captured
from reorient.imaging import DepthImage, Isolation


class IsolatedStation:
    """A station with its images isolated; everything else is that of the station."""

    def __init__(self, station: Station, isolation: Isolation) -> None:
        self._station, self._isolation = station, isolation

    def capture(self) -> DepthImage:
        """The image of the object alone. Raises ReorientError as the isolation, and whatever the station raises."""
        return self._isolation(captured(self._station.capture()))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._station, name)
