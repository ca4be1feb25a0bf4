"""How much longer a closed loop takes while a view shows it: paired loops, in turn without and with the view.

    python benchmarks/view_overhead.py out/view-overhead.csv --loops 20 --browser

Each pair repeats one loop of a simulated station: same object, start and noise, so same images. Wall time is what a
user waits; ``thread_s`` is the processor time of the loop's own thread, ``process_s`` that of all threads, the view's
included. With ``--browser`` a headless Chromium (Playwright, as for the tests of the view) shows the view meanwhile.
An interrupted run continues where it stopped.
"""

import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from growing_table import grow

from reorient import load_estimator, orient
from reorient.cli.arguments import Positional, parse
from reorient.cli.stations import StationChoice, rotate_away
from reorient.errors import ReorientError
from reorient.runs.provenance import commit
from reorient.runs.run import Row
from reorient.viewing.viewer import Viewer

COLUMNS = ("pair", "view", "browser", "wall_s", "thread_s", "process_s", "images", "status", "commit")
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")  # no screen


@dataclass(frozen=True)
class Overhead:
    """Measure how much longer a loop takes with a view."""

    out: Positional[Path]
    """File for the raw rows (.csv)."""
    loops: int = 20
    """Number of pairs of loops."""
    start_deg: float = 100.0
    """Angle between start and goal."""
    estimator: str = "rotation-search"
    """Estimator as of ``reorient orient``."""
    browser: bool = False
    """Show the view in a browser on this machine."""
    object_index: int = 51
    """Number of the generated object."""
    port: int = 8300
    """Port of the view."""


def rows_of(config: Overhead, done: int) -> Iterator[dict[str, Any]]:
    """Two rows of each pair that is not done yet; which comes first alternates."""
    version = commit()
    with ExitStack() as opened:
        viewer = Viewer(_station(config, 0).capture_goal(), "overhead", port=config.port)
        opened.callback(viewer.close)
        if config.browser:
            _browse(viewer.address, opened)
        _loop(config, 0, None)  # what is loaded and computed once
        _loop(config, 0, viewer)
        for pair in range(done, config.loops):
            order = (False, True) if pair % 2 == 0 else (True, False)
            cells = [_loop(config, pair, viewer if view else None) for view in order]
            about = {"pair": pair, "browser": int(config.browser), "commit": version}
            yield from (about | {"view": int(view)} | each for view, each in zip(order, cells, strict=True))


def _station(config: Overhead, pair: int) -> Any:
    return StationChoice("rendered", config.object_index, pair, 0.0, 1.0).open()


def _loop(config: Overhead, pair: int, viewer: Viewer | None) -> dict[str, Any]:
    """One loop; the view is given its time to draw the last step afterwards, outside the measurement."""
    station, estimator = _station(config, pair), load_estimator(config.estimator)
    goal = station.capture_goal()
    rotate_away(station, config.start_deg, np.random.default_rng(pair))
    if viewer is not None:
        viewer.show_goal(goal)
    clocks = time.perf_counter, time.thread_time, time.process_time
    begin = [clock() for clock in clocks]
    result = orient(station, goal, estimator, subscribers=() if viewer is None else (viewer,))
    seconds = [f"{clock() - start:.4f}" for clock, start in zip(clocks, begin, strict=True)]
    if viewer is not None:
        viewer.wait()
    return dict(zip(("wall_s", "thread_s", "process_s"), seconds, strict=True)) | {
        "images": len(result.steps),
        "status": result.status,
    }


def _browse(address: str, opened: ExitStack) -> None:
    """Open the address in a browser, until the end."""
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium")
    if path is None:
        raise ReorientError("no chromium: expected `apt-get install chromium`")
    playwright = opened.enter_context(sync_playwright())
    browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
    opened.callback(browser.close)
    page = browser.new_page(viewport={"width": 1000, "height": 700})
    page.goto(address)
    page.locator("canvas").first.wait_for(timeout=60_000)


def summarise(rows: list[Row]) -> str:
    """The ratio of the times with and without the view: of the sums, and the median of the pairs."""
    lines = []
    for column in ("wall_s", "thread_s", "process_s"):
        without, with_view = (
            np.array([float(row[column]) for row in sorted(rows, key=lambda x: int(x["pair"])) if row["view"] == view])
            for view in "01"
        )
        ratios = with_view / without
        low, high = np.percentile([np.median(x) for x in _resampled(ratios)], [2.5, 97.5])
        lines.append(
            f"{column}: {without.sum():.1f} s without, {with_view.sum():.1f} s with the view, "
            f"{with_view.sum() / without.sum() - 1:+.1%}; median of {len(ratios)} pairs {np.median(ratios) - 1:+.1%} "
            f"({low - 1:+.1%} to {high - 1:+.1%})"
        )
    return "\n".join(lines)


def _resampled(values: np.ndarray) -> np.ndarray:
    """Bootstrap samples, one a row."""
    return values[np.random.default_rng(0).integers(len(values), size=(1000, len(values)))]


def main(config: Overhead) -> None:
    """Measure, then print the figures."""

    def more(rows: list[Row]) -> Iterator[dict[str, Any]]:
        return rows_of(config, len(rows) // 2)

    print(summarise(grow(config.out, COLUMNS, more, "pair")))


if __name__ == "__main__":
    main(parse(Overhead, "benchmarks/view_overhead.py", sys.argv[1:]))
