"""Stations: a camera and a gripper, behind one interface."""

import importlib
import sys
from pathlib import Path

from reorient.errors import ReorientError
from reorient.stations.base import Station


def load_station(name: str) -> Station:
    """A user's own station, ``my_module:MyStation``: imported (the working folder included) and called with nothing.

    Raises ReorientError where it cannot be imported or lacks capture, rotate or pivot_m.
    """
    module_name, _, attribute = name.partition(":")
    if not module_name or not attribute:
        raise ReorientError(f"station {name!r}: expected 'rendered' or my_module:MyStation")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        station = getattr(importlib.import_module(module_name), attribute)()
    except Exception as error:  # the user's code may raise anything
        raise ReorientError(
            f"cannot make station {name!r} ({type(error).__name__}: {error}): expected an importable class"
        ) from error
    if missing := [member for member in ("capture", "rotate", "pivot_m") if not hasattr(station, member)]:
        raise ReorientError(
            f"station {name!r} has no {', '.join(missing)}: expected capture(), rotate(R_step), pivot_m"
        )
    return station
