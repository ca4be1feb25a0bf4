"""One resumable run: every measurement of the package is one.

A run folder holds ``config.json`` (config, version, commit, command) and, at the end, gzip-compressed CSV tables, of
which ``rows.csv.gz`` marks the run as finished. Until then each finished task is one line of ``partial.jsonl``, so that
an interrupted or killed run continues where it stopped and ends with the same rows. A lock keeps a second process out.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from reorient.errors import ReorientError, reason_of
from reorient.runs.files import locked, make_folder, replacing, write_table, writing
from reorient.runs.pool import Pool, Task
from reorient.runs.provenance import keep_record, run_record

Row = dict[str, str]
"""One row of a table: text by column."""
Tables = dict[str, list[Row]]
"""Rows by the name of their table; one task's, or a whole run's."""
Progress = Iterator[tuple[int, int]]
"""Yields (tasks done, tasks in all)."""
Result = TypeVar("Result")
Kept = TypeVar("Kept", contravariant=True)

CONFIG = "config.json"
LOCK = ".lock"


@runtime_checkable
class Store(Protocol[Kept]):
    """Where the results of a run's tasks are kept."""

    def finished(self, folder: Path) -> bool:
        """Whether nothing is left to do, whatever the tasks are."""
        ...

    def done(self, folder: Path) -> set[str]:
        """The tasks whose results are in the folder."""
        ...

    def keep(self, folder: Path, task: str, result: Kept) -> None:
        """Keep one result at once."""
        ...

    def pack(self, folder: Path, tasks: Sequence[str]) -> None:
        """Make the final files, after all results are kept."""
        ...


def resumable(
    folder: Path,
    config: Any,
    tasks: Mapping[str, Task],
    measure: Callable[[Task], Result],
    store: Store[Result],
    pool: Pool | None = None,
    **more: Any,
) -> Progress:
    """Measure every task that the folder lacks.

    ``config``: a dataclass; ``more``: other JSON values on which the results depend. Both are recorded in
    ``config.json``. ``tasks``: by a key that is unique in the run; ``measure`` gets the value and must be picklable.
    Raises ReorientError where the folder holds a run of another config, where another process is writing into it, and
    where the results in it are not those of the tasks.
    """
    pool = pool or Pool()
    record = run_record(config, workers=pool.workers, backend=pool.backend, **more)
    make_folder(folder)
    if store.finished(folder):
        keep_record(folder / CONFIG, record, ("config", *more))
        yield len(tasks), len(tasks)
        return
    with locked(folder / LOCK):
        keep_record(folder / CONFIG, record, ("config", *more))
        done = store.done(folder)
        if strange := done - set(tasks):
            raise ReorientError(
                f"{str(folder)!r} holds results of other tasks, such as {min(strange)!r}: it was begun by another "
                "version; expected a new folder"
            )
        left = [task for task in tasks if task not in done]
        yield len(done), len(tasks)
        results = pool.map(measure, [tasks[task] for task in left])
        for count, (task, result) in enumerate(zip(left, results, strict=True), len(done) + 1):
            store.keep(folder, task, result)
            yield count, len(tasks)
        store.pack(folder, list(tasks))


class RowStore:
    """Tables of raw rows: a task's result is ``Tables``; its table "rows" must not stay empty in the whole run."""

    def __init__(self) -> None:
        self._columns: dict[str, list[str]] = {}

    def finished(self, folder: Path) -> bool:
        """As ``Store``."""
        return (folder / "rows.csv.gz").is_file()

    def done(self, folder: Path) -> set[str]:
        """As ``Store``; the rest of a torn last line is removed."""
        return set(self._read(folder))

    def keep(self, folder: Path, task: str, result: Tables) -> None:
        """As ``Store``. Raises ReorientError for columns other than those of the rows kept before."""
        self._check_columns(folder, result)
        with writing(folder / "partial.jsonl"), (folder / "partial.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"task": task} | result) + "\n")

    def pack(self, folder: Path, tasks: Sequence[str]) -> None:
        """As ``Store``. Raises ReorientError, and packs nothing, where a task has no rows."""
        kept = self._read(folder)
        if missing := [task for task in tasks if task not in kept]:
            raise ReorientError(
                f"{len(missing)} of {len(tasks)} tasks have no rows in {str(folder)!r}, the first is {missing[0]!r}: "
                "expected all; run the same command again"
            )
        names = {name for tables in kept.values() for name in tables}
        for name in sorted(names, key="rows".__eq__):  # rows last: they mark the run as finished
            if rows := [row for task in tasks for row in kept[task].get(name, [])]:
                write_table(folder / f"{name}.csv.gz", rows)
        (folder / "partial.jsonl").unlink()

    def _read(self, folder: Path) -> dict[str, Tables]:
        kept = {}
        for number, line in enumerate(whole_lines(folder / "partial.jsonl"), 1):
            try:
                tables = json.loads(line)
                kept[str(tables.pop("task"))] = tables
                self._check_columns(folder, tables)
            except ReorientError:
                raise
            except Exception as error:
                raise ReorientError(
                    f"line {number} of {str(folder / 'partial.jsonl')!r} is broken ({reason_of(error)}): expected the "
                    "rows of a task; remove this line to measure it again"
                ) from error
        return kept

    def _check_columns(self, folder: Path, tables: Tables) -> None:
        for name, rows in tables.items():
            for row in rows:
                if list(row) != self._columns.setdefault(name, list(row)):
                    raise ReorientError(
                        f"{str(folder)!r} holds rows with other columns: it was begun by another version; expected a "
                        "new folder"
                    )


def whole_lines(path: Path) -> list[str]:
    """The complete lines of a file; an incomplete last line is removed from it."""
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines.pop()
        with replacing(path) as temporary:
            temporary.write_text("".join(lines), encoding="utf-8")
    return lines
