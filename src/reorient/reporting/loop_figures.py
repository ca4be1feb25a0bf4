"""Figures of closed loops: the course of one, and the errors of many at each image and by object."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from reorient.reporting.style import (
    DASHES,
    PAGE_INCHES,
    REFERENCE,
    STYLE,
    colours_of,
    degrees,
    plain_decades,
    width_inches,
)

_TRUE, _PREDICTED = "#56b4e9", "#e69f00"  # of Okabe and Ito, on dark

Panels = Mapping[str, Mapping[str, Sequence[Sequence[float]]]]
"""By title and system, lists of errors in degrees."""


def loop_curve(predicted_deg: Sequence[float], true_deg: Sequence[float]) -> Figure:
    """Remaining angle at each image of a loop, predicted and (where known) true."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_INCHES, 3.2))
        axes = figure.subplots()
        for line, values in zip(_loop_axes(axes, predicted_deg, true_deg), (predicted_deg, true_deg), strict=True):
            line.set_data(range(len(values)), values)
        axes.legend()
        return figure


def error_by_image(panels: Panels, reference_deg: float, reference: str) -> Figure:
    """Median and quartiles of the true error at each image of many loops, a panel for each title.

    A loop that has ended keeps its last error. ``reference_deg``: a level to compare with, named in the legend.
    """
    styles = _line_styles(panels)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width_inches(max(len(panels), 2)), 3.3))
        grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
        for axes, (title, systems) in zip(grid, panels.items(), strict=True):
            axes.axhline(reference_deg, color=REFERENCE, lw=1.2, ls=":", zorder=0)
            for system, loops in systems.items():
                last = max(len(errors) for errors in loops)
                whole = np.array([[*errors, *[errors[-1]] * (last - len(errors))] for errors in loops])
                first, median, third = np.percentile(whole, [25, 50, 75], axis=0)
                axes.fill_between(range(last), first, third, color=styles[system]["color"], alpha=0.13, linewidth=0)
                axes.plot(range(last), median, **styles[system])
            axes.set(title=title, xlabel="images", yscale="log")
            axes.xaxis.set_major_locator(MaxNLocator(7, integer=True))
            plain_decades(axes)
        grid[0].set_ylabel("error (median, quartiles)")
        _legend(figure, styles, reference)
        return figure


def errors_by_object(panels: Panels, names: Sequence[str], reference_deg: float, reference: str) -> Figure:
    """Final errors of all loops by object, the median as a bar.

    ``panels``: by title and system, for each name the final errors.
    """
    styles = _line_styles(panels)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(PAGE_INCHES, 2.9 * len(panels) + 0.6))
        grid = figure.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
        for axes, (title, systems) in zip(grid, panels.items(), strict=True):
            axes.axhline(reference_deg, color=REFERENCE, lw=1.2, ls=":", zorder=0)
            for index, (system, errors) in enumerate(systems.items()):
                middle = (index + 0.5) / len(systems) * 0.7 - 0.35
                colour, hollow = styles[system]["color"], "ls" in styles[system]
                for place, values in enumerate(errors):
                    spread = (np.arange(len(values)) - (len(values) - 1) / 2) * 0.04 / len(systems)
                    fill = "none" if hollow else colour
                    axes.scatter(place + middle + spread, values, s=16, facecolors=fill, edgecolors=colour, lw=0.9)
                    if len(values):
                        axes.hlines(np.median(values), place + middle - 0.12, place + middle + 0.12, color=colour, lw=2)
            axes.set(title=title, yscale="log", ylabel="final error")
            plain_decades(axes)
        grid[-1].set_xticks(range(len(names)), names)
        _legend(figure, styles, reference)
        return figure


def _line_styles(panels: Panels) -> dict[str, dict[str, Any]]:
    """Line style of each system "estimator/strategy": the estimator's colour, dashed from its second strategy on."""
    systems = list(dict.fromkeys(system for panel in panels.values() for system in panel))
    colours = colours_of(dict.fromkeys(system.split("/")[0] for system in systems))
    styles: dict[str, dict[str, Any]] = {}
    for system in systems:
        estimator = system.split("/")[0]
        again = any(other.split("/")[0] == estimator for other in styles)
        styles[system] = {"color": colours[estimator]} | ({"ls": DASHES} if again else {})
    return styles


def _legend(figure: Figure, styles: dict[str, dict[str, Any]], reference: str) -> None:
    handles = [Line2D([], [], **style, label=system) for system, style in styles.items()]
    handles.append(Line2D([], [], color=REFERENCE, lw=1.2, ls=":", label=reference))
    figure.legend(handles=handles, loc="outside upper left", ncols=min(len(handles), 5))


def _loop_axes(axes: Axes, predicted_deg: Sequence[float], true_deg: Sequence[float]) -> tuple[Line2D, Line2D]:
    """Prepare axes for a loop of this length; two empty lines, predicted and true."""
    last = max(len(predicted_deg), len(true_deg), 2) - 1
    axes.set(xlim=(-0.02 * last, 1.02 * last), ylim=(0, 1.08 * max(*predicted_deg, *true_deg, 1.0)), xlabel="images")
    axes.yaxis.set_major_formatter(degrees())
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    (true,) = axes.plot([], [], color=_TRUE, marker="o", markersize=5, lw=2.8, label="true angle" if true_deg else "_")
    (predicted,) = axes.plot([], [], color=_PREDICTED, marker="o", markersize=3, lw=1.2, ls=DASHES, label="predicted")
    return predicted, true
