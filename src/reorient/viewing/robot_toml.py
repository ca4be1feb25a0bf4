"""The isolation written back to ``robot.toml``; all else of the file stays as it is, its comments too."""

from dataclasses import fields
from pathlib import Path
from typing import Any

from reorient.errors import ReorientError
from reorient.extras import import_extra
from reorient.imaging import Isolation
from reorient.runs.files import replacing


def write_isolation(path: Path, isolation: Isolation) -> None:
    """Write the fields that differ from their defaults, and remove the others, in the table ``isolation``.

    Raises ReorientError where the extra ``view`` is not installed, for a background that is no file, and where the
    file cannot be written.
    """
    tomlkit = import_extra("tomlkit")
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    table = document.setdefault("isolation", tomlkit.table())
    for each in fields(Isolation):
        value = _as_toml(getattr(isolation, each.name), path)
        if value in (None, False):
            table.pop(each.name, None)
        elif table.get(each.name) != value:
            table[each.name] = value
    with replacing(path) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8")


def _as_toml(value: Any, path: Path) -> Any:
    """A value of a field as TOML has it; the name of a file relative to ``path``."""
    if isinstance(value, tuple):
        return list(value)
    if isinstance(value, str | Path):
        file = Path(value)
        return str(file.relative_to(path.parent) if file.is_relative_to(path.parent) else file)
    if value is None or isinstance(value, bool | int | float):
        return value
    raise ReorientError(f"background of type {type(value).__name__}: expected a file, whose name robot.toml can have")
