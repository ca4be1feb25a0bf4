"""What a station is: a camera that sees the object and a gripper that turns it."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient.depth import DepthImage


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
