"""Stations: a camera and a gripper behind one protocol, real, simulated or recorded."""

from typing import cast

from reorient.controller.station import Station, missing_members
from reorient.errors import ReorientError
from reorient.plugins import make_own


def load_station(name: str) -> Station:
    """A user's own station, ``my_module:MyStation``: a class that is imported (also from the working folder) and made
    without arguments.

    Raises ReorientError where it cannot be imported or lacks capture, rotate or pivot_m.
    """
    module_name, _, attribute = name.partition(":")
    if not module_name or not attribute:
        raise ReorientError(f"station {name!r}: expected my_module:MyStation")
    station = make_own("station", name)
    if missing := missing_members(station, ("capture", "rotate", "pivot_m")):
        raise ReorientError(
            f"station {name!r} has no {', '.join(missing)}: expected capture(), rotate(R_step), pivot_m"
        )
    return cast(Station, station)
