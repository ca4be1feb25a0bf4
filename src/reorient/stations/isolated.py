"""A station whose images are isolated: of a station that captures whole frames."""

from reorient.controller.station import Forwarding, Station, captured
from reorient.imaging import DepthImage, Isolation


class IsolatedStation(Forwarding):
    """A station with its images isolated; everything else is that of the station."""

    def __init__(self, station: Station, isolation: Isolation) -> None:
        super().__init__(station)
        self._isolation = isolation

    def capture(self) -> DepthImage:
        """The image of the object alone. Raises ReorientError as the isolation, and whatever the station raises."""
        return self._isolation(captured(self._station.capture()))
