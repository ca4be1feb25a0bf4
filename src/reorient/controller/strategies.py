"""Strategies by name."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from reorient.controller.algorithm1 import Algorithm1
from reorient.controller.base import Strategy
from reorient.controller.fusing import Fusing
from reorient.errors import ReorientError, unknown_name

_STRATEGIES: dict[str, tuple[Callable[..., Strategy], dict[str, Any]]] = {
    "fusing": (Fusing, {}),
    "algorithm1": (Algorithm1, {}),
    "direct": (Algorithm1, {"eta": 1.0}),
}
STRATEGY_NAMES = tuple(_STRATEGIES)


def load_strategy(name: str = "fusing", **settings: Any) -> Strategy:
    """A strategy of the package, with settings other than its defaults.

    ``fusing``: few moves from any start, for an estimator with a calibrated confidence (fields of ``Fusing``, such as
    max_moves=12). ``algorithm1``: the paper's (fields of ``Algorithm1``, such as eta=0.2 and delta_rad in radians).
    ``direct``: Algorithm 1 with eta = 1, which rotates by each estimate in full. Raises ReorientError, a ValueError,
    for an unknown name, an unknown setting and a value out of range.
    """
    if name not in _STRATEGIES:
        raise unknown_name("strategy", str(name), list(STRATEGY_NAMES))
    make, defaults = _STRATEGIES[name]
    known = [x.name for x in fields(make)]  # type: ignore[arg-type]
    for setting in settings:
        if setting not in known:
            raise unknown_name(f"setting of strategy {name!r}:", setting, known)
    try:
        return make(**defaults | settings)
    except TypeError as error:
        raise ReorientError(f"settings {settings} of strategy {name!r}: expected numbers ({error})") from error
