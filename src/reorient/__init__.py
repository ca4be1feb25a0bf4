"""Turn a never-seen object to match a picture.

>>> from reorient import Camera, DepthImage, load_estimator, orient
"""

from reorient.controller import Algorithm1, Fusing, Limits, OrientResult, Step, load_strategy, orient
from reorient.controller.station import Station
from reorient.errors import ReorientError, StationError
from reorient.estimators import load_estimator
from reorient.estimators.base import Estimator, RotationEstimate
from reorient.imaging import Camera, DepthImage

__version__ = "0.1.0.dev0"
__all__ = [
    "Algorithm1",
    "Camera",
    "DepthImage",
    "Estimator",
    "Fusing",
    "Limits",
    "OrientResult",
    "ReorientError",
    "RotationEstimate",
    "Station",
    "StationError",
    "Step",
    "load_estimator",
    "load_strategy",
    "orient",
]
