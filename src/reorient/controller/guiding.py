"""Guidance for a person who rotates an object by hand before a camera until it matches the goal.

``Guide`` takes one image after another, tracks the rotation that remains, and makes a ``GuideState`` of each: what a
view shows and what the worker is told. It moves nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import check_range
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage

GuideStatus = Literal["no_object", "searching", "rotate", "hold", "verifying", "matched"]
"""``no_object``: the camera shows none. ``searching``: the rotation is unknown: at first, and where the object is lost,
hidden or another one. ``rotate``: it is known, and more than the tolerance. ``hold``: it is within the tolerance.
``verifying``: the whole search confirms the match. ``matched``: it matches."""


@dataclass(frozen=True, eq=False)
class GuideState:
    """What is known after one image; passed to every subscriber of a guide, in order, in the guide's thread."""

    index: int
    """Number of the image, from 0."""
    time_s: float
    """Time of the image on the guide's clock, from the start."""
    status: GuideStatus
    instruction: str
    """What the worker is to do, in words: "rotate 23 deg to the left, tilt 5 deg towards you"."""
    image: DepthImage | None = None
    """The object now; None for ``no_object``."""
    estimate: RotationEstimate | None = None
    """Motion from the image to the goal; None where it is unknown."""
    held_s: float = 0.0
    """How long the object has been within the tolerance."""
    part: int = 0
    """Number of the object, from 0: a new one begins when the matched one was taken away."""

    @property
    def R_goal_current(self) -> Float[np.ndarray, "3 3"] | None:
        """The rotation that remains, camera axes (left multiplication); None where it is unknown."""
        return None if self.estimate is None else self.estimate.R_goal_current

    @property
    def angle_rad(self) -> float | None:
        """The angle that remains, in [0, pi]; None where it is unknown."""
        return None if self.estimate is None else self.estimate.angle_rad

    @property
    def axis(self) -> Float[np.ndarray, "3"] | None:
        """Unit axis of the rotation that remains, camera axes; None where it is unknown."""
        return None if self.estimate is None else so3.quat_axis(self.estimate.quat_wxyz)

    @property
    def confidence(self) -> float | None:
        """Probability that the error of the rotation is below 5 degrees; None where it is unknown."""
        return None if self.estimate is None else self.estimate.confidence


GuideSubscriber = Callable[[GuideState], None]
