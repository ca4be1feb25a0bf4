"""The user's own code: classes named as ``my_module:MyClass``, and the errors that they raise."""

import importlib
import logging
import sys
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from reorient.errors import ProtocolError, ReorientError, StationError

LOGGER = logging.getLogger("reorient")
"""Receives the traceback of every error that ``in_words`` puts into a line, at level DEBUG."""
USER_ERRORS = (Exception, SystemExit)
"""What the user's code may raise; a driver may call ``sys.exit``."""
PROGRAMMING_ERRORS = (
    *(ProtocolError, TypeError, AttributeError, NameError, KeyError, ImportError),
    *(NotImplementedError, SyntaxError, AssertionError),
)
"""Errors that come again however often the call is repeated."""
_NOT_THE_USERS = tuple(
    str(Path(folder).resolve())
    for folder in (str(Path(__file__).parent), *map(sysconfig.get_path, ("stdlib", "platstdlib", "purelib", "platlib")))
)


def import_own(kind: str, name: str) -> Any:
    """Import ``my_module:MyClass``, from the working folder too.

    ``kind``: "station" or the like, for messages. Raises ReorientError where the import fails.
    """
    module_name, _, attribute = name.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        return getattr(importlib.import_module(module_name), attribute)
    except USER_ERRORS as error:
        raise _refused(kind, name, error) from error


def make_own(kind: str, name: str) -> object:
    """Import a class as of ``import_own`` and call it without arguments. Raises ReorientError where that fails."""
    own = import_own(kind, name)
    try:
        return own()
    except USER_ERRORS as error:
        raise _refused(kind, name, error) from error


def _refused(kind: str, name: str, error: BaseException) -> ReorientError:
    return ReorientError(
        f"cannot make {kind} {name!r} ({in_words(error)}): expected an importable class, made without arguments"
    )


@contextmanager
def tracebacks_shown(shown: bool = True) -> Iterator[None]:
    """A block in which the tracebacks of errors are printed on standard error."""
    handler = logging.StreamHandler()
    level = LOGGER.level
    if shown:
        LOGGER.addHandler(handler)
        LOGGER.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        LOGGER.removeHandler(handler)
        LOGGER.setLevel(level)


@contextmanager
def in_one_line(what: str) -> Iterator[None]:
    """A block that calls the user's code: ReorientError for whatever that raises; ``what`` begins the message."""
    try:
        yield
    except ReorientError:
        raise
    except USER_ERRORS as error:
        raise ReorientError(f"{what}: {in_words(error)}") from error


def in_words(error: BaseException) -> str:
    """An error in one line: its type, its message, and file and line in the user's code. Its traceback is logged."""
    LOGGER.debug("the traceback of an error:", exc_info=error)
    text = " ".join(str(error).split()).encode(errors="backslashreplace").decode()  # a lone surrogate fits no file
    if not isinstance(error, ReorientError):
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    place = "" if isinstance(error, StationError) else _place(error)
    return f"{text} [{place}]" if place else text


def _place(error: BaseException) -> str:
    """Where an error arose in the user's code, the innermost line; empty where none of it is the user's."""
    places = [(frame.filename, frame.lineno or 0) for frame in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError) and error.filename:
        places.append((error.filename, error.lineno or 0))
    for file, line in reversed(places):
        path = Path(file).resolve()
        if path.is_file() and not str(path).startswith(_NOT_THE_USERS):
            here = path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
            return f"{here}, line {line}"
    return ""
