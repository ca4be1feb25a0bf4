"""Guidance for a person who rotates an object by hand before a camera until it matches the goal.

A ``Guide`` takes one image after another, tracks the rotation that remains, and makes a ``GuideState`` of each: what a
view shows and the instruction to the worker. It moves nothing.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import OutOfRange, check_range
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage

GuideStatus = Literal["no_object", "searching", "rotate", "hold", "verifying", "matched"]
"""``no_object``: the camera shows none. ``searching``: the rotation is unknown: at first, and where the object is lost,
hidden or another one. ``rotate``: it is known, and above the tolerance. ``hold``: it is within the tolerance.
``verifying``: an estimate without initial guess checks the match. ``matched``: the check agreed."""

Frames = Iterable[tuple[float, DepthImage | None]]
"""Images with their times in seconds, in order; None where the camera shows no object."""


@dataclass(frozen=True, eq=False)
class GuideState:
    """What is known after one image. Every subscriber of a guide gets it, in the guide's thread."""

    index: int
    """Number of the image, from 0. While one is searched or verified there are two states of it."""
    time_s: float
    """Time of the image."""
    status: GuideStatus
    instruction: str
    """What the worker is to do: "rotate 23 deg to the left, tilt 5 deg towards you"."""
    image: DepthImage | None = None
    """The object now; None for ``no_object``."""
    estimate: RotationEstimate | None = None
    """Motion from the image to the goal; None where it is unknown."""
    held_s: float = 0.0
    """How long the object has been held within the tolerance."""
    part: int = 0
    """Number of the object, from 0: the next one begins where a matched one has been rotated away or removed."""

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


@dataclass(frozen=True, kw_only=True)
class Guidance:
    """Settings of a guide. Raises OutOfRange for values out of range."""

    tolerance_rad: float = float(np.radians(1.0))
    """Largest angle between the object and the goal that is a match."""
    margin_rad: float = float(np.radians(0.3))
    """By how much the tracked angle must be smaller: the typical error of a tracked estimate near the goal."""
    hold_s: float = 0.5
    """How long the object must stay within the tolerance."""
    leave: float = 3.0
    """A matched object that is rotated by so many tolerances has left; the next one begins. Also how far a tracked
    rotation may be from the one before without motion."""
    opposite: bool = False
    """Whether the worker looks towards the camera, and not from it: then left and right are exchanged."""

    def __post_init__(self) -> None:
        check_range(self, "hold_s")
        if not self.margin_rad < self.tolerance_rad <= np.pi:
            raise OutOfRange("tolerance_rad", self.tolerance_rad, f"a number above {self.margin_rad:.3g}, to pi")


@runtime_checkable
class RotationTracker(Protocol):
    """What a guide needs of ``reorient.estimators.tracking.Tracker``."""

    @property
    def searches_next(self) -> bool:
        """Whether the next update takes as long as an estimate without initial guess."""
        ...

    def update(self, image: DepthImage) -> RotationEstimate | None:
        """The estimate of the next image; None where the rotation is unknown."""
        ...

    def confirm(self, image: DepthImage) -> RotationEstimate | None:
        """An estimate of the latest image without initial guess; None unless it is sure and agrees with the tracked."""
        ...


class Guide:
    """Guides one object after another to the goal."""

    def __init__(self, tracker: RotationTracker, settings: Guidance | None = None) -> None:
        self.settings = settings or Guidance()
        self._tracker = tracker
        self._latest: list[tuple[float, Float[np.ndarray, "3 3"]]] = []  # of the time of a hold; noise cancels in them
        self._held_from_s: float | None = None
        self._matched, self._part, self._failed = False, 0, False

    def states(self, frames: Frames) -> Iterator[GuideState]:
        """The states of all frames, as they come."""
        for index, (time_s, image) in enumerate(frames):
            yield from self._states(GuideState(index, time_s, "no_object", "show the object to the camera"), image)

    def _states(self, blank: GuideState, image: DepthImage | None) -> Iterator[GuideState]:
        """One state of an image, or two where an estimate without initial guess takes its time."""
        if image is None:
            yield self._unknown(blank)
            return
        blank = replace(blank, image=image, status="searching", instruction=self._advice())
        if self._tracker.searches_next:
            yield replace(blank, part=self._part)
        estimate = self._tracker.update(image)
        self._failed = estimate is None
        if estimate is None:
            yield self._unknown(replace(blank, instruction=self._advice()))
            return
        state = self._known(replace(blank, estimate=estimate), estimate)
        yield state
        if state.status == "verifying":
            yield self._verified(state, image)

    def _advice(self) -> str:
        """What helps a search: the object still, and, where that did not suffice, another view of it."""
        return "rotate the object to another side" if self._failed else "hold the object still"

    def _unknown(self, state: GuideState) -> GuideState:
        self._release()
        if self._matched:
            self._next_part()
        return replace(state, part=self._part)

    def _known(self, state: GuideState, estimate: RotationEstimate) -> GuideState:
        """The state of a known rotation."""
        if self._matched and estimate.angle_rad > self.settings.leave * self.settings.tolerance_rad:
            self._next_part()
        if self._matched:
            return replace(state, status="matched", instruction="matched", held_s=self._held_s, part=self._part)
        mean_rad = self._hold(state.time_s, estimate.R_goal_current)
        state = replace(state, held_s=self._held_s, part=self._part)
        if self._held_from_s is None:
            words = in_words(estimate.R_goal_current, self.settings.opposite)
            return replace(state, status="rotate", instruction=words)
        steady = self._held_s >= self.settings.hold_s and mean_rad <= self._enough_rad
        return replace(state, status="verifying" if steady else "hold", instruction="hold the object still")

    def _hold(self, time_s: float, R: Float[np.ndarray, "3 3"]) -> float:
        """Hold from where the rotation, or the mean of the latest ones, is small enough until both are above the
        tolerance; returns the mean's angle. Of an object that moved by far the earlier ones do not count."""
        settings = self.settings
        if self._latest and so3.angle_difference(R, self._latest[-1][1]) > settings.leave * settings.tolerance_rad:
            self._latest.clear()
        self._latest = [x for x in (*self._latest, (time_s, R)) if time_s - x[0] <= settings.hold_s]
        mean_rad = self._mean_rad()
        angle_rad = min(mean_rad, float(so3.angle(R)))
        if angle_rad > (self._enough_rad if self._held_from_s is None else settings.tolerance_rad):
            self._held_from_s = None
        elif self._held_from_s is None:
            self._held_from_s = time_s
        return mean_rad

    def _mean_rad(self, *others: Float[np.ndarray, "3 3"]) -> float:
        """The angle between no rotation and the mean of the latest ones, or of that mean and others."""
        mean = so3.mean(np.stack([R for _, R in self._latest]))
        return float(so3.angle(so3.mean(np.stack([mean, *others]))))

    def _release(self) -> None:
        self._latest.clear()
        self._held_from_s = None

    @property
    def _enough_rad(self) -> float:
        return self.settings.tolerance_rad - self.settings.margin_rad

    @property
    def _held_s(self) -> float:
        return 0.0 if self._held_from_s is None else self._latest[-1][0] - self._held_from_s

    def _verified(self, state: GuideState, image: DepthImage) -> GuideState:
        """The state after the check of a match."""
        estimate = self._tracker.confirm(image)
        if estimate is None or self._mean_rad(estimate.R_goal_current) > self.settings.tolerance_rad:
            self._release()
            return replace(state, status="hold", held_s=0.0)
        self._matched = True
        return replace(state, status="matched", instruction="matched", estimate=estimate)

    def _next_part(self) -> None:
        self._matched, self._part = False, self._part + 1
        self._release()


_WORDS = (
    ("tilt", "towards you", "away from you"),  # about x, right: the top comes nearer
    ("rotate", "to the left", "to the right"),  # about y, down: the near side moves left
    ("roll", "clockwise", "counterclockwise"),  # about z, forward
)
_SMALL = 0.15  # a component below this share of the largest is left out


def in_words(R_goal_current: Float[np.ndarray, "3 3"], opposite: bool = False) -> str:
    """The rotation for a worker who looks from the camera, or towards it (``opposite``); the largest component first.

    The components are those of the rotation vector. *Rotate* is about the vertical of the image: to the left, the near
    side moves left. *Tilt* is about its horizontal: towards you, the top comes nearer. *Roll* is in the image.
    """
    rotvec_deg = np.degrees(so3.log(R_goal_current)) * (np.array([-1, 1, -1]) if opposite else 1)
    order = np.argsort(-np.abs(rotvec_deg), kind="stable")
    shown = [k for k in order if abs(rotvec_deg[k]) >= _SMALL * abs(rotvec_deg[order[0]])]
    parts = []
    for k in shown:
        verb, positive, negative = _WORDS[k]
        size_deg = abs(rotvec_deg[k])
        number = f"{size_deg:.0f}" if size_deg >= 9.5 else f"{size_deg:.1f}"
        parts.append(f"{verb} {number} deg {positive if rotvec_deg[k] > 0 else negative}")
    return ", ".join(parts)
