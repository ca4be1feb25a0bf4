"""The common style of all figures: fonts, lines, one colour for each estimator, SVG data URIs."""

import base64
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

from reorient.runs.files import replacing

# the palette of Okabe and Ito, which colour-blind people can distinguish
_KNOWN = {"paper": "#cc79a7", "icp": "#56b4e9", "gicp": "#0072b2", "swift": "#009e73", "default": "#d55e00"}
_KNOWN["rotation-search"] = _KNOWN["default"]
_SPARE = ("#e69f00", "#000000", "#8a6d00", "#5b6270", "#8b2e62", "#004a75")
DASHES = (0, (3, 2))
REFERENCE = "#7a808c"
PAGE_INCHES = 10.6
STYLE: Any = {  # matplotlib types the keys as literals, which no plain dict satisfies
    "font.size": 9.0,
    "text.parse_math": False,  # a dollar sign in a name is one
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
    "svg.fonttype": "none",  # text stays text
    "pdf.fonttype": 42,  # TrueType, as journals ask
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


def write_figure(figure: Figure, path: Path) -> Path:
    """Write a figure in the common style, in the format of the suffix (PNG: 160 pixels per inch); returns its path.

    Raises ReorientError where it cannot be written.
    """
    kind = path.suffix.removeprefix(".")
    nothing = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}  # the same bytes
    with replacing(path) as temporary, mpl.rc_context(STYLE):
        figure.savefig(temporary, format=kind, dpi=160, metadata=nothing[kind])
    return path
