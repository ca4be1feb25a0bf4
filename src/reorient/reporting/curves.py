"""Figures of an experiment: an error against a varied parameter, and the distribution of errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

from reorient.reporting.style import PAGE_INCHES, REFERENCE, STYLE, colours_of, legend


@dataclass(frozen=True)
class Curve:
    """A line and its interval band."""

    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Panel:
    """Several lines on one pair of axes."""

    title: str
    lines: Mapping[str, Curve]
    """Curves by estimator."""
    ylabel: str
    unit: str = "°"
    """Unit of the tick labels along y."""
    logarithmic: bool = True
    levels: Mapping[str, float] = field(default_factory=dict)
    """Reference levels, drawn as dotted lines, by label."""


def curves(panels: Sequence[Panel], xlabel: str) -> Figure:
    """Panels side by side, with a common y axis if all show the same quantity."""
    colours = colours_of(dict.fromkeys(name for panel in panels for name in panel.lines))
    alike = len({(panel.ylabel, panel.logarithmic) for panel in panels}) == 1
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_INCHES, 3.6))
        grid = figure.subplots(1, len(panels), squeeze=False, sharey=alike)[0]
        for axes, panel in zip(grid, panels, strict=True):
            for name, curve in panel.lines.items():
                marker = "o" if len(curve.x) <= 12 else None
                axes.fill_between(curve.x, curve.low, curve.high, color=colours[name], alpha=0.12, linewidth=0)
                axes.plot(curve.x, curve.y, color=colours[name], marker=marker, markersize=3)
            for level in panel.levels.values():
                axes.axhline(level, color=REFERENCE, lw=1.1, ls=":", zorder=0)
            axes.set(title=panel.title, xlabel=xlabel)
            if panel.logarithmic:
                axes.set_yscale("log")
                axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_formatter(_ticks(panel.unit))
            if axes is grid[0] or not alike:
                axes.set_ylabel(panel.ylabel)
        levels = dict.fromkeys(label for panel in panels for label in panel.levels)
        legend(figure, colours, [Line2D([], [], color=REFERENCE, lw=1.1, ls=":", label=label) for label in levels])
    return figure


def _ticks(unit: str) -> FuncFormatter:
    return FuncFormatter(lambda value, _: f"{value:g}{unit}")


def histograms(
    panels: Mapping[str, Mapping[str, Sequence[float]]], edges: Float[np.ndarray, " n"], xlabel: str, unit: str = "°"
) -> Figure:
    """Shares in bins, one row per estimator; the last bin contains all larger values.

    ``panels``: values by title (one column each) and estimator.
    """
    names = list(dict.fromkeys(name for panel in panels.values() for name in panel))
    colours = colours_of(names)
    with mpl.rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(PAGE_INCHES, 0.85 * len(names) + 0.9))
        grid = figure.subplots(len(names), len(panels), squeeze=False, sharex=True)
        for column, (title, spread) in zip(grid.T, panels.items(), strict=True):
            column[0].set_title(title)
            for axes, name in zip(column, names, strict=True):
                values = np.asarray(spread.get(name, ()), float)
                count, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
                part = count / max(count.sum(), 1)
                axes.stairs(part, edges, fill=True, color=colours[name], alpha=0.55)
                axes.set(xlim=(edges[0], edges[-1]), yticks=[])
                axes.spines["left"].set_visible(False)
                if len(values):
                    text = f"{name}: median {np.median(values):.3g}{unit}, last bin {part[-1]:.0%}"
                    axes.annotate(text, (0.99, 0.92), xycoords="axes fraction", ha="right", va="top", size=8.5)
            column[-1].set_xlabel(xlabel)
            column[-1].xaxis.set_major_formatter(_ticks(unit))
    return figure
