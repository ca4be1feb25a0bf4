"""``robot.toml``: which camera and arm, their calibration, the isolation of the object, and the limits of the arm."""

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient.errors import ReorientError, in_short, reason_of, unknown_name
from reorient.imaging import Isolation
from reorient.perception.robot_calibration import RobotCalibration, read_robot_calibration
from reorient.stations.drivers import ARMS, CAMERAS, CameraDriver, make_arm, make_camera
from reorient.stations.guarded import GuardedArm, RobotLimits
from reorient.stations.robot import RobotStation

_TABLES = ("camera", "arm", "tool", "isolation", "limits")
_SEEDED = "simulated"  # a driver that works everywhere, for trying the file

TEMPLATE = f"""# A robot cell: a fixed depth camera that sees the object in the arm's gripper. Lengths in metres.
#     reorient calibrate robot.toml      rotates the held object by 35 degrees about 8 axes: camera pose and pivot
#     reorient check robot.toml          small motions; names a mistake in words
#     reorient orient goal.npz --station robot.toml

calibration = "calibration.json"    # written by `reorient calibrate`, beside this file

[camera]
driver = "{_SEEDED}"                # one of {", ".join(CAMERAS)}, or my_module:MyCamera
# serial = "123456789"              # further keys are settings of the driver: docs/drivers.md

[arm]
driver = "{_SEEDED}"                # one of {", ".join(ARMS)}, or my_module:MyArm
# address = "192.168.0.10"

[tool]
point_m = [0.0, 0.0, 0.0]           # about where the object is held, in tool axes: `calibrate` rotates about it

[isolation]                         # what of the frame is the object; fields of reorient.Isolation
radius_m = 0.2                      # a sphere around the held object; it follows the arm once calibrated
around_m = [0.0, 0.0, 0.62]         # its centre before that, camera axes (x right, y down, z forward)
# near_m = 0.3
# far_m = 0.9
# remove_plane = true               # a table behind the object
# allow_touching = true             # the arm continues beyond the sphere

[limits]
# box_low_m = [0.2, -0.4, 0.1]      # workspace: the tool and the object stay inside, base axes
# box_high_m = [0.7, 0.4, 0.8]
max_step_deg = 30.0                 # larger rotations are made in parts
settle_s = 0.15                     # pause between the end of a move and the next frame
"""


@dataclass(frozen=True, eq=False)
class RobotFile:
    """The contents of a ``robot.toml``. Devices are opened by its methods."""

    path: Path
    camera: Mapping[str, Any]
    """Name of the driver and its settings."""
    arm: Mapping[str, Any]
    """Name of the driver and its settings."""
    calibration: Path
    """File of the calibration."""
    point_m: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Where the object is held, roughly, in tool axes."""
    isolation: Isolation | None = None
    """None: the camera's frames show the object alone."""
    limits: RobotLimits = field(default_factory=RobotLimits)

    def open_camera(self) -> CameraDriver:
        """The camera's driver. Raises ReorientError as of ``make_camera``."""
        return make_camera(*_driver(self.camera))

    def open_arm(self, p_tool_object_m: Float[np.ndarray, "3"] | None = None) -> GuardedArm:
        """The arm's driver within the limits; ``p_tool_object_m`` None: ``point_m``. Errors as of ``make_arm``."""
        held_m = self.point_m if p_tool_object_m is None else p_tool_object_m
        return GuardedArm(make_arm(*_driver(self.arm)), self.limits, held_m)

    def read_calibration(self) -> RobotCalibration:
        """The calibration. Raises ReorientError where there is none yet."""
        if not os.path.isfile(self.calibration):
            raise ReorientError(
                f"no calibration {str(self.calibration)!r}: expected `reorient calibrate {self.path.name}` first"
            )
        return read_robot_calibration(self.calibration)

    def open_station(self) -> RobotStation:
        """The whole station. Raises ReorientError where a part of it cannot be opened."""
        calibration = self.read_calibration()
        return RobotStation(self.open_camera(), self.open_arm(calibration.p_tool_object_m), calibration, self.isolation)


def read_robot_file(path: str | Path) -> RobotFile:
    """Read a ``robot.toml``. Raises ReorientError, naming the table and the key that is missing, unknown or wrong."""
    path = Path(path)
    if not os.path.isfile(path):
        raise ReorientError(f"no file {str(path)!r}: expected one that `reorient new-robot` wrote")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ReorientError(
            f"{str(path)!r} is not TOML ({reason_of(error)}): expected a file as of `reorient new-robot`"
        ) from error
    _refuse_unknown(data, [*_TABLES, "calibration"], str(path))
    tables = {name: _table(data, name, path) for name in _TABLES}
    for name in ("camera", "arm"):
        if not isinstance(tables[name].get("driver"), str):
            raise ReorientError(f"{str(path)!r} has no driver in [{name}]: expected a name or my_module:MyClass")
    _refuse_unknown(tables["tool"], ["point_m"], f"[tool] of {str(path)!r}")
    calibration = data.get("calibration", "calibration.json")
    if not isinstance(calibration, str):
        raise ReorientError(f"calibration = {in_short(calibration)} in {str(path)!r}: expected the name of a file")
    return RobotFile(
        path,
        tables["camera"],
        tables["arm"],
        path.parent / calibration,
        _vector(tables["tool"].get("point_m", [0.0, 0.0, 0.0]), path),
        _made(Isolation, tables["isolation"], "isolation", path) if tables["isolation"] else None,
        _made(RobotLimits, tables["limits"], "limits", path),
    )


def _driver(table: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    return str(table["driver"]), {key: value for key, value in table.items() if key != "driver"}


def _table(data: Mapping[str, Any], name: str, path: Path) -> Mapping[str, Any]:
    table = data.get(name, {})
    if not isinstance(table, dict):
        raise ReorientError(f"{name} = {in_short(table)} in {str(path)!r}: expected a table [{name}]")
    return table


def _vector(value: object, path: Path) -> Float[np.ndarray, "3"]:
    try:
        vector_m = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        vector_m = np.empty(0)
    if vector_m.shape != (3,) or not np.all(np.isfinite(vector_m)):
        raise ReorientError(f"point_m = {in_short(value)} in {str(path)!r}: expected three finite metres")
    return vector_m


def _made(kind: type[Any], table: Mapping[str, Any], name: str, path: Path) -> Any:
    """A settings object of a table. Raises ReorientError for an unknown key and a value out of range."""
    source = f"[{name}] of {str(path)!r}"
    _refuse_unknown(table, [each.name for each in fields(kind)], source)
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    if isinstance(values.get("background"), str):
        values["background"] = path.parent / values["background"]
        if not values["background"].is_file():
            raise ReorientError(
                f"{source}: no file {str(values['background'])!r}: expected the frame without the object"
            )
    if "radius_m" in values and "around_m" not in values:
        raise ReorientError(
            f"{source} has a radius_m without around_m: expected the object's rough place in camera axes, metres, with "
            "it (it follows the arm once calibrated)"
        )
    try:
        return kind(**values)
    except (ValueError, TypeError, OverflowError) as error:
        raise ReorientError(f"{source}: {reason_of(error)}") from error


def _refuse_unknown(table: Mapping[str, Any], known: list[str], source: str) -> None:
    for key in table:
        if key not in known:
            raise unknown_name(f"key in {source}:", key, known)
