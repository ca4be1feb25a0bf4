"""What a station is: a camera that sees the object and a gripper that turns it."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient.errors import ReorientError, StationError
from reorient.imaging import DepthImage


@runtime_checkable
class Station(Protocol):
    """A robot cell, real or simulated. Failures are raised, as StationError or whatever the driver raises.

    Two methods more are used where a station has them: ``reachable(R_step) -> bool``, whether ``rotate`` would do it;
    and ``clock_s() -> float``, the clock that frames are stamped with, which shows up a frame that was captured before
    the last move ended. Without it only a frame that is not newer than the last one before the move is refused.
    """

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"] | None:
        """The centre that the gripper turns the object about, in camera axes, good to about 1 cm; None if unknown."""
        ...

    def capture(self) -> DepthImage:
        """The isolated object as the camera sees it now."""
        ...

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Turn the object by R_step (camera axes, left: R_after = R_step @ R_before) and return what was done."""
        ...


def lacking(thing: object, members: Sequence[str]) -> list[str]:
    """Which of the members a thing does not have; one that fails when it is read is there."""

    def there(member: str) -> bool:
        try:
            return hasattr(thing, member)
        except Exception:
            return True

    return [member for member in members if not there(member)]


def pivot_of(station: Station) -> Float[np.ndarray, "3"] | None:
    """The station's pivot. Raises StationError where the station fails to tell it."""
    try:
        return station.pivot_m
    except ReorientError:
        raise
    except Exception as error:
        raise StationError(f"the station failed to tell its pivot_m: {type(error).__name__}: {error}") from error


def captured(image: object) -> DepthImage:
    """What ``capture`` returned. Raises StationError where that is no image."""
    if not isinstance(image, DepthImage):
        raise StationError(f"capture() returned a {type(image).__name__}: expected DepthImage(depth_m, camera)")
    return image
