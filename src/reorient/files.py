"""Files that are whole or absent: written to a temporary neighbour, then renamed."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from reorient.errors import ReorientError


def make_folder(path: str | Path) -> Path:
    """The folder, made with its parents if need be. Raises ReorientError where that cannot be."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ReorientError(f"cannot make folder {str(path)!r}: {error.strerror or error}") from error
    return path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary path with the same suffix that becomes ``path`` when the block ends, and vanishes if it raises.

    Raises ReorientError where the folder does not exist or cannot be written.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise ReorientError(f"cannot write {str(path)!r}: expected an existing folder {str(path.parent)!r}")
    if path.is_dir():
        raise ReorientError(f"cannot write {str(path)!r}: it is a folder, expected a file name")
    temporary = path.with_name(f".{secrets.token_hex(4)}.{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise ReorientError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
