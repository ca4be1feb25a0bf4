"""Rotate an object that nobody has modelled until it matches a goal image.

>>> from reorient import Camera, DepthImage, load_estimator, orient

A name is imported when it is first used, so that ``import reorient`` is fast.
"""

from typing import TYPE_CHECKING

from reorient.extras import imported_on_use

if TYPE_CHECKING:
    from reorient.controller import Algorithm1, Fusing, Limits, OrientResult, Step, load_strategy, orient
    from reorient.controller.station import Station
    from reorient.errors import ReorientError, StationError
    from reorient.estimators import load_estimator
    from reorient.estimators.base import Estimator, RotationEstimate
    from reorient.imaging import Camera, DepthImage, Goal, GoalView, Isolation, isolate
    from reorient.imaging.files import read_camera, read_depth
    from reorient.imaging.goal_files import read_goal, write_goal
    from reorient.perception.robot_calibration import (
        RobotCalibration,
        read_robot_calibration,
        write_robot_calibration,
    )
    from reorient.perception.transfer import Transferred, transfer
    from reorient.stations.calibrating import calibrate
    from reorient.stations.guarded import RobotLimits
    from reorient.stations.robot import RobotStation

__version__ = "0.2.0"
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
    "read_robot_calibration",
    "transfer",
    "write_goal",
    "write_robot_calibration",
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
    "perception.robot_calibration": ("RobotCalibration", "read_robot_calibration", "write_robot_calibration"),
    "perception.transfer": ("Transferred", "transfer"),
    "stations.calibrating": ("calibrate",),
    "stations.guarded": ("RobotLimits",),
    "stations.robot": ("RobotStation",),
}
if not TYPE_CHECKING:  # a type checker shall see the names above and no others
    __getattr__ = imported_on_use("reorient", _MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
