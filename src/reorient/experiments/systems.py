"""Systems under test: an estimator and a strategy, named as ``estimator/strategy``."""

from typing import Any

from reorient.controller import Strategy, load_strategy
from reorient.errors import ReorientError
from reorient.estimators.base import Estimator
from reorient.experiments.cached import cached_estimator


def names_of(system: str) -> tuple[str, str]:
    """The names of a system's estimator and strategy. Raises ReorientError where there are not two."""
    estimator, slash, strategy = system.rpartition("/")
    if not slash:
        raise ReorientError(f"system {system!r}: expected an estimator and a strategy, such as 'default/fusing'")
    return estimator, strategy


def load_system(system: str, **settings: Any) -> tuple[Estimator, Strategy]:
    """The estimator and the strategy, with these settings of the strategy. Raises ReorientError for an unknown one."""
    estimator, strategy = names_of(system)
    return cached_estimator(estimator), load_strategy(strategy, **settings)
