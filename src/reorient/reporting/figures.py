"""Figures: error against angle, its distribution, the course of a loop. One style, one colour for an estimator."""

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from PIL import Image

from reorient.reporting.pictures import BACKGROUND, INK
from reorient.reporting.rows import estimators, numbers
from reorient.runs.run import Row

_KNOWN = {"paper": "#cc5a71", "icp": "#8d99ae", "gicp": "#2f6db5", "swift": "#1d9a6c", "default": "#e08e1b"}
_SPARE = ("#7b5ea7", "#17a2b8", "#a0522d", "#e377c2", "#6b7f1f", "#444b59")
_TRUE, _PREDICTED = "#4a90d9", "#e08e1b"
DASHES = (0, (3, 2))
REFERENCE = "#7a808c"
_FEWEST = 5  # rows of a bin whose quartiles are worth drawing
PAGE_INCHES = 10.6
STYLE: Any = {  # matplotlib types the keys as literals, which no plain dict satisfies
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a919e",
    "axes.labelcolor": "#3b4252",
    "axes.titlesize": 9.5,
    "axes.titlecolor": "#20242c",
    "axes.grid": True,
    "grid.color": "#e4e7ec",
    "grid.linewidth": 0.7,
    "xtick.color": "#5b6270",
    "ytick.color": "#5b6270",
    "lines.linewidth": 1.8,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "reorient",  # the same figure, the same bytes
}

Panels = Mapping[str, Mapping[str, Sequence[Sequence[float]]]]
"""By title and system, lists of errors in degrees."""


def error_by_angle(rows: Sequence[Row]) -> str:
    """Median error (line) and quartiles (band) in bins of the start angle, a panel for each noise: an SVG data URI."""
    angle_deg, error_deg, noise_mm = (numbers(rows, column) for column in ("angle_deg", "error_deg", "noise_mm"))
    names = np.array([row["estimator"] for row in rows])
    colours = colours_of(estimators(rows))
    levels = np.unique(noise_mm)
    low, high = numbers(rows, "low_deg").min(), numbers(rows, "high_deg").max()
    bins = int(np.clip(len(rows) / len(levels) / len(colours) / 15, 3, 18))
    edges = np.linspace(low, high, bins + 1)
    which = np.clip(np.searchsorted(edges, angle_deg, side="right") - 1, 0, bins - 1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(_width_inches(len(levels)), 3.3))
        panels = figure.subplots(1, len(levels), squeeze=False, sharey=True)[0]
        for axes, level in zip(panels, levels, strict=True):
            axes.set(title=f"depth noise {level:g} mm", xlabel="angle between start and goal", xlim=(low, high))
            for name, colour in colours.items():
                members = [(noise_mm == level) & (names == name) & (which == b) for b in range(bins)]
                kept = [b for b in range(bins) if np.count_nonzero(members[b]) >= _FEWEST]
                if not kept:
                    continue
                first, median, third = np.array([np.percentile(error_deg[members[b]], [25, 50, 75]) for b in kept]).T
                middles = (edges[kept] + edges[np.add(kept, 1)]) / 2
                axes.fill_between(middles, first, third, color=colour, alpha=0.15, linewidth=0)
                axes.plot(middles, median, color=colour, marker="o", markersize=3)
            axes.set_yscale("log")
            axes.xaxis.set_major_locator(MaxNLocator(7, steps=[1, 3, 6, 10]))
            axes.xaxis.set_major_formatter(_degrees())
            axes.yaxis.set_major_formatter(_degrees())
        # last, because a limit set on shared axes ends their autoscaling
        panels[0].set_ylim(bottom=max(panels[0].get_ylim()[0], _least_deg(error_deg)))
        panels[0].set_ylabel("error (median, quartiles)")
        legend(figure, colours)
        return svg(figure)


def cumulative_errors(rows: Sequence[Row]) -> str:
    """The share of pairs with an error below x, symmetry-aware dashed; panels: range by noise. An SVG data URI."""
    plain_deg, aware_deg = numbers(rows, "error_deg"), numbers(rows, "error_sym_deg")
    colours = colours_of(estimators(rows))
    with mpl.rc_context(STYLE):
        figure, panels = _cells(rows, _least_deg(plain_deg), "share of pairs below")
        for axes, members in panels:
            axes.set_ylim(0, 1.01)
            for name, mine in members.items():
                _cumulate(axes, plain_deg[mine], color=colours[name])
                _cumulate(axes, aware_deg[mine], color=colours[name], linestyle=DASHES, linewidth=1.1)
        legend(figure, colours, [Line2D([], [], color="#5b6270", ls=DASHES, lw=1.1, label="symmetry-aware")])
        return svg(figure)


def error_histograms(rows: Sequence[Row]) -> str:
    """The share of pairs in logarithmic bins of the plain error, panels as of ``cumulative_errors``: an SVG data URI.

    The first bin also holds the smaller errors, so that the bars of an estimator add up to all of its pairs.
    """
    error_deg = numbers(rows, "error_deg")
    colours = colours_of(estimators(rows))
    least_deg = _least_deg(error_deg)
    with mpl.rc_context(STYLE):
        figure, panels = _cells(rows, least_deg, "share of pairs")
        most = max(np.count_nonzero(mine) for _, members in panels for mine in members.values())
        edges = np.geomspace(least_deg, 180, int(np.clip(2 * np.sqrt(most), 8, 24)) + 1)
        for axes, members in panels:
            for name, mine in members.items():
                count, _ = np.histogram(np.clip(error_deg[mine], least_deg, 180), edges)
                share = count / count.sum()
                axes.stairs(share, edges, fill=True, color=colours[name], alpha=0.13, lw=0)
                axes.stairs(share, edges, color=colours[name], lw=1.4, zorder=3)  # above the grid and every filling
        panels[0][0].set_ylim(bottom=0)
        legend(figure, colours)
        return svg(figure)


def loop_curve(predicted_deg: Sequence[float], true_deg: Sequence[float]) -> str:
    """Remaining angle at each image of a loop, as predicted and in truth (where known): an SVG data URI."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_INCHES, 3.2))
        axes = figure.subplots()
        for line, values in zip(_loop_axes(axes, predicted_deg, true_deg), (predicted_deg, true_deg), strict=True):
            line.set_data(range(len(values)), values)
        axes.legend()
        return svg(figure)


def growing_curve(predicted_deg: Sequence[float], true_deg: Sequence[float], size_px: int) -> list[Image.Image]:
    """The same on a dark square, once for each image of the loop, up to that image."""
    dark, ink = (tuple(x / 255 for x in colour) for colour in (BACKGROUND, INK))
    inked = ("axes.edgecolor", "axes.labelcolor", "axes.titlecolor", "xtick.color", "ytick.color", "text.color")
    style = STYLE | dict.fromkeys(inked, ink) | dict.fromkeys(("figure.facecolor", "axes.facecolor"), dark)
    with mpl.rc_context(style | {"grid.color": "#353a45"}):
        figure = Figure(figsize=(size_px / 100, size_px / 100), dpi=100)
        canvas = FigureCanvasAgg(figure)
        axes = figure.subplots()
        lines = _loop_axes(axes, predicted_deg, true_deg)
        axes.legend(loc="upper right", handlelength=1.6)
        canvas.draw()
        figure.set_layout_engine("none")  # laid out once: the axes must not stir, and it takes most of the time
        frames = []
        for count in range(1, len(predicted_deg) + 1):
            for line, values in zip(lines, (predicted_deg, true_deg), strict=True):
                shown = values[:count]
                line.set_data(range(len(shown)), shown)
                line.set_markevery([len(shown) - 1] if shown else [])
            canvas.draw()
            frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
        return frames


def error_by_image(panels: Panels, reference_deg: float, reference: str) -> str:
    """Median and quartiles of the true error at each image of many loops, a panel for each title: an SVG data URI.

    A loop that has ended keeps its last error. ``reference_deg``: a level to compare with, named in the legend.
    """
    looks = _looks(panels)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(_width_inches(max(len(panels), 2)), 3.3))
        grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
        for axes, (title, systems) in zip(grid, panels.items(), strict=True):
            axes.axhline(reference_deg, color=REFERENCE, lw=1.2, ls=":", zorder=0)
            for system, loops in systems.items():
                last = max(len(errors) for errors in loops)
                whole = np.array([[*errors, *[errors[-1]] * (last - len(errors))] for errors in loops])
                first, median, third = np.percentile(whole, [25, 50, 75], axis=0)
                axes.fill_between(range(last), first, third, color=looks[system]["color"], alpha=0.13, linewidth=0)
                axes.plot(range(last), median, **looks[system])
            axes.set(title=title, xlabel="images", yscale="log")
            axes.xaxis.set_major_locator(MaxNLocator(7, integer=True))
            _plain_decades(axes)
        grid[0].set_ylabel("error (median, quartiles)")
        _legend_of_looks(figure, looks, reference)
        return svg(figure)


def errors_by_object(panels: Panels, names: Sequence[str], reference_deg: float, reference: str) -> str:
    """Every loop's last error above the object's name, its median as a bar: an SVG data URI.

    ``panels``: by title and system, for each of the names the last errors.
    """
    looks = _looks(panels)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_INCHES, 2.9 * len(panels) + 0.6))
        grid = figure.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
        for axes, (title, systems) in zip(grid, panels.items(), strict=True):
            axes.axhline(reference_deg, color=REFERENCE, lw=1.2, ls=":", zorder=0)
            for index, (system, errors) in enumerate(systems.items()):
                middle = (index + 0.5) / len(systems) * 0.7 - 0.35
                colour, hollow = looks[system]["color"], "ls" in looks[system]
                for place, values in enumerate(errors):
                    spread = (np.arange(len(values)) - (len(values) - 1) / 2) * 0.04 / len(systems)
                    fill = "none" if hollow else colour
                    axes.scatter(place + middle + spread, values, s=16, facecolors=fill, edgecolors=colour, lw=0.9)
                    if len(values):
                        axes.hlines(np.median(values), place + middle - 0.12, place + middle + 0.12, color=colour, lw=2)
            axes.set(title=title, yscale="log", ylabel="final error")
            _plain_decades(axes)
        grid[-1].set_xticks(range(len(names)), names)
        _legend_of_looks(figure, looks, reference)
        return svg(figure)


def _looks(panels: Panels) -> dict[str, dict[str, Any]]:
    """How each system "estimator/strategy" is drawn: the estimator's colour, dashed from its second strategy on."""
    systems = list(dict.fromkeys(system for panel in panels.values() for system in panel))
    colours = colours_of(dict.fromkeys(system.split("/")[0] for system in systems))
    looks: dict[str, dict[str, Any]] = {}
    for system in systems:
        estimator = system.split("/")[0]
        again = any(other.split("/")[0] == estimator for other in looks)
        looks[system] = {"color": colours[estimator]} | ({"ls": DASHES} if again else {})
    return looks


def _legend_of_looks(figure: Figure, looks: dict[str, dict[str, Any]], reference: str) -> None:
    handles = [Line2D([], [], **look, label=system) for system, look in looks.items()]
    handles.append(Line2D([], [], color=REFERENCE, lw=1.2, ls=":", label=reference))
    figure.legend(handles=handles, loc="outside upper left", ncols=min(len(handles), 5))


def _cells(
    rows: Sequence[Row], least_deg: float, ylabel: str
) -> tuple[Figure, list[tuple[Axes, dict[str, np.ndarray]]]]:
    """A panel for each range (down) and noise (across), errors along x, shares along y, and whose rows belong there."""
    noise_mm, low_deg, high_deg = (numbers(rows, column) for column in ("noise_mm", "low_deg", "high_deg"))
    names = np.array([row["estimator"] for row in rows])
    levels, ranges = np.unique(noise_mm), np.unique(np.stack([low_deg, high_deg], axis=-1), axis=0)
    figure = Figure(figsize=(_width_inches(len(levels)), 2.6 * len(ranges) + 0.5))
    grid = figure.subplots(len(ranges), len(levels), squeeze=False, sharex=True, sharey=True)
    panels = []
    for (row, column), axes in np.ndenumerate(grid):
        (low, high), level = ranges[row], levels[column]
        axes.axvline(5, color="#b4bac6", lw=0.9, zorder=0)
        axes.set(title=f"{low:g}–{high:g}°, noise {level:g} mm", xscale="log", xlim=(least_deg, 180))
        axes.xaxis.set_major_formatter(_degrees())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{share:.0%}"))
        cell = (noise_mm == level) & (low_deg == low) & (high_deg == high)
        members = {name: cell & (names == name) for name in estimators(rows)}
        panels.append((axes, {name: mine for name, mine in members.items() if mine.any()}))
    for axes in grid[:, 0]:
        axes.set_ylabel(ylabel)
    for axes in grid[-1]:
        axes.set_xlabel("error")
    return figure, panels


def _width_inches(columns: int) -> float:
    return max(PAGE_INCHES, 3.2 * columns) if columns > 1 else 0.6 * PAGE_INCHES


def _least_deg(error_deg: np.ndarray) -> float:
    """Where a logarithmic axis begins: few errors are smaller, and it never ends in digits that mean nothing."""
    return float(np.clip(np.percentile(error_deg, 3), 0.003, 0.1))


def _cumulate(axes: Axes, error_deg: np.ndarray, **style: Any) -> None:
    """The empirical distribution, of at most 400 points."""
    share = np.linspace(0, 1, min(len(error_deg), 400) + 1)
    at = np.quantile(error_deg, share, method="inverted_cdf")
    axes.step(np.append(at, 180), np.append(share, 1), where="post", **style)


def _loop_axes(axes: Axes, predicted_deg: Sequence[float], true_deg: Sequence[float]) -> tuple[Line2D, Line2D]:
    """Axes ready for a loop of this length, with two empty lines: predicted and true."""
    last = max(len(predicted_deg), len(true_deg), 2) - 1
    axes.set(xlim=(-0.02 * last, 1.02 * last), ylim=(0, 1.08 * max(*predicted_deg, *true_deg, 1.0)), xlabel="images")
    axes.yaxis.set_major_formatter(_degrees())
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    (true,) = axes.plot([], [], color=_TRUE, marker="o", markersize=5, lw=2.8, label="true angle" if true_deg else "_")
    (predicted,) = axes.plot([], [], color=_PREDICTED, marker="o", markersize=3, lw=1.2, ls=DASHES, label="predicted")
    return predicted, true


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """A colour for each estimator: always the same for those of the package, by the alphabet for others."""
    names = list(names)
    others = sorted(set(names) - set(_KNOWN))
    return {name: _KNOWN.get(name) or _SPARE[others.index(name) % len(_SPARE)] for name in names}


def legend(figure: Figure, colours: dict[str, str], more: Sequence[Line2D] = ()) -> None:
    """The estimators' colours by name, above the panels."""
    handles = [Line2D([], [], color=colour, lw=2.5, label=name) for name, colour in colours.items()] + list(more)
    figure.legend(handles=handles, loc="outside upper left", ncols=min(len(handles), 6))


def _plain_decades(axes: Axes) -> None:
    """Degrees at whole decades alone, at least two of them."""
    axes.yaxis.set_major_formatter(_degrees())
    axes.yaxis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.095), max(high, 10.5))


def _degrees() -> FuncFormatter:
    return FuncFormatter(lambda degrees, _: f"{degrees:g}°")


def svg(figure: Figure) -> str:
    """The figure as an SVG data URI."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()
