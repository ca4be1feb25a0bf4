"""What a loop may do, and how a move keeps to it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.base import Reachable
from reorient.errors import ReorientError

_ASKED = 300  # rotations that are tried around one that cannot be reached


@dataclass(frozen=True)
class Limits:
    """Bounds on what the station is asked to do. Raises ReorientError for bounds that allow nothing."""

    largest_step_rad: float = float(np.pi)
    """Larger moves are made in parts."""
    largest_total_rad: float = float("inf")
    """The loop ends rather than turn by more than this in all."""
    confirm: Callable[[Float[np.ndarray, "3 3"]], bool] | None = None
    """Asked before the first move; the loop ends where it says no."""
    dry_run: bool = False
    """Capture, estimate and decide once; move nothing."""
    wait_s: float = 0.5
    """Pause after a failure before the station is asked again."""

    def __post_init__(self) -> None:
        if not (self.largest_step_rad > 0 and self.largest_total_rad > 0 and 0 <= self.wait_s < np.inf):
            raise ReorientError(
                f"largest step {self.largest_step_rad} rad, largest total {self.largest_total_rad} rad, pause "
                f"{self.wait_s} s: expected angles above 0 and a pause from 0"
            )

    def parts(self, R_step: Float[np.ndarray, "3 3"]) -> Iterator[Float[np.ndarray, "3 3"]]:
        """The move as equal turns about one axis, each within the largest step."""
        rotvec = so3.log(R_step)
        count = max(1, int(np.ceil(float(np.linalg.norm(rotvec)) / self.largest_step_rad - 1e-9)))
        yield from [so3.exp(rotvec / count)] * count


def nearest_reachable(R_step: Float[np.ndarray, "3 3"], reachable: Reachable) -> Float[np.ndarray, "3 3"] | None:
    """Of a spread of rotations the reachable one nearest to R_step, if it comes nearer than staying; else None."""
    share = np.linspace(0.95, 0.05, 19)[:, None]
    candidates = np.concatenate([so3.exp(share * so3.log(R_step)), _spread() @ R_step])
    away = so3.angle_difference(candidates, R_step)
    order = np.argsort(away)
    nearer = order[away[order] < 0.97 * float(so3.angle(R_step))]
    return next((candidates[i] for i in nearer[:_ASKED] if reachable(candidates[i])), None)


@cache
def _spread() -> Float[np.ndarray, "n 3 3"]:
    """Rotations that are dense near none: those of a grid, each turned by less."""
    rotvec = so3.log(so3.grid(600))
    angle = np.linalg.norm(rotvec, axis=1, keepdims=True)
    return so3.exp(rotvec * (angle / np.pi) ** 2)
