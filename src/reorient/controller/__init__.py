"""Algorithm 1 and its successor, in one loop."""

from reorient.controller.base import Decision, OrientResult, Step, Strategy
from reorient.controller.fusing import Fusing
from reorient.controller.limits import Limits
from reorient.controller.loop import orient
from reorient.controller.proportional import Proportional

__all__ = ["Decision", "Fusing", "Limits", "OrientResult", "Proportional", "Step", "Strategy", "orient"]
