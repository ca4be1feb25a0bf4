"""Figures of an experiment: an error against something that is varied, and how the errors are spread."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from reorient.reporting.style import PAGE_INCHES, STYLE, colours_of, degrees, legend, width_inches


@dataclass(frozen=True)
class Curve:
    """A line and the band of its intervals."""

    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]


Panels = Mapping[str, Mapping[str, Curve]]
"""By title and estimator."""


def curves(
    panels: Panels,
    xlabel: str,
    ylabel: str,
    unit: str = "°",
    logarithmic: bool = True,
    levels: Mapping[str, float] | None = None,
) -> Figure:
    """One panel a title; ``levels``: dotted lines to compare with, and what they are. A ``unit`` of "" is no degree."""
    colours = colours_of(dict.fromkeys(name for panel in panels.values() for name in panel))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_inches(max(len(panels), 2)), 3.6))
        grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
        for axes, (title, lines) in zip(grid, panels.items(), strict=True):
            for name, curve in lines.items():
                marker = "o" if len(curve.x) <= 12 else None
                axes.fill_between(curve.x, curve.low, curve.high, color=colours[name], alpha=0.15, linewidth=0)
                axes.plot(curve.x, curve.y, color=colours[name], marker=marker, markersize=3)
            for said, level in (levels or {}).items():
                axes.axhline(level, color="#7a808c", lw=1.1, ls=":", zorder=0)
                axes.annotate(
                    said, (0.99, level), xycoords=("axes fraction", "data"), ha="right", va="bottom", size=7.5
                )
            axes.set(title=title, xlabel=xlabel)
            if logarithmic:
                axes.set_yscale("log")
                axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_formatter(
                degrees() if unit == "°" else FuncFormatter(lambda value, _: f"{value:g}{unit}")
            )
        grid[0].set_ylabel(ylabel)
        legend(figure, colours)
    return figure


def histograms(
    panels: Mapping[str, Mapping[str, Sequence[float]]], edges: Float[np.ndarray, " n"], xlabel: str, unit: str = "°"
) -> Figure:
    """Shares in bins, one row an estimator, so that none hides another; the last bin also holds all larger values.

    ``panels``: by title (a column each) and estimator.
    """
    names = list(dict.fromkeys(name for panel in panels.values() for name in panel))
    colours = colours_of(names)
    ticks = degrees() if unit == "°" else FuncFormatter(lambda value, _: f"{value:g}{unit}")
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
            column[-1].xaxis.set_major_formatter(ticks)
    return figure
