"""A station in a view whose every move is asked for."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from reorient.controller.station import Forwarding, Station


class Asking(Forwarding):
    """A station whose every move waits for an answer; a no ends the loop as the keyboard does."""

    def __init__(self, station: Station, ask: Callable[[Float[np.ndarray, "3 3"]], bool]) -> None:
        super().__init__(station)
        self._ask = ask
        self.moving = False

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The station's move, once it is allowed. Raises KeyboardInterrupt where it is not."""
        if not self._ask(R_step):
            raise KeyboardInterrupt
        self.moving = True
        try:
            return super().rotate(R_step)
        finally:
            self.moving = False
