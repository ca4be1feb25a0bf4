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

from filelock import FileLock, Timeout

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
def writing(path: str | Path) -> Iterator[None]:
    """A block that writes a file. Raises ReorientError, naming ``path``, where the system refuses that."""
    try:
        yield
    except OSError as error:
        raise ReorientError(f"cannot write {str(path)!r}: {error.strerror or error}") from error


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
        with writing(path):
            yield temporary
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Held by one process at a time; the system releases it when that process ends, however it ends.

    ``path``: of the lock, in the folder that is written or beside it. Raises ReorientError where another process holds
    it.
    """
    with writing(path):
        path.touch()  # FileLock takes some errors of the system for a lock of another process
    lock = FileLock(path, blocking=False)
    try:
        lock.acquire()
    except Timeout as error:
        raise ReorientError(
            f"another process is writing into {str(path.parent)!r}: expected to wait until it ends, or a new folder"
        ) from error
    try:
        yield
    finally:
        lock.release()


def write_table(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows with the same columns as gzip-compressed CSV; the same rows make the same bytes."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    with replacing(path) as temporary:
        temporary.write_bytes(gzip.compress(text.getvalue().encode(errors="backslashreplace"), mtime=0))
