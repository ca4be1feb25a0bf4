"""The successor of Algorithm 1: full moves to the likeliest orientation, and a memory of all that was seen.

The robot knows the rotation that it made between two captures, so every estimate, and every alternative that it names,
can be carried along to now: all of them are claims about one thing, the rotation that is still missing. They are
weighed together as *candidates*. The strategy goes to the likeliest; there it looks twice, checks whether the goal
looks as like the object as the object looks like itself (``recognition``), averages, and makes the last small moves.
What fails the check is a false arrival: it loses its weight, and its half turns about the axes of what is seen become
candidates, as most false arrivals are half turns of nearly symmetric objects.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.base import Decision, Reachable, Step, known_part, rotations_since
from reorient.controller.memory import NEAR_RAD, Candidate, average, candidates, confidence, stands
from reorient.depth import DepthImage
from reorient.errors import ReorientError

FIRST_RAD = float(np.radians(1))  # from farther, the first capture of a place is reason enough to move
MOST_LOOKS = 6  # captures of the last place
STEADY_RAD = float(np.radians(0.12))  # the average's standard error that needs no more looks
EQUIVALENT = 0.4  # of the likeliest candidate's probability: as good, and taken if nearer
LEAST_SURE = 0.5  # below this the loop ends without claiming the goal


@dataclass(frozen=True)
class Fusing:
    """Few moves from any start: the likeliest of all candidates, checked on arrival. Raises ReorientError for limits
    that allow nothing."""

    max_steps: int = 40
    """Largest number of images."""
    most_moves: int = 12
    tolerance_rad: float = float(np.radians(0.1))
    """Done when the averaged prediction is at most this, or its own standard error."""
    patience: int = 3
    """How many failures in a row it bears."""
    memory: bool = False
    """Whether the estimator is given earlier captures, too."""

    def __post_init__(self) -> None:
        if not (self.max_steps >= 2 and self.most_moves >= 1 and self.tolerance_rad >= 0 and self.patience >= 0):
            raise ReorientError(
                f"{self.max_steps} images, {self.most_moves} moves, tolerance {self.tolerance_rad}, patience "
                f"{self.patience}: expected at least 2 images, 1 move, and no negative number"
            )

    def recalled(self, steps: Sequence[Step]) -> list[tuple[DepthImage, Float[np.ndarray, "3 3"]]]:
        """Earlier captures by known rotations."""
        known = known_part(steps) if self.memory else []
        return [(step.image, R) for step, R in zip(known, rotations_since(known), strict=True)]

    def decide(self, steps: Sequence[Step], goal: DepthImage, reachable: Reachable) -> Decision:
        """Go on to the likeliest candidate, look again, make the last small move, or end."""
        known = known_part(steps)
        seen = stands(known, goal)
        best = _nearest_of_the_best(candidates(seen), reachable)
        moves_left = self.most_moves - sum(step.R_step is not None for step in steps)
        looks_left = self.max_steps - len(steps)
        if best.angle_rad > NEAR_RAD:
            return _approach(best, min(moves_left, looks_left))
        here = seen[-1]
        R_goal_now, error_rad = average(known, best.R_goal_now)
        angle_rad = float(so3.angle(R_goal_now))
        degrees = f"{np.degrees(angle_rad):.2f} degrees"
        if len(here.images) < 2 and moves_left > 0 and angle_rad > FIRST_RAD:
            return Decision(f"near ({best.share:.0%} sure): turns by the {degrees} that are left", R_goal_now)
        if looks_left > 0 and (len(here.images) < 2 or (error_rad > STEADY_RAD and len(here.images) < MOST_LOOKS)):
            return Decision(f"{degrees} seem left, give or take {np.degrees(error_rad):.2f}: looks again")
        close = angle_rad <= max(self.tolerance_rad, error_rad)
        if not close and moves_left > 0 and looks_left > 0:
            return Decision(f"{len(here.images)} looks agree on {degrees}: turns by them", R_goal_now)
        sure = confidence(here)
        said = f"{degrees} are left, give or take {np.degrees(error_rad):.2f}; {sure:.0%} sure"
        if sure < LEAST_SURE:
            said += "; nothing that was tried matches the goal as well as the object matches itself"
        return Decision(said, None, True, sure >= LEAST_SURE, sure)


def _approach(best: Candidate, moves_left: int) -> Decision:
    """A full move to a candidate that is not near."""
    turn = f"{np.degrees(best.angle_rad):.0f} degrees"
    if moves_left <= 0:
        said = f"no orientation was found that surely matches the goal; the likeliest is {turn} from here"
        return Decision(said, ends=True, confidence=0.0)
    why = "a half turn of a false arrival" if best.guessed else "the likeliest orientation"
    return Decision(f"{why} ({best.share:.0%} likely): turns by {turn}", best.R_goal_now)


def _nearest_of_the_best(found: Sequence[Candidate], reachable: Reachable) -> Candidate:
    """Of the candidates that are about as likely as the likeliest, the nearest that can be reached."""
    good = [x for x in found if x.share >= EQUIVALENT * found[0].share]
    good.sort(key=lambda candidate: candidate.angle_rad)
    return next((x for x in good if x.angle_rad <= NEAR_RAD or reachable(x.R_goal_now)), good[0])
