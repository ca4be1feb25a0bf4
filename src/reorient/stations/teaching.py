"""Teaching a goal: the held object is rotated away from the goal pose and back, and captured from several sides."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.arrival import aligned
from reorient.controller.limits import Limits
from reorient.controller.session import Session, StationHangs
from reorient.controller.station import Station, pivot_of
from reorient.errors import ReorientError, StationError, check_counts
from reorient.estimators.base import check_pair
from reorient.imaging import DepthImage, Goal, GoalView
from reorient.imaging.averaging import mean_image
from reorient.imaging.viewpoints import spread_rotations
from reorient.plugins import USER_ERRORS, in_words
from reorient.registration.aligning import aligned_goal

VIEWS = 5
"""Further views: with the primary one they look along six directions, where the arm reaches them."""
CAPTURES = 5
"""Images that one view is the mean of. Loops with a mean of five end at 0.11 degrees, with one image at 0.16."""
_FEWEST_RETURNS = 100  # of a view of the object
_BACK_RAD = float(np.radians(1.0))  # from the goal pose after the last move, by the images, without a warning


@dataclass(frozen=True, eq=False)
class Taught:
    """A goal as it was taught."""

    goal: Goal
    """Its views aligned to each other."""
    warnings: tuple[str, ...]
    """What was left out or looks wrong, a sentence each."""
    provenance: dict[str, Any]
    """How each view was made, for ``write_goal``."""


def teach(
    station: Station,
    views: int = VIEWS,
    captures: int = CAPTURES,
    limits: Limits | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> Taught:
    """Capture the goal in the present pose, and further views of the object rotated away from it.

    The rotations spread over all sides as far as the station's ``reachable`` allows. The object is returned to the goal
    pose, also after an error and a KeyboardInterrupt; not after one during a move, as the station is stopped then.
    ``limits``: as of ``orient``. ``report``: called with each step in words.

    Raises ReorientError where the goal pose cannot be captured, where the limits do not allow the rotations, where the
    first move is not confirmed, and where the object cannot be returned.
    """
    return _Teaching(station, captures, limits or Limits(), report).run(views)


@dataclass(eq=False)
class _Teaching:
    station: Station
    captures: int
    limits: Limits
    report: Callable[[str], None]
    warnings: list[str] = field(default_factory=list)
    R_now_goal: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    lost: bool = False
    """Whether a move was interrupted: nothing is commanded any more."""
    refused: bool = False
    """Whether a move failed, so that its rotation is unknown."""

    def __post_init__(self) -> None:
        check_counts(self, "captures")
        self.session = Session(self.station, self.limits)

    def run(self, count: int) -> Taught:
        """Capture all views, return, align."""
        pivot_m = pivot_of(self.station)
        try:
            primary = self.capture()
            check_pair(primary, primary, pivot_m)
            targets = self.targets(count) if count else []
            views = self.tour(targets, primary)
        finally:
            self.session.close()
        goal, problems = aligned_goal(Goal(primary, tuple(views)), pivot_m)
        return Taught(goal, (*self.warnings, *problems), self.provenance(views, goal))

    def targets(self, count: int) -> list[Float[np.ndarray, "3 3"]]:
        """R_view_goal of the further views, in order. Raises ReorientError where the limits do not allow them."""
        targets = spread_rotations(count, self.session.reachable)
        if len(targets) < count:
            self.warnings.append(f"{len(targets)} of {count} further views are reachable from here")
        if self.limits.dry_run:
            angles = ", ".join(f"{np.degrees(so3.angle(R)):.0f}" for R in targets)
            self.report(f"dry run: would rotate to {angles} deg from the goal and back; nothing moved")
            return []
        poses = [np.eye(3), *targets, np.eye(3)]
        total_rad = sum(float(so3.angle_difference(a, b)) for a, b in pairwise(poses))
        if total_rad > self.limits.max_rotation_rad:
            raise ReorientError(
                f"{len(targets)} further views take {np.degrees(total_rad):.0f} deg of rotation, the limit is "
                f"{np.degrees(self.limits.max_rotation_rad):.0f}: expected fewer views, or a higher limit"
            )
        if targets and self.limits.confirm is not None and not self.limits.confirm(targets[0]):
            raise ReorientError("the first move was not confirmed: nothing moved")
        return targets

    def tour(self, targets: Sequence[Float[np.ndarray, "3 3"]], primary: DepthImage) -> list[GoalView]:
        """The views of all targets that can be reached and captured; the object ends in the goal pose."""
        views = []
        try:
            for number, target in enumerate(targets, 1):
                self.report(f"view {number} of {len(targets)}: {np.degrees(so3.angle(target)):.0f} deg from the goal")
                view = self.view(number, target)
                views += [] if view is None else [view]
        finally:
            if targets:
                self.home(primary)
        return views

    def view(self, number: int, target: Float[np.ndarray, "3 3"]) -> GoalView | None:
        """One view; None where it cannot be reached or captured, with a warning."""
        try:
            if not self.session.reachable(target @ self.R_now_goal.T):
                self.rotate(self.R_now_goal.T)
            self.rotate(target @ self.R_now_goal.T)
            image = self.capture()
            if np.count_nonzero(image.valid) < _FEWEST_RETURNS:
                raise ReorientError(f"fewer than {_FEWEST_RETURNS} returns")
            check_pair(image, image)
        except StationHangs:
            raise
        except USER_ERRORS as error:  # of the station, or of its isolation
            if self.refused:
                raise
            self.warnings.append(f"view {number} is left out: {in_words(error)}")
            return None
        return GoalView(image, self.R_now_goal.T)

    def capture(self) -> DepthImage:
        """The mean of several captures."""
        return mean_image([self.session.capture() for _ in range(self.captures)])

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> None:
        """Rotate in parts within the limits, and keep the account of where the object is."""
        for part in self.limits.parts(R_step):
            try:
                self.R_now_goal = self.session.rotate(part) @ self.R_now_goal
            except (KeyboardInterrupt, StationHangs):
                self.lost = True
                raise
            except USER_ERRORS:
                self.refused = True
                raise

    def home(self, primary: DepthImage) -> None:
        """Return to the goal pose, and compare with the primary view. Raises StationError where that fails."""
        angle = f"{np.degrees(so3.angle(self.R_now_goal)):.0f} deg"
        if self.lost:
            self.report(f"the object was not returned: it is about {angle} from the goal pose")
            return
        try:
            if float(so3.angle(self.R_now_goal)) > 0:
                self.rotate(self.R_now_goal.T)
            back_rad = float(so3.angle(aligned(self.session.capture(), primary)[0]))
        except USER_ERRORS as error:
            raise StationError(
                f"the object was not returned, it is about {angle} from the goal pose: {in_words(error)}"
            ) from error
        self.report(f"returned: {np.degrees(back_rad):.2f} deg from the goal pose, by the images")
        if back_rad > _BACK_RAD:
            self.warnings.append(
                f"the object is {np.degrees(back_rad):.1f} deg from the goal pose after it was returned: it slipped in "
                "the gripper, or the rotations of the station are wrong"
            )

    def provenance(self, views: Sequence[GoalView], goal: Goal) -> dict[str, Any]:
        """How each view was made; the views that aligning left out have no correction."""
        kept = {id(view.image): view for view in goal.views}
        made = []
        for view in views:
            now = kept.get(id(view.image))
            away_deg = (
                None if now is None else float(np.degrees(so3.angle_difference(now.R_goal_view, view.R_goal_view)))
            )
            made.append({"R_goal_view_stated": view.R_goal_view.tolist(), "aligned_by_deg": away_deg})
        return {"made": "capture", "captures_per_view": self.captures, "further_views": made}
