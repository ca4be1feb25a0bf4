"""A pool of workers: processes of this machine or a Ray cluster."""

import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from threading import Thread
from typing import Any, Literal, TypeVar

from reorient.errors import OutOfRange, check_range
from reorient.extras import import_extra

Task = TypeVar("Task")
Result = TypeVar("Result")
Backend = Literal["processes", "ray"]

_RETRIES = 5  # of a task whose node or process ends
_POLL_S = 0.5
MOST_WORKERS = 10_000


@dataclass(frozen=True)
class Pool:
    """Number and kind of the workers. Results depend on neither."""

    workers: int = 1
    """Number of worker processes, -1 for one per core."""
    backend: Backend = "processes"
    """Kind of the workers: processes of this machine, or a Ray cluster (extra ``cluster``), which is started here
    unless RAY_ADDRESS names one."""

    def __post_init__(self) -> None:
        """Raises ReorientError for a number of workers other than -1, 1, 2, ..."""
        if self.workers < 1 and self.workers != -1:
            raise OutOfRange("workers", self.workers, "at least 1, or -1 for one per core")
        check_range(self, "workers", low=-1, high=MOST_WORKERS)

    @property
    def count(self) -> int:
        """The number of workers; asking a Ray cluster for its cores connects to it or starts it."""
        if self.workers != -1:
            return self.workers
        return int(_ray().cluster_resources()["CPU"]) if self.backend == "ray" else os.cpu_count() or 1

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """The results in the order of the tasks, each as soon as it and those before it are there.

        One worker of backend "processes" is the calling process. Worker processes end with the calling process, even
        if that is killed. Raises MissingExtra where Ray is not installed, and whatever ``function`` raises.
        """
        if self.backend == "ray":
            return self._map_on_ray(function, tasks)
        return map(function, tasks) if self.count == 1 else self._map_on_processes(function, tasks)

    def _map_on_processes(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        from joblib import Parallel, delayed

        warnings.filterwarnings("ignore", ".* tasks which were still being processed", UserWarning)  # an interruption
        parallel: Any = Parallel(
            self.count, return_as="generator", backend="loky", max_nbytes=None,
            initializer=_end_with, initargs=(os.getpid(),),
        )  # fmt: skip
        yield from parallel(delayed(function)(task) for task in tasks)

    def _map_on_ray(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """A task of a node that fails runs again on another one."""
        ray, count = _ray(), self.count
        call, shared = ray.remote(num_cpus=1, max_retries=_RETRIES)(_call), ray.put(function)
        upcoming, running, ended = iter(enumerate(tasks)), dict[Any, int](), dict[int, Any]()
        try:
            for wanted in range(len(tasks)):
                while wanted not in ended:
                    running |= {call.remote(shared, task): i for i, task in islice(upcoming, count - len(running))}
                    (reference,), _ = ray.wait(list(running))
                    ended[running.pop(reference)] = reference
                try:
                    yield ray.get(ended.pop(wanted))
                except ray.exceptions.RayTaskError as error:  # its own text is a traceback
                    raise error.cause from error
        finally:
            for reference in running:  # after an error or an interruption
                ray.cancel(reference, force=True)


def _call(function: Callable[[Task], Result], task: Task) -> Result:
    return function(task)


def _ray() -> Any:
    """Ray, connected."""
    ray = import_extra("ray")
    if not ray.is_initialized():
        ray.init(include_dashboard=False, log_to_driver=False)
    return ray


def _end_with(parent: int) -> None:
    """End this worker with the process that started it (which Windows does not show: there it ends when idle)."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_POLL_S)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
