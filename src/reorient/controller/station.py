"""The station protocol: a camera that captures the object and a gripper that rotates it."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import ProtocolError, ReorientError, StationError
from reorient.imaging import DepthImage
from reorient.plugins import USER_ERRORS, in_words
from reorient.se3 import Transform


@runtime_checkable
class Station(Protocol):
    """A robot cell, real or simulated. Its methods raise StationError, or the driver's own exceptions.

    Four further methods are optional. ``reachable(R_step) -> bool``: whether ``rotate`` could execute it.
    ``move(T_step) -> T_executed``: move the object, T_after = T_step @ T_before, (4, 4), camera axes, metres; needed by
    ``orient(translation=True)``, which moves it without rotation; returns the executed motion.
    ``clock_s() -> float``: the clock of the frames' stamps, by which a frame from before the end of the last move is
    refused; without it only frames that are not newer than the last one before the move are. ``stop()``: stops the
    robot; called, from another thread, after a move that was interrupted or did not end in time.
    """

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"] | None:
        """The rotation centre of the gripper, camera axes, good to about 1 cm; None if unknown."""
        ...

    def capture(self) -> DepthImage:
        """The present depth image of the isolated object."""
        ...

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """Rotate the object: R_after = R_step @ R_before, camera axes. Returns the executed rotation."""
        ...


class Forwarding:
    """A station that is another one; a subclass changes some of its members.

    Those of the protocol are here, as ``isinstance`` does not see the ones of ``__getattr__`` from Python 3.12 on.
    """

    def __init__(self, station: Station) -> None:
        self._station = station

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"] | None:
        """The station's pivot."""
        return self._station.pivot_m

    def capture(self) -> DepthImage:
        """The station's image."""
        return self._station.capture()

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The station's rotation."""
        return self._station.rotate(R_step)

    def __getattr__(self, name: str) -> Any:
        """Optional members of the station."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._station, name)


def missing_members(thing: object, members: Sequence[str]) -> list[str]:
    """The members that an object does not have; one that raises when it is read counts as present."""

    def present(member: str) -> bool:
        try:
            return hasattr(thing, member)
        except USER_ERRORS:
            return True

    return [member for member in members if not present(member)]


def pivot_of(station: Station) -> Float[np.ndarray, "3"] | None:
    """The station's pivot. Raises StationError where reading it fails."""
    try:
        return station.pivot_m
    except ReorientError:
        raise
    except USER_ERRORS as error:
        raise StationError(f"cannot read the station's pivot_m: {in_words(error)}") from error


def clock_of(station: object) -> float | None:
    """The clock of a station or a camera now, in seconds; None where it has none, or one that fails."""
    try:
        clock_s = float(station.clock_s())  # type: ignore[attr-defined]
    except USER_ERRORS:
        return None
    return clock_s if np.isfinite(clock_s) else None


def captured(image: object) -> DepthImage:
    """The result of ``capture``. Raises ProtocolError where it is no image."""
    if not isinstance(image, DepthImage):
        raise ProtocolError(f"capture() returned a {type(image).__name__}: expected DepthImage(depth_m, camera)")
    return image


def rigid(T_step: object) -> Transform:
    """The argument of ``move``. Raises StationError where it is no rigid transform."""
    try:
        return moved(T_step)
    except ProtocolError as error:
        raise StationError("refused to move: expected a rigid (4, 4) transform") from error


def moved(T: object) -> Transform:
    """The result of ``move``. Raises ProtocolError where it is no rigid transform."""
    motion = np.asarray(T, float) if T is not None else np.empty(0)
    if motion.shape != (4, 4) or not so3.is_rotation(motion[:3, :3]) or not np.all(np.isfinite(motion[:3, 3])):
        raise ProtocolError("move() returned no motion: expected the rigid (4, 4) transform of the executed motion")
    return motion


def executed(R: object) -> Float[np.ndarray, "3 3"]:
    """The result of ``rotate``. Raises ProtocolError where it is no rotation."""
    if not so3.is_rotation(np.asarray(R, float) if R is not None else np.empty(0)):
        raise ProtocolError("rotate() returned no rotation: expected the (3, 3) matrix of the executed motion")
    return np.asarray(R, float)
