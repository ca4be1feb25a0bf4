"""The options that limit moves, and the question before the first one."""

import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from reorient.errors import ReorientError, check_range

if TYPE_CHECKING:
    from reorient.controller import Limits

OWN_STEP_DEG, OWN_ROTATION_DEG = 45.0, 720.0  # limits for a station of the user's own


@dataclass(frozen=True)
class LimitChoice:
    """Limits of the moves."""

    max_step_deg: float | None = None
    """Largest angle of one move, above which it is made in parts, by default 45 for a station of your own and else
    180."""
    max_rotation_deg: float | None = None
    """Largest sum of the angles of all moves, by default 720 for a station of your own and else unlimited."""
    dry_run: bool = False
    """Capture, estimate and print the first move, but move nothing."""
    confirm_first_move: bool = False
    """Ask at the terminal before the first move, as it is done for a station of your own anyway."""
    yes: bool = False
    """Make the first move without asking."""
    timeout_s: float | None = None
    """Longest time of a capture or a move, after which the loop ends and the robot is stopped, by default unlimited."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "max_step_deg", "max_rotation_deg", "timeout_s", above=True)
        if self.yes and self.confirm_first_move:
            raise ReorientError("--yes and --confirm-first-move contradict each other: expected one of them")

    def of(self, own: bool) -> "LimitChoice":
        """The choice with its defaults for the user's own station, or for any other."""
        if not own:
            return self
        return replace(
            self,
            max_step_deg=OWN_STEP_DEG if self.max_step_deg is None else self.max_step_deg,
            max_rotation_deg=OWN_ROTATION_DEG if self.max_rotation_deg is None else self.max_rotation_deg,
            confirm_first_move=not self.yes,
        )

    def limits(self, wait_s: float = 0.5) -> "Limits":
        """The limits of the loop."""
        from reorient.controller import Limits

        return Limits(
            max_step_rad=np.radians(180.0 if self.max_step_deg is None else self.max_step_deg),
            max_rotation_rad=np.inf if self.max_rotation_deg is None else np.radians(self.max_rotation_deg),
            confirm=_confirmed if self.confirm_first_move else None,
            dry_run=self.dry_run,
            wait_s=wait_s,
            timeout_s=np.inf if self.timeout_s is None else self.timeout_s,
        )


def _confirmed(step: np.ndarray) -> bool:
    """Ask at the terminal, below the reason for the move; no answer is a no. ``step``: a rotation or a translation."""
    from reorient import so3

    rotates = step.shape == (3, 3)
    move = np.degrees(so3.log(step)) if rotates else 1000 * step[:3, 3]
    kind, unit = ("rotation vector", "deg") if rotates else ("translation", "mm")
    vector = " ".join(f"{x:.1f}" for x in move)
    plan = f"first move: {np.linalg.norm(move):.1f} {unit} ({kind} [{vector}] {unit}, camera axes)"
    return confirmed(plan, "make this move?")


def confirmed(plan: str, question: str) -> bool:
    """Print a plan and ask for it at the terminal; no answer is a no."""
    print(plan, file=sys.stderr)
    print(f"{question} [y/N]", file=sys.stderr, flush=True)
    try:
        return input().strip().lower() in ("y", "yes")
    except EOFError:
        print("no answer: --yes moves without asking", file=sys.stderr)
        return False
