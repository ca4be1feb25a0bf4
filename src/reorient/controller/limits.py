"""Limits of a loop, and how a move keeps to them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import repeat

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.base import Reachable
from reorient.errors import ReorientError

_LEAST_STEP_RAD = float(np.radians(0.01))  # with smaller ones a move would never end
_TRIED = 300  # rotations around one that cannot be reached


@dataclass(frozen=True)
class Limits:
    """Limits on what the station is asked to do. Raises ReorientError for limits that allow nothing."""

    max_step_rad: float = float(np.pi)
    """Larger moves are made in parts."""
    max_rotation_rad: float = float("inf")
    """The loop ends before the angles of all moves add up to more."""
    max_translation_m: float = 0.3
    """Largest distance of one translation (``orient(translation=True)``)."""
    confirm: Callable[[Float[np.ndarray, "n n"]], bool] | None = None
    """Called with the first move, after the subscribers' ``decided``: a rotation (3, 3), or a (4, 4) transform of a
    translation before it (camera axes, left); the loop ends where it returns False."""
    dry_run: bool = False
    """Capture, estimate and decide once; move nothing."""
    wait_s: float = 0.5
    """Pause after an error of station or estimator."""
    timeout_s: float = float("inf")
    """The loop ends, and the robot is stopped, where a call of the station takes longer. If finite, the station is
    called from one thread of its own."""

    def __post_init__(self) -> None:
        if not (self.max_step_rad > 0 and self.max_rotation_rad > 0 and 0 <= self.wait_s < np.inf):
            raise ReorientError(
                f"largest step {self.max_step_rad} rad, largest total {self.max_rotation_rad} rad, pause "
                f"{self.wait_s} s: expected angles above 0 and a pause from 0"
            )
        if not self.max_translation_m > 0:
            raise ReorientError(f"largest translation {self.max_translation_m} m: expected metres above 0")
        if self.max_step_rad < _LEAST_STEP_RAD or not self.timeout_s > 0:
            raise ReorientError(
                f"largest step {np.degrees(self.max_step_rad):g} deg, timeout {self.timeout_s:g} s: expected at least "
                "0.01 deg, and seconds above 0"
            )

    def parts(self, R_step: Float[np.ndarray, "3 3"]) -> Iterator[Float[np.ndarray, "3 3"]]:
        """The move as equal rotations about one axis, each within the largest step."""
        rotvec = so3.log(R_step)
        count = max(1, int(np.ceil(float(np.linalg.norm(rotvec)) / self.max_step_rad - 1e-9)))
        yield from repeat(so3.exp(rotvec / count), count)


def nearest_reachable(R_step: Float[np.ndarray, "3 3"], reachable: Reachable) -> Float[np.ndarray, "3 3"] | None:
    """Of a fixed set of rotations the reachable one nearest to R_step, if it is nearer than no motion; else None."""
    share = np.linspace(0.95, 0.05, 19)[:, None]
    tried = np.concatenate([so3.exp(share * so3.log(R_step)), _dense_at_identity() @ R_step])
    away = so3.angle_difference(tried, R_step)
    order = np.argsort(away)
    nearer = order[away[order] < 0.97 * float(so3.angle(R_step))]
    return next((tried[i] for i in nearer[:_TRIED] if reachable(tried[i])), None)


@cache
def _dense_at_identity() -> Float[np.ndarray, "n 3 3"]:
    """Rotations that are dense near the identity: those of a grid, with smaller angles."""
    rotvec = so3.log(so3.grid(600))
    angle = np.linalg.norm(rotvec, axis=1, keepdims=True)
    return so3.exp(rotvec * (angle / np.pi) ** 2)
