"""Systems under test: an estimator and a strategy, named as ``estimator/strategy``."""

from typing import Any

from reorient.controller import Fusing, Proportional, Strategy
from reorient.errors import unknown_name
from reorient.estimators.base import Estimator
from reorient.experiments.cached import cached_estimator


def names_of(system: str) -> tuple[str, str]:
    """The names of a system's estimator and strategy. Raises ReorientError for an unknown one."""
    estimator, _, strategy = system.rpartition("/")
    load_system(system)
    return estimator, strategy


def load_system(system: str, **settings: Any) -> tuple[Estimator, Strategy]:
    """The estimator and the strategy, with these settings of the strategy. Raises ReorientError for an unknown one."""
    estimator, _, strategy = system.rpartition("/")
    strategies: dict[str, tuple[Any, dict[str, Any]]] = {
        "algorithm1": (Proportional, {}),
        "direct": (Proportional, {"eta": 1.0}),
        "fusing": (Fusing, {}),
    }
    if strategy not in strategies:
        raise unknown_name(f"strategy of system {system!r}:", strategy, list(strategies))
    make, fixed = strategies[strategy]
    return cached_estimator(estimator), make(**fixed | settings)
