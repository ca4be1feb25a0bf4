"""Systems under test: an estimator and a strategy, named as ``estimator/strategy``."""

from typing import Any

from reorient.controller import Strategy, load_strategy
from reorient.estimators.base import Estimator
from reorient.experiments.cached import cached_estimator


def names_of(system: str) -> tuple[str, str]:
    """The names of a system's estimator and strategy. Raises ReorientError for an unknown one."""
    load_system(system)
    estimator, _, strategy = system.rpartition("/")
    return estimator, strategy


def load_system(system: str, **settings: Any) -> tuple[Estimator, Strategy]:
    """The estimator and the strategy, with these settings of the strategy. Raises ReorientError for an unknown one."""
    estimator, _, strategy = system.rpartition("/")
    return cached_estimator(estimator), load_strategy(strategy, **settings)
