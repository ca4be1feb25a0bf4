"""User-defined classes, given on the command line as ``my_module:MyClass``."""

import importlib
import sys
from pathlib import Path

from reorient.errors import ReorientError


def make_own(kind: str, name: str) -> object:
    """An object of the class ``my_module:MyClass``, importable also from the working folder; no arguments.

    ``kind``: a noun for error messages. Raises ReorientError if the class cannot be imported or called.
    """
    module_name, _, attribute = name.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        return getattr(importlib.import_module(module_name), attribute)()
    except Exception as error:  # the user's code may raise anything
        raise ReorientError(
            f"cannot make {kind} {name!r} ({type(error).__name__}: {error}): expected an importable class"
        ) from error
