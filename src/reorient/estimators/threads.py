"""One thread for the linear algebra of an estimate.

Its products are small: a second thread of the BLAS library burns half as much processor time again for a tenth less
waiting. So it is limited while estimates run; measurements and robots run several estimates at once instead.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from threading import Lock
from typing import Any

from threadpoolctl import ThreadpoolController

_lock = Lock()
_limits: list[Any] = []
"""The limit that is in force, once for each estimate that runs: the last to end lifts it."""


def threads(count: int | None) -> AbstractContextManager[None]:
    """Limits BLAS to so many threads while it is entered; None leaves it as it is. Estimates of several Python threads
    share the limit of the first."""
    return nullcontext() if count is None else _limited(count)


@contextmanager
def _limited(count: int) -> Iterator[None]:
    with _lock:
        _limits.append(_limits[0] if _limits else _blas().limit(limits=count, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            limit = _limits.pop()
            if not _limits:
                limit.restore_original_limits()


@cache
def _blas() -> ThreadpoolController:
    """The loaded libraries; found once, as that takes milliseconds."""
    return ThreadpoolController()
