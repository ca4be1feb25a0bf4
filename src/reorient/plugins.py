"""Classes of the user's own, named on the command line as ``my_module:MyClass``."""

import importlib
import sys
from pathlib import Path

from reorient.errors import ReorientError


def make_own(kind: str, name: str) -> object:
    """An object of a class ``my_module:MyClass``: imported (the working folder included) and called with nothing.

    ``kind``: what it is, for the errors. Raises ReorientError where that cannot be.
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
