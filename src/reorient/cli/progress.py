"""Output of long work: a progress bar, and the console for tables."""

import sys
from collections.abc import Iterator
from itertools import chain

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

SPEED_OVER_S = 600.0  # the time left is estimated from so long: tasks may take a minute


def show_progress(description: str, states: Iterator[tuple[int, int] | tuple[int, int, str]]) -> None:
    """Draw (done, total) states, some with a new description, as a bar with the time left."""
    first = next(states)  # raises for bad input before the bar is drawn
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=SPEED_OVER_S) as bar:
        task = bar.add_task(description, total=None)
        for done, total, *text in chain([first], states):
            bar.update(task, completed=done, total=total, description=text[0] if text else None)


def table_console() -> Console:
    """A console as wide as the terminal, or wide enough for the tables where there is none. Names are no markup."""
    return Console(markup=False, emoji=False, width=None if sys.stdout.isatty() else 120)
