"""A station during one loop: results are checked, frames are newer than the last move, moves keep to the limits, and
every call ends in time."""

from collections.abc import Callable
from queue import Empty, Queue
from threading import TIMEOUT_MAX, Thread
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller.limits import Limits
from reorient.controller.station import Station, captured, clock_of, executed, moved
from reorient.errors import StationError
from reorient.imaging import DepthImage
from reorient.plugins import USER_ERRORS, in_words
from reorient.se3 import Transform

T = TypeVar("T")

STOP_S = 5.0
"""Longest time of the station's ``stop``."""


class StationHangs(StationError):
    """A call of the station did not end in time; no further call is made."""


class Session:
    """A station as the loop uses it. Its methods raise whatever the station raises."""

    def __init__(self, station: Station, limits: Limits) -> None:
        self._station, self._limits = station, limits
        self._call = _Calls(limits.timeout_s)
        self.rotated_rad = 0.0
        """Sum of the angles of all moves."""
        self._last_stamp_s = -np.inf
        """Stamp of the last accepted frame."""
        self._stale_before_s = -np.inf
        """A frame with an earlier stamp shows the object before its last move."""

    def capture(self) -> DepthImage:
        """The next image. Raises StationError for a frame that shows the object before its last move."""
        image = captured(self._call(self._station.capture))
        if image.stamp_s is None:
            return image
        if image.stamp_s < self._stale_before_s:
            raise StationError(
                f"stale frame: captured at {image.stamp_s:.3f} s, before the last move ended "
                f"({self._stale_before_s:.3f} s)"
            )
        self._last_stamp_s = image.stamp_s
        return image

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Rotate in parts within the largest step; returns the executed rotation."""
        R_done: Float[np.ndarray, "3 3"] = np.eye(3)
        for part in self._limits.parts(R_step):
            R_done = self._rotate(part) @ R_done
        return R_done

    def move(self, T_step: Transform) -> Transform:
        """Move the object (camera axes, metres), without parts; returns the executed motion."""
        return self._moved(lambda: moved(self._call(self._station.move, T_step)))  # type: ignore[attr-defined]

    def _rotate(self, part: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        angle_rad = float(so3.angle(part))  # it may have been made before an error
        try:
            done = self._moved(lambda: executed(self._call(self._station.rotate, part)))
            angle_rad = float(so3.angle(done))
        finally:
            self.rotated_rad += angle_rad
        return done

    def _moved(self, move: Callable[[], T]) -> T:
        """The result of a move; after it, or its error, the frames up to now are stale."""
        try:
            return move()
        except (KeyboardInterrupt, StationHangs):
            self._stop()
            raise
        finally:  # by the station's clock, or else those not newer than the last one
            clock_s = None if self._call.ended else self._call(clock_of, self._station)
            self._stale_before_s = float(np.nextafter(self._last_stamp_s, np.inf)) if clock_s is None else clock_s

    def reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """Whether the station can make a move, if it knows. The question is about the whole move, though the limits may
        have it made in parts."""
        ask = getattr(self._station, "reachable", None)
        if ask is None:
            return True
        try:
            return bool(self._call(ask, R_step))
        except USER_ERRORS:  # such a station gets the move, and may refuse it
            return True

    def _stop(self) -> None:
        """Stop the robot, if the station can; the call that moves it may not have ended yet."""
        stop = getattr(self._station, "stop", None)
        if stop is not None:
            try:
                _Calls(STOP_S)(stop)
            except USER_ERRORS as error:
                in_words(error)  # logs it; the interruption is what the loop reports

    def close(self) -> None:
        """No call follows."""
        self._call.close()


class _Calls:
    """Calls that must end in time, in one thread of their own; without a limit, in the thread of the caller."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._tasks: Queue[tuple[Callable[[], Any], Queue[tuple[Any, BaseException | None]]] | None] = Queue()
        self._begun = False
        self.ended = False
        """Whether a call did not end: none may follow."""

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """The result of a call. Raises StationHangs where it does not end in time, and what the function raises."""
        if self._timeout_s == np.inf:
            return function(*arguments)
        if self.ended:
            raise StationHangs("the station did not end an earlier call")
        if not self._begun:
            self._begun = True
            Thread(target=self._work, daemon=True).start()
        outcome: Queue[tuple[Any, BaseException | None]] = Queue()
        self._tasks.put((lambda: function(*arguments), outcome))
        self.ended = True  # until the call has ended: an interruption leaves it running
        try:
            result, error = outcome.get(timeout=min(self._timeout_s, TIMEOUT_MAX))
        except Empty:
            raise StationHangs(f"no answer within {self._timeout_s:g} s") from None
        self.ended = False
        if error is not None:
            raise error
        return result

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None:
            call, outcome = task
            try:
                outcome.put((call(), None))
            except BaseException as error:  # for the caller
                outcome.put((None, error))

    def close(self) -> None:
        """End the thread."""
        self._tasks.put(None)
