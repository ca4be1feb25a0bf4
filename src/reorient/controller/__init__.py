"""The closed loop: stations, strategies, limits and the record."""

from reorient.controller.algorithm1 import Algorithm1
from reorient.controller.base import AnyBelief, Decision, OrientResult, Status, Step, Strategy
from reorient.controller.fusing import Fusing
from reorient.controller.limits import Limits
from reorient.controller.loop import orient
from reorient.controller.strategies import load_strategy

__all__ = [
    "Algorithm1",
    "AnyBelief",
    "Decision",
    "Fusing",
    "Limits",
    "OrientResult",
    "Status",
    "Step",
    "Strategy",
    "load_strategy",
    "orient",
]
