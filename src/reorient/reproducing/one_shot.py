"""What the figures of single estimates share: rows by label, their curves and their page."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.formatting import FigureFormat
from reorient.reporting import page
from reorient.reporting.curves import Curve, Panel, curves
from reorient.reporting.page import inline_image
from reorient.reporting.rows import estimators, numbers, read_rows
from reorient.reporting.style import svg, write_figure
from reorient.reproducing.findings import Finding, html_findings, interval, number
from reorient.reproducing.networks import Network
from reorient.reproducing.setting import Setting
from reorient.runs.run import Row
from reorient.world.objects import ObjectSource

NOTHING, RELEASED = (f"reorient.reproducing.baselines:{name}" for name in ("Nothing", "ReleasedICP"))
LABELS = {NOTHING: "no rotation", RELEASED: "icp as released (broken)"}
BINS = 6  # of the angle


def measure_pairs(setting: Setting, folder: Path, objects: ObjectSource, names: Sequence[str], pairs: int) -> None:
    """Raw rows of the estimators ``names``: the world of the paper's simulator, 0 to 30 degrees, no noise, no pivot."""
    config = Evaluation(
        objects, tuple(names), "paper", ((0, 30),), (0.0,), setting.part(pairs), seed=setting.seed
    )  # fmt: skip
    setting.progress(folder.name, evaluate(config, folder, setting.pool))


def labelled(folder: Path, networks: Sequence[Network] = ()) -> list[Row]:
    """The rows of a folder; estimators by the names that tables and figures use."""
    known = LABELS | {network.name: network.label for network in networks}
    rows = read_rows(folder)
    for row in rows:
        name = row["estimator"]
        row["estimator"] = known.get(Path(name).stem if name.endswith(".onnx") else name, name)
    return rows


def of(rows: Sequence[Row], estimator: str) -> list[Row]:
    """The rows of one estimator."""
    return [row for row in rows if row["estimator"] == estimator]


def objects_of(rows: Sequence[Row]) -> list[str]:
    """The object of each row."""
    return [row["object"] for row in rows]


def mean_errors(
    rows: Sequence[Row], of_what: str, paper: Mapping[str, str], differs: Mapping[str, str]
) -> list[Finding]:
    """The mean error of each estimator, plain and symmetry-aware."""
    found = []
    for name in estimators(rows):
        mine = of(rows, name)
        plain, aware = (numbers(mine, column) for column in ("error_deg", "error_sym_deg"))
        words, groups = f"{of_what}, {name}", objects_of(mine)
        known, but = paper.get(name, ""), differs.get(name, "")
        found.append(number(f"{words}: mean error", plain, groups, paper=known, differs=but))
        found.append(number(f"{words}: symmetry-aware mean", aware, groups))
    return found


def mean_difference(rows: Sequence[Row], what: str, one: str, other: str, paper: str = "") -> Finding:
    """The mean error of one estimator less that of another, pair by pair."""
    mine, others = of(rows, one), of(rows, other)
    gain = numbers(mine, "error_deg") - numbers(others, "error_deg")
    return number(what, gain, objects_of(mine), paper=paper, differs="the same pairs for both")


def against_angle(rows: Sequence[Row], column: str = "error_deg") -> dict[str, Curve]:
    """The mean of a column in bins of the angle between start and goal, with its interval, by estimator."""
    drawn = {}
    for name in estimators(rows):
        mine = of(rows, name)
        angle_deg, values, groups = numbers(mine, "angle_deg"), numbers(mine, column), np.array(objects_of(mine))
        edges = np.linspace(float(mine[0]["low_deg"]), float(mine[0]["high_deg"]), BINS + 1)
        which = np.clip(np.searchsorted(edges, angle_deg, side="right") - 1, 0, BINS - 1)
        bins = [b for b in range(BINS) if np.any(which == b)]
        means = [np.mean(values[which == b]) for b in bins]
        ends = [interval(values[which == b], groups[which == b].tolist()) for b in bins]
        middles = (edges[bins] + edges[np.add(bins, 1)]) / 2
        drawn[name] = Curve(middles, np.array(means), *np.array(ends).T)
    return drawn


def angle_figure(panels: Mapping[str, Sequence[Row]], levels: Mapping[str, float]) -> Figure:
    """Mean error against angle, a panel for each set of rows."""
    ylabel = "mean error (95% interval)"
    drawn = [Panel(title, against_angle(rows), ylabel, levels=levels) for title, rows in panels.items()]
    return curves(drawn, "angle between start and goal")


def write_page(
    folder: Path,
    title: str,
    lead: str,
    findings: Sequence[Finding],
    figures: Mapping[str, tuple[Figure, str]],
    more: Mapping[str, str] | None = None,
    suffix: FigureFormat = "png",
) -> list[Path]:
    """``report.html`` and a file for each figure (by heading, with its caption); returns what was written.

    ``more``: sections of HTML above the figures; ``suffix``: the format of the files.
    """
    written = []
    sections = dict(more or {})
    for heading, (figure, caption) in figures.items():
        written.append(write_figure(figure, folder / f"{heading.lower().replace(' ', '-')}.{suffix}"))
        sections[heading] = inline_image(svg(figure), heading, caption)
    sections["Numbers"] = html_findings(findings)
    return [*written, page.write_page(folder / "report.html", title, lead, sections)]
