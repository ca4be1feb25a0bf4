"""What all figures share: type and colours, a colour for an estimator, and the ways to write a figure down."""

import base64
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from reorient.files import replacing

_KNOWN = {"paper": "#cc5a71", "icp": "#8d99ae", "gicp": "#2f6db5", "swift": "#1d9a6c", "default": "#e08e1b"}
_SPARE = ("#7b5ea7", "#17a2b8", "#a0522d", "#e377c2", "#6b7f1f", "#444b59")
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


def width_inches(columns: int) -> float:
    """Of a figure with so many panels side by side."""
    return max(PAGE_INCHES, 3.2 * columns) if columns > 1 else 0.6 * PAGE_INCHES


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """A colour for each estimator: always the same for those of the package, by the alphabet for others."""
    names = list(names)
    others = sorted(set(names) - set(_KNOWN))
    return {name: _KNOWN.get(name) or _SPARE[others.index(name) % len(_SPARE)] for name in names}


def legend(figure: Figure, colours: dict[str, str], more: Sequence[Line2D] = ()) -> None:
    """One line above the panels: a name for each colour."""
    handles = [Line2D([], [], color=colour, lw=2.5, label=name) for name, colour in colours.items()] + list(more)
    figure.legend(handles=handles, loc="outside upper left", ncols=min(len(handles), 6))


def degrees() -> FuncFormatter:
    """Ticks in degrees, without needless digits."""
    return FuncFormatter(lambda degrees, _: f"{degrees:g}°")


def svg(figure: Figure) -> str:
    """The figure as an address that an HTML page can carry within itself."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()


def write_png(figure: Figure, path: Path) -> None:
    """The figure as a picture of twice the page's width in pixels."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=160, metadata={"Software": None})
