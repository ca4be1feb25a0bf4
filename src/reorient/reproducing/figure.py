"""A figure: three steps, each of which reads the files of the one before it."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

from reorient.errors import unknown_name
from reorient.reproducing import NAMES
from reorient.reproducing.findings import Finding
from reorient.reproducing.setting import Setting


@runtime_checkable
class Figure(Protocol):
    """Measures, summarises and draws; its fields are sizes, so that tests can make a small one."""

    @property
    def name(self) -> str:
        """Of the command and of the folder."""
        ...

    def measure(self, setting: Setting) -> None:
        """Leave raw rows in ``setting.folder(name)``; continues where an interrupted run stopped."""
        ...

    def findings(self, folder: Path) -> Sequence[Finding]:
        """The numbers that the rows amount to."""
        ...

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """Pictures and, last, a page, from the rows; returns what was written."""
        ...


def load_figure(name: str) -> Figure:
    """A figure by name. Raises ReorientError for an unknown one."""
    if name not in NAMES:
        raise unknown_name("figure", name, list(NAMES))
    return cast(Figure, import_module(f"reorient.reproducing.{name.replace('-', '_')}").FIGURE)
