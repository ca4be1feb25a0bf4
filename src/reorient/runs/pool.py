"""Processes that work side by side, and end with the one that started them."""

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process
from threading import Thread

from reorient.errors import ReorientError


def check_workers(workers: int) -> None:
    """Raise ReorientError for a number of processes that can do nothing."""
    if workers < 1:
        raise ReorientError(f"{workers} workers: expected at least 1")


def processes(workers: int) -> ProcessPoolExecutor:
    """A pool of so many; they do not survive the caller, even if that is killed."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_watch)


def _watch() -> None:
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)
