"""Figures of an evaluation: the error against the start angle, and its distribution."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from reorient.reporting.rows import estimators, numbers
from reorient.reporting.style import DASHES, STYLE, colours_of, degrees, legend, width_inches
from reorient.runs.run import Row

_FEWEST = 5  # rows of a bin; quartiles of fewer are not drawn


def error_by_angle(rows: Sequence[Row]) -> Figure:
    """Median error (line) and quartiles (band) in bins of the start angle, a panel for each noise."""
    angle_deg, error_deg, noise_mm = (numbers(rows, column) for column in ("angle_deg", "error_deg", "noise_mm"))
    names = np.array([row["estimator"] for row in rows])
    colours = colours_of(estimators(rows))
    levels = np.unique(noise_mm)
    low, high = numbers(rows, "low_deg").min(), numbers(rows, "high_deg").max()
    bins = int(np.clip(len(rows) / len(levels) / len(colours) / 15, 3, 18))
    edges = np.linspace(low, high, bins + 1)
    which = np.clip(np.searchsorted(edges, angle_deg, side="right") - 1, 0, bins - 1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_inches(len(levels)), 3.3))
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
            axes.xaxis.set_major_formatter(degrees())
            axes.yaxis.set_major_formatter(degrees())
        # last, because a limit set on shared axes ends their autoscaling
        panels[0].set_ylim(bottom=max(panels[0].get_ylim()[0], _least_deg(error_deg)))
        panels[0].set_ylabel("error (median, quartiles)")
        legend(figure, colours)
        return figure


def cumulative_errors(rows: Sequence[Row]) -> Figure:
    """Share of pairs with an error below x, dashed: symmetry-aware; panels: range by noise."""
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
        return figure


def error_histograms(rows: Sequence[Row]) -> Figure:
    """Share of pairs in logarithmic bins of the plain error, panels as of ``cumulative_errors``.

    The first bin contains all smaller errors, so that the bars of an estimator add up to all of its pairs.
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
                axes.stairs(share, edges, color=colours[name], lw=1.4, zorder=3)  # above the grid and all fillings
        panels[0][0].set_ylim(bottom=0)
        legend(figure, colours)
        return figure


def _cells(
    rows: Sequence[Row], least_deg: float, ylabel: str
) -> tuple[Figure, list[tuple[Axes, dict[str, np.ndarray]]]]:
    """Panels for each range (down) and noise (across), errors along x, and a mask of the rows of each estimator."""
    noise_mm, low_deg, high_deg = (numbers(rows, column) for column in ("noise_mm", "low_deg", "high_deg"))
    names = np.array([row["estimator"] for row in rows])
    levels, ranges = np.unique(noise_mm), np.unique(np.stack([low_deg, high_deg], axis=-1), axis=0)
    figure = Figure(figsize=(width_inches(len(levels)), 2.6 * len(ranges) + 0.5))
    grid = figure.subplots(len(ranges), len(levels), squeeze=False, sharex=True, sharey=True)
    panels = []
    for (row, column), axes in np.ndenumerate(grid):
        (low, high), level = ranges[row], levels[column]
        axes.axvline(5, color="#b4bac6", lw=0.9, zorder=0)
        axes.set(title=f"{low:g}–{high:g}°, noise {level:g} mm", xscale="log", xlim=(least_deg, 180))
        axes.xaxis.set_major_formatter(degrees())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{share:.0%}"))
        cell = (noise_mm == level) & (low_deg == low) & (high_deg == high)
        members = {name: cell & (names == name) for name in estimators(rows)}
        panels.append((axes, {name: mine for name, mine in members.items() if mine.any()}))
    for axes in grid[:, 0]:
        axes.set_ylabel(ylabel)
    for axes in grid[-1]:
        axes.set_xlabel("error")
    return figure, panels


def _least_deg(error_deg: np.ndarray) -> float:
    """Lower limit of a logarithmic error axis: the 3rd percentile, within [0.003, 0.1] degrees."""
    return float(np.clip(np.percentile(error_deg, 3), 0.003, 0.1))


def _cumulate(axes: Axes, error_deg: np.ndarray, **style: Any) -> None:
    """Draw the empirical distribution with at most 400 points."""
    share = np.linspace(0, 1, min(len(error_deg), 400) + 1)
    at = np.quantile(error_deg, share, method="inverted_cdf")
    axes.step(np.append(at, 180), np.append(share, 1), where="post", **style)
