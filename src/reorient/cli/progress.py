"""The bar of long work: how far, how long, how much longer."""

from collections.abc import Iterator
from itertools import chain

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


def show_progress(what: str, states: Iterator[tuple[int, int] | tuple[int, int, str]]) -> None:
    """Draw (done, all) states, some with a new text beside them, as a bar with the time left."""
    first = next(states)  # bad input is refused before there is a bar
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None)
        for done, total, *text in chain([first], states):
            bar.update(task, completed=done, total=total, description=text[0] if text else None)
