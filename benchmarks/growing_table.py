"""A table of raw rows that grows: an interrupted benchmark continues where it stopped."""

import csv
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from reorient.runs.run import Row, whole_lines


def grow(
    path: Path, columns: Sequence[str], more: Callable[[list[Row]], Iterator[dict[str, Any]]], counted: str = "row"
) -> list[Row]:
    """All rows of a file (.csv) after ``more``, which makes those that follow the given ones, wrote each at once."""
    lines = whole_lines(path)
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="")
        if not lines:
            writer.writeheader()
        for count, row in enumerate(more(list(csv.DictReader(lines))), start=1):
            writer.writerow(row)
            file.flush()
            print(f"{counted} {row.get(counted, count)}", end="\r", file=sys.stderr)
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
