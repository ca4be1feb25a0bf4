"""The common style of all figures: fonts, lines, one colour for each estimator, SVG data URIs."""

import base64
import io
from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

_KNOWN = {"paper": "#cc5a71", "icp": "#8d99ae", "gicp": "#2f6db5", "swift": "#1d9a6c", "default": "#e08e1b"}
_KNOWN["rotation-search"] = _KNOWN["default"]
_SPARE = ("#7b5ea7", "#17a2b8", "#a0522d", "#e377c2", "#6b7f1f", "#444b59")
DASHES = (0, (3, 2))
REFERENCE = "#7a808c"
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


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """A colour for each estimator: fixed for those of the package, in alphabetical order for others."""
    names = list(names)
    others = sorted(set(names) - set(_KNOWN))
    return {name: _KNOWN.get(name) or _SPARE[others.index(name) % len(_SPARE)] for name in names}


def legend(figure: Figure, colours: dict[str, str], more: Sequence[Line2D] = ()) -> None:
    """The estimators' colours by name, above the panels."""
    handles = [Line2D([], [], color=colour, lw=2.5, label=name) for name, colour in colours.items()] + list(more)
    figure.legend(handles=handles, loc="outside upper left", ncols=min(len(handles), 6))


def plain_decades(axes: Axes) -> None:
    """Label the y axis in degrees at whole decades only, at least two of them."""
    axes.yaxis.set_major_formatter(degrees())
    axes.yaxis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.095), max(high, 10.5))


def degrees() -> FuncFormatter:
    """Tick labels in degrees."""
    return FuncFormatter(lambda value, _: f"{value:g}°")


def width_inches(columns: int) -> float:
    """Width of a figure with this many panels side by side."""
    return max(PAGE_INCHES, 3.2 * columns) if columns > 1 else 0.6 * PAGE_INCHES


def svg(figure: Figure) -> str:
    """The figure as an SVG data URI."""
    buffer = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()
