"""What drivers share whose controller follows poses that are sent to it, and sends its own."""

import time
from abc import abstractmethod
from dataclasses import dataclass
from threading import RLock
from typing import Any

from reorient.errors import StationError
from reorient.se3 import Transform
from reorient.stations.arms.supervised import StraightPath, SupervisedArm


@dataclass(kw_only=True, eq=False)
class StreamedArm(SupervisedArm):
    """An arm that is moved by a stream of poses.

    A thread of the driver hands over each message that arrives to ``_received``, and sends the poses of ``_due``.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self._lock = RLock()
        self._latest: tuple[Transform, Any, float] | None = None
        """The measured pose, its message, and the time of its arrival."""
        self._path: StraightPath | None = None
        self._start_s = 0.0

    def pose(self) -> Transform:
        """The measured pose of the tool, T_base_tool. Raises StationError where none arrived for ``silent_s``."""
        with self._lock:
            if self._latest is None or self._is_silent():
                lost = (
                    "no connection to the controller" if self._latest is None else "connection to the controller lost"
                )
                raise StationError(f"{lost}: {self._silence()}")
            T, message, _ = self._latest
        self._check(message)
        return T

    def stop(self) -> None:
        """Send no more poses of the path."""
        with self._lock:
            self._path = None

    @abstractmethod
    def _silence(self) -> str:
        """What does not arrive, and where."""

    def _check(self, message: Any) -> None:
        """Raise StationError for a state in which the controller does not follow."""

    def _await_controller(self) -> None:
        """Wait until the controller is ready. Closes the driver and raises the error where it is not in time."""
        deadline_s = time.monotonic() + self.timeout_s
        try:
            while True:
                try:
                    return self._check_ready()
                except StationError:
                    if time.monotonic() > deadline_s:
                        raise
                time.sleep(0.02)
        except BaseException:
            self.close()
            raise

    def _check_ready(self) -> None:
        """Raise StationError where the arm cannot be moved."""
        self.pose()

    @abstractmethod
    def close(self) -> None:
        """Disconnect."""

    def _begin(self, path: StraightPath) -> None:
        self._check_ready()
        with self._lock:
            self._path, self._start_s = path, time.monotonic()

    def _executing(self) -> bool:
        with self._lock:
            return self._path is not None

    def _received(self, T: Transform, message: Any) -> None:
        """Keep the controller's state."""
        with self._lock:
            self._latest = T, message, time.monotonic()

    def _is_silent(self) -> bool:
        return self._latest is None or time.monotonic() - self._latest[2] > self.silent_s

    def _due(self) -> Transform | None:
        """The pose of the path for this moment, its end once; None at rest."""
        with self._lock:
            if self._path is None:
                return None
            elapsed_s = time.monotonic() - self._start_s
            T = self._path.at(elapsed_s)
            if elapsed_s > self._path.duration_s:
                self._path = None
            return T
