"""User classes, named on the command line as ``my_module:MyClass``, and the libraries of the extras."""

import importlib
import sys
from pathlib import Path
from typing import Any

from reorient.errors import ReorientError


def import_own(kind: str, name: str) -> Any:
    """Import ``my_module:MyClass``, from the working folder too.

    ``kind``: "station" or the like, for messages. Raises ReorientError where the import fails.
    """
    module_name, _, attribute = name.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        return getattr(importlib.import_module(module_name), attribute)
    except Exception as error:  # the user's code may raise anything
        raise _refused(kind, name, error) from error


def make_own(kind: str, name: str) -> object:
    """Import a class as of ``import_own`` and call it without arguments. Raises ReorientError where that fails."""
    own = import_own(kind, name)
    try:
        return own()
    except Exception as error:  # the user's code may raise anything
        raise _refused(kind, name, error) from error


def _refused(kind: str, name: str, error: Exception) -> ReorientError:
    return ReorientError(f"cannot make {kind} {name!r} ({type(error).__name__}: {error}): expected an importable class")


def import_extra(module: str, extra: str) -> Any:
    """The library ``module``, which an extra of this package installs. Raises ReorientError where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ReorientError(f"cannot import {module} ({error}): expected `pip install 'reorient[{extra}]'`") from error
