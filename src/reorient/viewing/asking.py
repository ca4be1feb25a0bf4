"""A station in a view whose every move is asked for."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float


class Asking:
    """A station whose every move waits for an answer; a no ends the loop as the keyboard does."""

    def __init__(self, station: Any, ask: Callable[[Float[np.ndarray, "3 3"]], bool]) -> None:
        self._station, self._ask = station, ask
        self.moving = False

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The station's move, once it is allowed. Raises KeyboardInterrupt where it is not."""
        if not self._ask(R_step):
            raise KeyboardInterrupt
        self.moving = True
        try:
            R: Float[np.ndarray, "3 3"] = self._station.rotate(R_step)
        finally:
            self.moving = False
        return R

    def __getattr__(self, name: str) -> Any:
        return getattr(self._station, name)
