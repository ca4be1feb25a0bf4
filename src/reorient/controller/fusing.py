"""The successor of Algorithm 1: full moves to the likeliest orientation, and a memory of all that was seen.

The robot knows the rotation that it made between two captures, so every estimate, and every alternative that it names,
can be carried along to now: all of them are claims about one thing, the rotation that is still missing. They are
weighed together as *candidates*. The strategy goes to the likeliest; there it looks twice, checks whether the goal
looks as like the object as the object looks like itself (``recognition``), averages, and makes the last small moves.
What fails the check is a false arrival: it loses its weight, and its half turns about the axes of what is seen become
candidates, as most false arrivals are half turns of nearly symmetric objects. Where such a half turn is contradicted
by no capture, it is visited even from an arrival that leaves no doubt, and what matches better, depth by depth, is
taken: the one goal image is all that can tell them apart. Where two match equally, a look from another side tells
whether they are one orientation of a symmetric object; if not, the loop ends at even odds, without a claim.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import erfc, sqrt
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.base import Decision, Reachable, Step, known_part, rotations_since
from reorient.controller.belief import (
    NEAR_RAD,
    SAME_RAD,
    Candidate,
    Stand,
    arrival_log_odds,
    at,
    average,
    candidates,
    is_symmetry,
    nearest,
    stands,
)
from reorient.errors import ReorientError
from reorient.imaging import DepthImage

FIRST_RAD = float(np.radians(1))  # from farther, the first capture of a place is reason enough to move
MOST_LOOKS = 6  # captures of the last place, and of one that is compared with another
STEADY_RAD = float(np.radians(0.09))  # the average's standard error that needs no more looks
CLEARLY = 1.5  # standard errors
EQUIVALENT = 0.9  # log odds below the likeliest candidate's: as good, and taken if nearer
BETTER = 0.5  # log odds by which an examined pose must beat the present one to be returned to
SMALL_RAD = float(np.radians(60))  # between start and goal; of uniform starts one in 17 is so near
TIE = 3.0  # log odds by which an examined pose must beat another: less is noise, and no better than even odds
SURE_FROM_AFAR = 0.95  # what a view from elsewhere gives, so that no rival need be seen
MATCHES = 6.5  # log odds of an arrival, to the same end: one in ten right ones has less
NAMED = 0.2  # what makes an alternative a rival
ALIKE = 0.3  # agreement that a half turn may lose and still be one: those from false arrivals to the goal lost 0.26
HARDLY_ALIKE = 0.6  # the same for an arrival in doubt
RESERVED = 3  # moves kept for the way back to the best and the last small ones
RIGHT_RAD = float(np.radians(5))  # what a confidence is about
ERR_RAD = float(np.radians(0.5))  # of an average, as its captures err alike
ENOUGH_RAD = float(np.radians(0.5))  # left where no more moves are allowed: a servo's play may forbid the tolerance
LEAST_SURE = 0.5  # below this the loop ends without claiming the goal
LEAST_LIKENESS = 0.5  # the same, of the most that the place had: an estimator may be sure where images never match


@dataclass(frozen=True)
class Fusing:
    """Few moves from any start: the likeliest of all candidates, checked on arrival. Raises ReorientError for limits
    that allow nothing."""

    max_steps: int = 40
    """Largest number of images."""
    most_moves: int = 12
    """Largest number of moves."""
    tolerance_rad: float = float(np.radians(0.08))
    """Done when the averaged prediction is at most this, or not clearly above its own standard error."""
    patience: int = 3
    """How many failures in a row it bears."""
    takes_back: ClassVar[bool] = True
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
        """Examine an arrival, go on to the likeliest candidate, see a rival, make the last small move, or end."""
        known = known_part(steps)
        seen = stands(known, goal)
        every = candidates(seen)
        found = [x for x in every if x.visits or not _hidden(x.R_goal_now, known)]
        if not found:  # what could not be seen is tried once more: the camera may have been silent
            found = [x for x in every if _hidden(x.R_goal_now, known) == 1]
        moves_left = self.most_moves - sum((step.R_step is not None) + step.undone for step in steps)
        looks_left = self.max_steps - len(steps)
        here = _here(found, seen[-1])
        looks = len(seen[-1].images)
        if here is not None and looks < 2 and looks_left > 0:
            return _examine(here, known, moves_left)
        last = min(moves_left, looks_left - MOST_LOOKS) <= RESERVED
        choice = [x for x in found if x is here or x.angle_rad > NEAR_RAD]
        if last:  # no more experiments: of the poses that were examined the best, if there is one
            choice = [x for x in choice if x.examined] or [x for x in choice if not x.guessed]
        best = _best(choice, here, reachable) if choice else None
        rival = _rival(best, found, seen, reachable) if best is not None and not last else None
        if rival is not None and best is here and looks < MOST_LOOKS and looks_left > RESERVED + MOST_LOOKS:
            return Decision("this may be the goal, but another orientation may, too: looks again, to compare them")
        if rival is not None:
            turn = f"{np.degrees(rival.angle_rad):.0f} degrees"
            why = "a half turn of it" if rival.guessed else f"another orientation ({rival.support:.0%} by one view)"
            return Decision(f"what was found may be the goal, but {why} may, too: turns by {turn}", rival.R_goal_now)
        if not last and looks < MOST_LOOKS and _equal(here, best):
            return Decision("this may be the goal, but what was seen before may, too: looks again, to compare them")
        if best is None or best is not here:
            return _approach(best, min(moves_left, looks_left))
        twins = [x for x in found if _equal(x, best)]
        compared = sum(len(stand.images) for stand in seen if stand.likeness is not None and at(best, stand))
        if twins and max(compared, looks) < MOST_LOOKS and looks_left > 0:
            return Decision("another orientation matches as well: looks again, to compare them")
        symmetric, R_elsewhere = _symmetric(best, twins, seen)
        if symmetric is None and not last and reachable(R_elsewhere) and not _hidden(R_elsewhere, known):
            turn = f"{np.degrees(so3.angle(R_elsewhere)):.0f} degrees"
            why = "another orientation matches as well; whether the object is symmetric shows from elsewhere"
            return Decision(f"{why}: turns by {turn}", R_elsewhere)
        return self._finish(known, best, seen[-1], moves_left, looks_left, twins, symmetric)

    def _finish(
        self,
        known: Sequence[Step],
        best: Candidate,
        here: Stand,
        moves_left: int,
        looks_left: int,
        twins: Sequence[Candidate],
        symmetric: bool | None,
    ) -> Decision:
        """At what is taken for the goal: look until the average is steady, make the last small move, or end."""
        R_goal_now, error_rad = average(known, best.R_goal_now)
        angle_rad = float(so3.angle(R_goal_now))
        degrees, looks = f"{np.degrees(angle_rad):.2f} degrees", len(here.images)
        if looks_left > 0 and error_rad > STEADY_RAD and looks < MOST_LOOKS:
            return Decision(f"{degrees} seem left, give or take {np.degrees(error_rad):.2f}: looks again")
        settled = angle_rad <= max(self.tolerance_rad, CLEARLY * error_rad)
        if not settled and moves_left > 0 and looks_left > 0:
            return Decision(f"{looks} looks agree on {degrees}: turns by them", R_goal_now)
        said = f"{degrees} are left, give or take {np.degrees(error_rad):.2f}"
        if not settled:
            said += f"; no more {'moves' if moves_left <= 0 else 'images'} are allowed to turn by them"
        near = settled or angle_rad <= ENOUGH_RAD
        return _end(said, near, _within(angle_rad), best, here, len(twins), symmetric)


def _equal(one: Candidate | None, other: Candidate | None) -> bool:
    """Whether two different orientations that were examined match the goal equally, but for noise."""
    if one is None or other is None or one is other:
        return False
    return one.examined and other.examined and abs(one.log_weight - other.log_weight) < TIE


def _symmetric(
    best: Candidate, twins: Sequence[Candidate], seen: Sequence[Stand]
) -> tuple[bool | None, Float[np.ndarray, "3 3"]]:
    """Whether an arrival and all that match as well are one orientation of a symmetric object: None where that is not
    known yet; then with the turn that helps to tell."""
    known = [is_symmetry(best, twin, seen) for twin in twins]
    for said in (False, None):  # one that is none is enough
        for symmetric, R_elsewhere in known:
            if symmetric is said:
                return symmetric, R_elsewhere
    return True, np.eye(3)


def _end(
    said: str, near: bool, within: float, best: Candidate, here: Stand, twins: int, symmetric: bool | None
) -> Decision:
    """The end, at an arrival: with a claim, if it is near enough, looked like the goal at least once, as far as the
    shape tells, and is likelier right than not. ``twins``: how many other orientations match as well, each of which is
    as likely, unless all are one by symmetry."""
    alike = best.likeness >= LEAST_LIKENESS
    odds = arrival_log_odds(here) if alike else min(arrival_log_odds(here), best.likeness)
    matches = float(1 / (1 + np.exp(-odds))) / (1 if symmetric else 1 + twins)
    sure = matches * within
    said += f"; {min(sure, 0.99):.0%} sure"
    if twins:
        said += (
            "; another orientation matches as well, "
            + {
                True: "and from another side, too: the object looks symmetric",
                False: "but not from another side: only one of them is the goal's",
                None: "and no two other sides were seen to tell whether the object is symmetric",
            }[symmetric]
        )
    if not alike or (matches < LEAST_SURE and not twins):
        said += "; nothing that was tried surely matches the goal, and this is the likeliest"
    if here.looseness_rad:
        said += f"; but the shape tells turns about one axis only to {np.degrees(here.looseness_rad):.1f} degrees"
    claims = near and alike and not here.looseness_rad and sure >= LEAST_SURE
    return Decision(said, None, True, claims, sure)


def _within(left_rad: float) -> float:
    """How likely the rotation that is left is within what a confidence is about, if it was measured to ERR_RAD."""
    return 0.5 * erfc((left_rad - RIGHT_RAD) / ERR_RAD / sqrt(2))


def _hidden(R_step: Float[np.ndarray, "3 3"], known: Sequence[Step]) -> int:
    """How many moves to where this one leads were taken back, as nothing could be seen there."""
    return sum(
        step.undone
        and step.R_step is not None
        and float(so3.angle_difference(R_step @ R_now_then, step.R_step))
        <= min(SAME_RAD, float(so3.angle(step.R_step)) / 2)
        for step, R_now_then in zip(known, rotations_since(known), strict=True)
    )


def _here(found: Sequence[Candidate], stand: Stand) -> Candidate | None:
    """The candidate that the present pose stands for, if an estimate names it from here."""
    if not found or min(nearest(estimate, np.eye(3))[1] for estimate in stand.estimates) > NEAR_RAD:
        return None
    return min(found, key=lambda candidate: candidate.angle_rad)


def _examine(here: Candidate, known: Sequence[Step], moves_left: int) -> Decision:
    """The first look at an arrival: come closer, once, then look again."""
    R_goal_now, _ = average(known, here.R_goal_now)
    angle_rad = float(so3.angle(R_goal_now))
    came = [float(so3.angle(step.R_executed)) for step in known if step.R_executed is not None][-1:]
    degrees = f"{np.degrees(angle_rad):.2f} degrees"
    if angle_rad > FIRST_RAD and moves_left > 0 and (not came or came[0] > NEAR_RAD):
        return Decision(f"near what may be the goal: turns by the {degrees} that are left", R_goal_now)
    return Decision(f"this may be the goal, but for {degrees}: looks again")


def _approach(best: Candidate | None, moves_left: int) -> Decision:
    """A full move to a candidate that is not near."""
    if best is None:
        return Decision("nothing is left to try, and nothing matched the goal", ends=True, confidence=0.0)
    turn = f"{np.degrees(best.angle_rad):.0f} degrees"
    if moves_left <= 0:
        said = f"no orientation was found that surely matches the goal; the likeliest is {turn} from here"
        return Decision(said, ends=True, confidence=0.0)
    if best.guessed:
        return Decision(f"a half turn of what was found: turns by {turn}", best.R_goal_now)
    why = "back to what matched best" if best.visits else f"the likeliest orientation ({best.support:.0%} by one view)"
    return Decision(f"{why}: turns by {turn}", best.R_goal_now)


def _best(found: Sequence[Candidate], here: Candidate | None, reachable: Reachable) -> Candidate:
    """The likeliest candidate. Of examined ones that noise cannot tell apart one near the start, as most turns that are
    asked for are small, or else the present, unless another is a little better. Of others that are about as likely the
    nearest to the start that can be reached."""
    top = found[0]
    tied = [x for x in found if x.examined and top.log_weight - x.log_weight < TIE]
    near = [x for x in tied if x.from_start_rad <= SMALL_RAD]
    if near:
        return min(near, key=lambda candidate: candidate.from_start_rad)
    if top.examined:
        return here if here in tied and top.log_weight - here.log_weight < BETTER else top
    good = [
        x for x in found if top.log_weight - x.log_weight < EQUIVALENT and top.from_views - x.from_views < EQUIVALENT
    ]
    good.sort(key=lambda candidate: candidate.from_start_rad)
    return next((x for x in good if x.angle_rad <= NEAR_RAD or reachable(x.R_goal_now)), good[0])


def _rival(
    best: Candidate, found: Sequence[Candidate], seen: Sequence[Stand], reachable: Reachable
) -> Candidate | None:
    """What should be seen before the best is believed, if it has been examined: what views named, unless it leaves no
    doubt, then half turns of it that no capture contradicts, as sure as it may be."""
    poses = [stand for stand in seen if at(best, stand) and stand.likeness is not None]
    if not poses:
        return None
    afar = [p for k, given in best.named.items() for p in given if not at(best, seen[k])]
    odds = np.mean([arrival_log_odds(stand) for stand in poses])
    sure = odds >= MATCHES or (odds > 0 and max(afar, default=1.0) >= SURE_FROM_AFAR)
    rivals = [
        x
        for x in found
        if not x.visits
        and (x.loss <= (ALIKE if sure else HARDLY_ALIKE) or (x.support >= NAMED and not sure))
        and reachable(x.R_goal_now)
    ]
    return max(rivals, key=lambda x: (x.support >= NAMED, -x.loss, x.support), default=None)
