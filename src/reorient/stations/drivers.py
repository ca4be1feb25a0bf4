"""Drivers of cameras and arms: their protocols, and the table of names by which ``robot.toml`` selects them.

A driver is a class that is made from keyword settings (``address`` and the like). It lives in ``stations/cameras`` or
``stations/arms``, or is a class of your own, ``my_module:MyCamera``. The module of a driver, and with it the vendor's
library, is imported when the driver is made.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, cast, runtime_checkable

from reorient.controller.station import missing_members
from reorient.errors import ReorientError, unknown_name
from reorient.extras import extras_named
from reorient.imaging import DepthImage
from reorient.plugins import USER_ERRORS, import_own, in_words
from reorient.se3 import Transform


@runtime_checkable
class CameraDriver(Protocol):
    """A depth camera that does not move.

    A further method is optional: ``clock_s() -> float``, the clock of the frames' stamps; without it the clock is
    inferred from the frames.
    """

    def capture(self) -> DepthImage:
        """The next whole frame, with its stamp in seconds. Raises StationError, or any exception, where there is none.

        The camera of the image is that of the frame: rectified, pixel centres at +0.5.
        """
        ...


@runtime_checkable
class ArmDriver(Protocol):
    """A robot arm whose tool holds the object.

    A further method is optional: ``reachable(T_base_tool) -> bool``, whether ``move_to`` could get there.
    """

    def pose(self) -> Transform:
        """The measured pose of the tool: T_base_tool, metres."""
        ...

    def move_to(self, T_base_tool: Transform) -> Transform:
        """Move the tool in a straight line to a pose, wait for the end, and return the measured pose there.

        Raises StationError, or any exception, where the arm stopped before, or did not arrive in time.
        """
        ...

    def stop(self) -> None:
        """Stop the arm where it is."""
        ...


def check_drivers(camera: object, arm: object) -> None:
    """Raise ReorientError for a driver that lacks a method, and for a class in place of an object."""
    for name, driver, members in (
        ("camera", camera, ("capture",)),
        ("arm", arm, ("pose", "move_to", "stop")),
    ):
        if isinstance(driver, type):
            raise ReorientError(f"{name} is the class {driver.__name__}: expected an object, {driver.__name__}()")
        if missing := missing_members(driver, members):
            raise ReorientError(f"{name} {driver!r} has no {', '.join(missing)}: expected {', '.join(members)}")


@dataclass(frozen=True)
class Driver:
    """Where a driver is found."""

    module: str
    """Within ``reorient.stations``."""
    name: str
    """Of the class."""


CAMERAS = {
    "folder": Driver("cameras.folder", "FolderCamera"),
    "realsense": Driver("cameras.realsense", "RealSenseCamera"),
    "ros2": Driver("cameras.ros2", "Ros2Camera"),
    "simulated": Driver("simulated", "SimulatedCamera"),
}
ARMS = {
    "abb": Driver("arms.abb", "AbbArm"),
    "franka": Driver("arms.franka", "FrankaArm"),
    "ros2": Driver("arms.ros2", "Ros2Arm"),
    "simulated": Driver("simulated", "SimulatedArm"),
    "ur": Driver("arms.ur", "UrArm"),
}


def make_camera(name: str, settings: Mapping[str, Any]) -> CameraDriver:
    """The camera driver of a name, or of ``my_module:MyCamera``, made with keyword settings.

    Raises ReorientError for an unknown name or setting, a missing extra, and a class that lacks ``capture``.
    """
    return cast(CameraDriver, _made("camera", name, settings, CAMERAS, ("capture",)))


def make_arm(name: str, settings: Mapping[str, Any]) -> ArmDriver:
    """The arm driver of a name, or of ``my_module:MyArm``. Errors as of ``make_camera``."""
    return cast(ArmDriver, _made("arm", name, settings, ARMS, ("pose", "move_to", "stop")))


def _made(
    kind: str, name: str, settings: Mapping[str, Any], known: Mapping[str, Driver], members: tuple[str, ...]
) -> object:
    if ":" in name:
        driver: Any = import_own(f"{kind} driver", name)
    elif name in known:
        driver = _imported(known[name])
    else:
        raise unknown_name(f"{kind} driver", name, [*known, f"my_module:My{kind.title()}"])
    _check_settings(kind, name, driver, settings)
    try:
        made: object = driver(**settings)
    except ReorientError:
        raise
    except USER_ERRORS as error:  # the vendor's library may raise anything
        raise ReorientError(f"cannot open {kind} {name!r}: {in_words(error)}") from error
    if missing := missing_members(made, members):
        raise ReorientError(f"{kind} driver {name!r} has no {', '.join(missing)}: expected {', '.join(members)}")
    return made


def _imported(driver: Driver) -> Any:
    with extras_named():
        return getattr(import_module(f"reorient.stations.{driver.module}"), driver.name)


def _check_settings(kind: str, name: str, driver: Any, settings: Mapping[str, Any]) -> None:
    """Raise ReorientError for settings that the class does not take, or lacks."""
    parameters = inspect.signature(driver).parameters.values()
    if any(each.kind is each.VAR_KEYWORD for each in parameters):
        return
    known = [each.name for each in parameters if each.kind is not each.VAR_POSITIONAL]
    for setting in settings:
        if setting not in known:
            raise unknown_name(f"setting of {kind} driver {name!r}:", setting, known)
    required = [each.name for each in parameters if each.default is each.empty and each.name in known]
    if lacking := [each for each in required if each not in settings]:
        raise ReorientError(f"{kind} driver {name!r} lacks {', '.join(lacking)}: expected in [{kind}] of robot.toml")
