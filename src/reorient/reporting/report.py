"""An evaluation as one interactive page: tables, charts whose marks open their pair, the configuration; and figures."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from reorient.errors import ReorientError
from reorient.experiments.evaluation import read_config
from reorient.formatting import FigureFormat
from reorient.reporting import figures, trust
from reorient.reporting.page import part, write_page
from reorient.reporting.pairs import cells_of, pair_data, pairs_data
from reorient.reporting.rows import estimators, numbers, read_rows
from reorient.reporting.scenes import class_data
from reorient.reporting.style import write_figure
from reorient.reporting.tables import OVERLAP, html_table
from reorient.runs.run import Row

MOST_ROWS = 10_000  # in the charts; the tables are of all rows
_PAIR = (
    "The estimates of the table and of the charts open here. Rows have rotations only, so the object rotates about its "
    "own origin."
)


def write_report(folder: str | Path, pairs: int = 200) -> Path:
    """Write ``report.html`` into the folder of an evaluation, with all images inside it; returns its path.

    ``pairs``: how many pairs it shows in 3D, the best and worst ones first. Raises ReorientError for a folder without a
    finished evaluation.
    """
    folder = Path(folder)
    rows, config = read_rows(folder), read_config(folder)
    try:
        embedded, missing = pairs_data(rows, config, pairs), ""
    except ReorientError as error:  # the meshes of an old run can be missing; its numbers are still valid
        embedded, missing = {}, f'<p class="note">no images: {escape(str(error))}</p>'
    sections = {"Results": html_table(rows)}
    if any(row["overlap"] for row in rows):
        sections["By overlap of the views"] = html_table(rows, OVERLAP)
    shown = [rows[k] for k in np.unique(np.linspace(0, len(rows) - 1, MOST_ROWS).astype(int))]
    sections |= {
        "Filter": part("filter"),
        "Charts": part("charts", _charts_note(rows, shown)),
        "Pair": missing + part("pair", _PAIR),
        "Best and worst estimates": part("rows"),
        "Configuration": f"<pre>{escape((folder / 'config.json').read_text(encoding='utf-8'))}</pre>",
    }
    objects = len({row["object"] for row in rows})
    lead = (
        f"{len(rows):,} estimates of the rotation between two depth images: {len(estimators(rows))} estimators, "
        f"{objects:,} objects."
    )
    data = _data(shown, cells_of(rows), rows, embedded, f"reorient report {folder}")
    return write_page(folder / "report.html", "Evaluation of rotation estimators", lead, sections, {"evaluation": data})


def write_pair(folder: str | Path, number: int) -> Path:
    """Write ``pair-NUMBER.html``, the page of one pair, into the folder of an evaluation; returns its path.

    Raises ReorientError as ``write_report``, for a number without a pair, and where its meshes are missing.
    """
    folder = Path(folder)
    rows, config = read_rows(folder), read_config(folder)
    cells = cells_of(rows)
    mine = [row for row, cell in zip(rows, cells, strict=True) if cell == number]
    if not mine:
        raise ReorientError(f"no pair {number} in {str(folder)!r}: expected 0 to {max(cells)}")
    embedded = {str(number): pair_data(mine, config, [row["estimator"] for row in mine])}
    first = mine[0]
    lead = (
        f"Pair {first['pair']} of {first['object']}, {float(first['angle_deg']):.1f} degrees, {first['noise_mm']} mm."
    )
    sections = {"Pair": part("pair", _PAIR), "Filter": part("filter"), "Charts": part("charts")}
    data = _data(mine, cells, rows, embedded, f"reorient report {folder}")
    sections["Estimates"] = part("rows")
    return write_page(folder / f"pair-{number}.html", f"Pair {number}", lead, sections, {"evaluation": data})


def write_figures(folder: str | Path, suffix: FigureFormat) -> list[Path]:
    """Write the figures of an evaluation into its folder, for papers; returns their paths.

    Raises ReorientError as ``write_report``.
    """
    folder = Path(folder)
    rows = read_rows(folder)
    drawn = {
        "error-by-angle": figures.error_by_angle(rows),
        "error-histograms": figures.error_histograms(rows),
        "cumulative-errors": figures.cumulative_errors(rows),
    }
    if sure := trust.confident(rows):
        drawn["confidence"] = trust.figure(sure)
    return [write_figure(figure, folder / f"{name}.{suffix}") for name, figure in drawn.items()]


def _charts_note(rows: Sequence[Row], shown: Sequence[Row]) -> str:
    part_of = "" if len(rows) == len(shown) else f" {len(shown):,} of the {len(rows):,} estimates, evenly spaced."
    return f"Symmetry-aware errors; dotted: 5 degrees, the limit of a correct estimate.{part_of}"


def _data(
    shown: Sequence[Row], cells: Sequence[int], rows: Sequence[Row], embedded: dict[str, Any], command: str
) -> dict[str, Any]:
    """What the page shows, as JSON: the rows in columns, names by number."""
    names = {
        "object": sorted({row["object"] for row in shown}),
        "estimator": estimators(shown),
        "noise": sorted({f"{float(row['noise_mm']):g} mm" for row in shown}),
    }
    number_of = {key: {name: k for k, name in enumerate(known)} for key, known in names.items()}
    cell_of = {id(row): cell for row, cell in zip(rows, cells, strict=True)}
    columns = {
        "object": [number_of["object"][row["object"]] for row in shown],
        "estimator": [number_of["estimator"][row["estimator"]] for row in shown],
        "noise": [number_of["noise"][f"{float(row['noise_mm']):g} mm"] for row in shown],
        "pair": [int(row["pair"]) for row in shown],
        "key": [cell_of[id(row)] for row in shown],
        "message": [row["message"] for row in shown],
        "confidence": [float(row["confidence"]) if row["confidence"] else None for row in shown],
    }
    for key, column in (("angle", "angle_deg"), ("plain", "error_deg"), ("error", "error_sym_deg")):
        columns[key] = np.round(numbers(shown, column), 3).tolist()
    return {
        "columns": columns,
        "names": names,
        "pairs": embedded,
        "classes": class_data(),
        "bins": _reliability(rows, names["estimator"]),
        "command": command,
    }


def _reliability(rows: Sequence[Row], names: Sequence[str]) -> list[list[dict[str, Any]]] | None:
    """The bins of the reliability diagram of each estimator; None where no row has a confidence."""
    sure = trust.confident(rows)
    if not sure:
        return None
    found = []
    for name in names:
        mine = [row for row in sure if row["estimator"] == name]
        bins = trust.reliability(*trust.confidence_and_correct(mine)) if mine else []
        found.append(
            [
                {
                    "low": one.low,
                    "high": one.high,
                    "n": one.n,
                    "confidence": round(one.confidence, 4),
                    "accuracy": one.accuracy,
                    "interval": one.interval,
                }
                for one in bins
            ]
        )
    return found
