"""The position of a loop: moves the object to the place of the goal, before its rotation is estimated and after it.

Before: the middles of the visible parts are brought together, so that the rotation centre is where the goal image has
it. After: several estimates of the whole motion tell where the object is, and it is moved until it is in the goal's
place. Both are translations; the loop between them only rotates.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from reorient import se3
from reorient.controller.base import OrientResult
from reorient.controller.limits import Limits
from reorient.controller.session import Session
from reorient.errors import StationError
from reorient.estimators.base import Estimator, as_estimate
from reorient.imaging import DepthImage, Goal
from reorient.plugins import USER_ERRORS, in_words

COARSE_M = 0.01
"""A smaller distance of the visible parts does not have to be removed before the rotation. Not tuned."""
CAPTURES = 3
"""Images of one estimate of the position. Not tuned."""
MOVES = 3
"""Most moves at the end. Not tuned."""
TOLERANCE_M = 0.0005
"""Smaller distances from the goal's place are not removed. Not tuned."""
LARGEST_ROTATION_RAD = float(np.radians(5))
"""Estimates of a larger remaining rotation do not tell the position at the end."""


class _Declined(StationError):
    """The first move was not confirmed."""


class _TooFar(StationError):
    """A move beyond the limit."""


@dataclass(frozen=True, eq=False)
class Positioning:
    """The moves of one loop. Its methods raise StationError, and whatever station and estimator raise."""

    session: Session
    goal: Goal
    estimator: Estimator
    limits: Limits

    def approach(self) -> Float[np.ndarray, "3"]:
        """Bring the middle of the visible part to the goal's; the executed translation of the object."""
        shift_m = _middle_m(self.goal.image) - _middle_m(self.session.capture())
        distance_m = float(np.linalg.norm(shift_m))
        if distance_m <= COARSE_M:
            return np.zeros(3)
        self._check(distance_m)
        T_step = se3.transform(np.eye(3), shift_m)
        if self.limits.confirm is not None and not self.limits.confirm(T_step):
            raise _Declined(f"the first move of {1000 * distance_m:.0f} mm was not confirmed")
        return np.asarray(self.session.move(T_step)[:3, 3])

    def around(self, run: Callable[[Float[np.ndarray, "3"]], OrientResult]) -> OrientResult:
        """The result of a loop, with the object brought near before it and into place after it, if it converged.

        ``run``: the loop, called with the translation (metres) that was made before it.
        """
        result = OrientResult((), "declined", "")
        try:
            result = run(self.approach())
            return self.finish(result) if result.converged else result
        except KeyboardInterrupt:
            return replace(result, status="interrupted", reason="interrupted by the keyboard")
        except _TooFar as error:
            return replace(result, status="unreachable", reason=str(error))
        except _Declined as error:
            return replace(result, status="declined", reason=str(error))
        except USER_ERRORS as error:  # a driver may raise anything; the record must survive it
            return replace(result, status="station_failed", reason=f"the position failed: {in_words(error)}")

    def finish(self, result: OrientResult) -> OrientResult:
        """Bring an object in the goal's rotation to the goal's place; the result with the distance that is left."""
        left_m = np.inf
        for move in range(MOVES + 1):
            shift_m = self._measured_m()
            before_m, left_m = left_m, float(np.linalg.norm(shift_m))
            if left_m <= TOLERANCE_M or left_m > 0.7 * before_m or move == MOVES:
                break  # there, or as near as it can be measured
            self._check(left_m)
            self.session.move(se3.transform(np.eye(3), shift_m))
        return replace(
            result, reason=f"{result.reason}; {1000 * left_m:.1f} mm from the goal's place", distance_m=left_m
        )

    def _check(self, distance_m: float) -> None:
        if distance_m > self.limits.max_translation_m:
            raise _TooFar(
                f"the goal's place is {distance_m:.3f} m away: expected at most {self.limits.max_translation_m:g} m"
            )

    def _measured_m(self) -> Float[np.ndarray, "3"]:
        """The translation to the goal's place of the middle of the visible part, from several images."""
        shifts = []
        for _ in range(CAPTURES):
            image = self.session.capture()
            estimate = as_estimate(self.estimator.estimate(image, self.goal, None, ()), image, self.goal.image)
            if estimate.angle_rad <= LARGEST_ROTATION_RAD:
                middle_m = _middle_m(image)
                shifts.append(se3.apply(estimate.T_goal_current, middle_m) - middle_m)
        if not shifts:
            raise StationError(
                f"no estimate below {np.degrees(LARGEST_ROTATION_RAD):.0f} deg tells the position of the object"
            )
        return np.asarray(np.median(shifts, axis=0))


def _middle_m(image: DepthImage) -> Float[np.ndarray, "3"]:
    """The middle of the box around the returns, without the outermost 1%."""
    return np.asarray(np.percentile(image.points(), (1, 99), axis=0).mean(axis=0))
