"""Figures of an experiment: an error against something that is varied, and how the errors are spread."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

from reorient.reporting.figures import PAGE_INCHES, REFERENCE, STYLE, colours_of, legend
from reorient.runs.files import replacing


@dataclass(frozen=True)
class Curve:
    """A line and the band of its intervals."""

    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Panel:
    """Some lines over one pair of axes."""

    title: str
    lines: Mapping[str, Curve]
    """By estimator."""
    ylabel: str
    unit: str = "°"
    """Of the ticks along y."""
    logarithmic: bool = True
    levels: Mapping[str, float] = field(default_factory=dict)
    """Dotted lines to compare with, by what they are."""


def curves(panels: Sequence[Panel], xlabel: str) -> Figure:
    """Panels side by side; those of one kind share their y axis."""
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
        levels = dict.fromkeys(said for panel in panels for said in panel.levels)
        legend(figure, colours, [Line2D([], [], color=REFERENCE, lw=1.1, ls=":", label=said) for said in levels])
    return figure


def _ticks(unit: str) -> FuncFormatter:
    return FuncFormatter(lambda value, _: f"{value:g}{unit}")


def histograms(
    panels: Mapping[str, Mapping[str, Sequence[float]]], edges: Float[np.ndarray, " n"], xlabel: str, unit: str = "°"
) -> Figure:
    """Shares in bins, one row an estimator, so that none hides another; the last bin also holds all larger values.

    ``panels``: by title (a column each) and estimator.
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
                    said = f"{name}: median {np.median(values):.3g}{unit}, last bin {part[-1]:.0%}"
                    axes.annotate(said, (0.99, 0.92), xycoords="axes fraction", ha="right", va="top", size=8.5)
            column[-1].set_xlabel(xlabel)
            column[-1].xaxis.set_major_formatter(_ticks(unit))
    return figure


def write_png(figure: Figure, path: Path) -> None:
    """The figure as a picture, 160 pixels an inch."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=160, metadata={"Software": None})
