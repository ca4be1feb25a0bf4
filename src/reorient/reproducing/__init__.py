"""The paper's experiments again, one figure a file, each with the fair comparison beside it.

A figure is a module with ``measure(setting)``, which leaves raw rows in ``setting.folder(NAME)`` and resumes what is
there; ``findings(folder)``, the numbers that the rows amount to; and ``draw(setting, folder)``, pictures and a page.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Literal, Protocol, cast, get_args, runtime_checkable

from reorient.errors import unknown_name
from reorient.reproducing.findings import Finding
from reorient.reproducing.setting import Setting

Name = Literal["object-sets", "best-worst", "sweeps", "controller", "non-symmetric", "full"]
NAMES: tuple[Name, ...] = get_args(Name)  # the cheap ones first


@runtime_checkable
class Figure(Protocol):
    """What each module of this room offers."""

    def measure(self, setting: Setting) -> None:
        """Leave the raw rows; goes on where an interrupted run stopped."""
        ...

    def findings(self, folder: Path) -> Sequence[Finding]:
        """The numbers, from the raw rows."""
        ...

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """Pictures and a page, from the raw rows; returns what was written."""
        ...


def load_figure(name: str) -> Figure:
    """A figure by name. Raises ReorientError for an unknown one."""
    if name not in NAMES:
        raise unknown_name("figure", name, list(NAMES))
    return cast(Figure, import_module(f"reorient.reproducing.{name.replace('-', '_')}"))
