"""How a loop ends, and its words for a plan and an error."""

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.base import Status, degrees
from reorient.plugins import in_words


class Ended(Exception):
    """The loop is over."""

    def __init__(
        self, status: Status, reason: str, confidence: float | None = None, bound_rad: float | None = None
    ) -> None:
        super().__init__(reason)
        self.status, self.reason, self.confidence, self.bound_rad = status, reason, confidence, bound_rad


def plan(R_step: Float[np.ndarray, "3 3"] | None, end: Ended | None) -> str:
    """What a dry run would do; empty where it would not move."""
    if end is not None or R_step is None:
        return end.reason if end is not None else ""
    rotvec = " ".join(f"{x:.1f}" for x in np.degrees(so3.log(R_step)))
    return f"would rotate by {degrees(float(so3.angle(R_step)), 1)} (rotation vector [{rotvec}] deg, camera axes)"


def rotation_error(error: BaseException | None) -> str:
    """The error of a move in words; empty without one."""
    return "" if error is None else f"the station failed to rotate: {in_words(error)}"
