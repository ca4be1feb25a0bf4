"""Files that are whole or absent: written to a temporary neighbour, then renamed."""

import csv
import gzip
import io
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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


def write_table(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows with the same columns as gzip-compressed CSV; the same rows make the same bytes."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    with replacing(path) as temporary:
        temporary.write_bytes(gzip.compress(text.getvalue().encode(), mtime=0))
