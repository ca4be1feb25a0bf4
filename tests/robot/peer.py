"""A simulated device in a process of its own, as a real one is: it can be asked, and killed."""

import multiprocessing
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any


class Peer:
    """The process of a device. ``main(connection, *arguments)`` sends "ready", and answers what it is asked."""

    def __init__(self, main: Callable[..., None], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._lock = threading.Lock()
        self.process = context.Process(target=_run, args=(main, theirs, *arguments), daemon=True)
        self.process.start()
        theirs.close()
        self.address: Any = self._answer()

    def ask(self, *question: Any) -> Any:
        with self._lock:
            self._connection.send(question)
            return self._answer()

    def kill(self) -> None:
        self.process.kill()
        self.process.join()

    def _answer(self) -> Any:
        if not self._connection.poll(60):
            raise TimeoutError("the peer does not answer")
        answer = self._connection.recv()
        if isinstance(answer, str) and answer.startswith("Traceback"):
            raise RuntimeError(answer)
        return answer


def _run(main: Callable[..., None], connection: Connection, *arguments: Any) -> None:
    try:
        main(connection, *arguments)
    except BaseException:
        connection.send(traceback.format_exc())


@contextmanager
def running(main: Callable[..., None], *arguments: Any) -> Iterator[Peer]:
    peer = Peer(main, *arguments)
    try:
        yield peer
    finally:
        peer.kill()
