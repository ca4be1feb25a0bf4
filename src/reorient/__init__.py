"""Rotate an object that nobody has modelled until it matches a goal image.

>>> from reorient import Camera, DepthImage, load_estimator, orient

A name is imported when it is first used, so that ``import reorient`` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reorient.controller import Algorithm1, Fusing, Limits, OrientResult, Step, load_strategy, orient
    from reorient.controller.station import Station
    from reorient.errors import ReorientError, StationError
    from reorient.estimators import load_estimator
    from reorient.estimators.base import Estimator, RotationEstimate
    from reorient.imaging import Camera, DepthImage, Goal, GoalView, Isolation, isolate
    from reorient.imaging.files import read_camera, read_depth
    from reorient.imaging.goal_files import read_goal, write_goal
    from reorient.perception.robot_calibration import RobotCalibration
    from reorient.perception.transfer import Transferred, transfer
    from reorient.stations.calibrating import calibrate
    from reorient.stations.guarded import RobotLimits
    from reorient.stations.robot import RobotStation

__version__ = "0.1.0.dev0"
__all__ = [
    "Algorithm1",
    "Camera",
    "DepthImage",
    "Estimator",
    "Fusing",
    "Goal",
    "GoalView",
    "Isolation",
    "Limits",
    "OrientResult",
    "ReorientError",
    "RobotCalibration",
    "RobotLimits",
    "RobotStation",
    "RotationEstimate",
    "Station",
    "StationError",
    "Step",
    "Transferred",
    "calibrate",
    "isolate",
    "load_estimator",
    "load_strategy",
    "orient",
    "read_camera",
    "read_depth",
    "read_goal",
    "transfer",
    "write_goal",
]
_MODULES = {
    "controller": ("Algorithm1", "Fusing", "Limits", "OrientResult", "Step", "load_strategy", "orient"),
    "controller.station": ("Station",),
    "errors": ("ReorientError", "StationError"),
    "estimators": ("load_estimator",),
    "estimators.base": ("Estimator", "RotationEstimate"),
    "imaging": ("Camera", "DepthImage", "Goal", "GoalView", "Isolation", "isolate"),
    "imaging.files": ("read_camera", "read_depth"),
    "imaging.goal_files": ("read_goal", "write_goal"),
    "perception.robot_calibration": ("RobotCalibration",),
    "perception.transfer": ("Transferred", "transfer"),
    "stations.calibrating": ("calibrate",),
    "stations.guarded": ("RobotLimits",),
    "stations.robot": ("RobotStation",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'reorient' has no attribute {name!r}")
    value = getattr(import_module(f"reorient.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
