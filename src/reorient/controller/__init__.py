"""Algorithm 1 and its successor, in one loop."""

from reorient.controller.algorithm1 import Proportional
from reorient.controller.base import Decision, OrientResult, Step, Strategy
from reorient.controller.fusing import Fusing
from reorient.controller.limits import Limits
from reorient.controller.loop import orient

__all__ = ["Decision", "Fusing", "Limits", "OrientResult", "Proportional", "Step", "Strategy", "orient"]
