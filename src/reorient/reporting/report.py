"""An evaluation as one page: table, figures, the best and the worst pairs, the configuration."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from reorient import so3
from reorient.errors import ReorientError
from reorient.experiments.evaluation import Evaluation, read_config, regenerate
from reorient.imaging import DepthImage
from reorient.reporting import figures, trust
from reorient.reporting.page import inline_image, page
from reorient.reporting.pictures import depth_range, framed, montage, png_data_uri, shade
from reorient.reporting.rows import estimators, numbers, read_rows
from reorient.reporting.style import svg
from reorient.reporting.tables import OVERLAP, html_table
from reorient.runs.files import replacing
from reorient.runs.run import Row

_MAIN = 3  # number of estimators whose pairs are shown
_SHOWN = 4  # number of best and of worst pairs shown
_PANEL_PX = 240
_BY_ANGLE = "Plain error in bins of the start angle; bins of fewer than five pairs are left out."
_HISTOGRAMS = "Plain error in logarithmic bins, with a line at 5°; the first bin contains all smaller errors."
_TRUST = (
    "Left: the share of pairs within 5° (symmetry-aware) against the confidence, by tenths, with Wilson's 95% "
    "interval; larger dots have more pairs. Right: the share of errors above 5° among the most confident estimates; "
    "dotted: if the correct ones were the most confident."
)
_CUMULATIVE = "The line at 5° marks the share given in the table. Dashed: symmetry-aware error."


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` into the folder of an evaluation, with all images inside it; returns its path.

    Raises ReorientError for a folder without a finished evaluation.
    """
    folder = Path(folder)
    rows, config = read_rows(folder), read_config(folder)
    objects = len({row["object"] for row in rows})
    sections = {"Results": html_table(rows)}
    if any(row["overlap"] for row in rows):
        sections["By overlap of the views"] = html_table(rows, OVERLAP)
    if sure := trust.confident(rows):
        chart = _chart(trust.figure(sure), "reliability, risk and coverage", _TRUST)
        sections["Calibration of the confidence"] = chart
    sections |= {
        "Error against angle": _chart(figures.error_by_angle(rows), "error against the start angle", _BY_ANGLE),
        "Error histograms": _chart(figures.error_histograms(rows), "histograms of the error", _HISTOGRAMS),
        "Cumulative errors": _chart(figures.cumulative_errors(rows), "share of pairs below an error", _CUMULATIVE),
        "Best and worst pairs": _pairs(rows, config),
        "Configuration": f"<pre>{escape((folder / 'config.json').read_text())}</pre>",
    }
    lead = (
        f"{len(rows):,} estimates of the rotation between two depth images: {len(estimators(rows))} estimators, "
        f"{objects:,} objects."
    )
    path = folder / "report.html"
    with replacing(path) as temporary:
        temporary.write_text(page("Evaluation of rotation estimators", lead, sections), encoding="utf-8")
    return path


def _chart(figure: Figure, alt: str, caption: str) -> str:
    return inline_image(svg(figure), alt, caption)


def _pairs(rows: Sequence[Row], config: Evaluation) -> str:
    """Cards of the pairs with the smallest and the largest symmetry-aware error, for the best few estimators."""
    errors_deg = numbers(rows, "error_sym_deg")
    names = np.array([row["estimator"] for row in rows])
    ranked = sorted(estimators(rows), key=lambda name: -np.mean(errors_deg[names == name] < 5))
    parts = []
    for name in ranked[:_MAIN]:
        mine = np.nonzero(names == name)[0]
        order = mine[np.argsort(errors_deg[mine], kind="stable")]
        for title, indices in (("worst", order[::-1]), ("best", order)):
            by_object: dict[str, Row] = {}  # one pair of each object
            for index in indices:
                by_object.setdefault(rows[index]["object"], rows[index])
            cards = [_card(row, config) for row in list(by_object.values())[:_SHOWN]]
            parts.append(f'<h3>{escape(name)}: {title}</h3><div class="cards">{"".join(cards)}</div>')
    return (
        "<p class=note>By symmetry-aware error, one pair of each object. Third panel: the object in its start "
        "orientation rotated by the estimate, rendered exactly from the mesh. It should equal the goal.</p>"
        + "".join(parts)
    )


def _card(row: Row, config: Evaluation) -> str:
    caption = (
        f"<b>error {float(row['error_deg']):.2f}°</b> ({float(row['error_sym_deg']):.2f}° symmetry-aware) at "
        f"{float(row['angle_deg']):.1f}°, noise {float(row['noise_mm']):g} mm<br>"
        f"{escape(row['object'])}, pair {escape(row['pair'])}"
    )
    if row["message"]:
        caption += f"<br>refused: {escape(row['message'])}"
    try:
        panels = three_panels(row, config)
    except ReorientError as error:  # the meshes of an old run can be missing; its numbers are still valid
        return f"<figure><figcaption>{caption}<br>no picture: {escape(str(error))}</figcaption></figure>"
    picture = montage(panels, 3, ["start", "goal", "start rotated"])
    return inline_image(png_data_uri(picture), f"start, goal and estimate of {row['object']}", caption, dark=True)


def three_panels(row: Row, config: Evaluation) -> list[Image.Image]:
    """Start, goal, and the start rotated by a row's estimate, rendered exactly from the mesh.

    Raises ReorientError if the meshes are missing.
    """
    pair, renderer = regenerate(config, row)
    R_est = so3.matrix_from_quat(so3.normalize(np.array([float(row[name]) for name in ("qw", "qx", "qy", "qz")])))
    camera = pair.goal.camera
    rotated = DepthImage(renderer.depth(camera, R_est @ pair.R_camera_object, pair.placement), camera)
    images = framed([pair.current, pair.goal, rotated])
    return [shade(image, _PANEL_PX, depth_range(images)) for image in images]
