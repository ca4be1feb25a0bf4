"""The pairs of an evaluation: made again from their seeds, to be drawn or shown in 3D with every answer."""

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators import load_estimator
from reorient.experiments.evaluation import Evaluation, regenerate
from reorient.imaging import DepthImage
from reorient.plugins import USER_ERRORS
from reorient.reporting.pictures import depth_range, framed, shade
from reorient.reporting.rows import estimators, numbers
from reorient.reporting.scenes import Compared, Hypothesis, at_most, hypothesis_data, image_data
from reorient.runs.run import Row

MOST_BYTES = 1_900_000  # of all pairs of a page
ENDS = 4  # number of best and of worst pairs of an estimator whose alternatives are estimated again
_MAIN = 3  # estimators, the best ones, with such pairs
_LARGEST_PX, _STEPS = 72, 500
_PANEL_PX = 240
_CELL = ("pair", "low_deg", "high_deg", "noise_mm")


def cells_of(rows: Sequence[Row]) -> list[int]:
    """The number of each row's pair; rows of several estimators share one."""
    known: dict[tuple[str, ...], int] = {}
    return [known.setdefault(tuple(row[name] for name in _CELL), len(known)) for row in rows]


def chosen_pairs(rows: Sequence[Row], most: int) -> tuple[dict[int, list[str]], list[int]]:
    """The pairs to show: the best and the worst ones, by number the estimators that they are of; and the others, evenly
    spaced, at most ``most`` in all."""
    cells, errors_deg = np.array(cells_of(rows)), numbers(rows, "error_sym_deg")
    names = np.array([row["estimator"] for row in rows])
    ranked = sorted(estimators(rows), key=lambda name: -np.mean(errors_deg[names == name] < 5))
    ends: dict[int, list[str]] = {}
    for name in ranked[:_MAIN]:
        mine = np.nonzero(names == name)[0]
        order = mine[np.argsort(errors_deg[mine], kind="stable")]
        for indices in (order[::-1], order):
            by_object: dict[str, int] = {}  # one pair of each object
            for index in indices:
                by_object.setdefault(rows[index]["object"], int(cells[index]))
            for cell in list(by_object.values())[:ENDS]:
                ends.setdefault(cell, []).append(name)
    ends = dict(list(ends.items())[:most])
    others = [cell for cell in range(int(cells.max()) + 1) if cell not in ends]
    if len(ends) + len(others) > most:
        at = np.linspace(0, len(others) - 1, most - len(ends)).astype(int)
        others = [others[k] for k in at]
    return ends, others


def pairs_data(rows: Sequence[Row], config: Evaluation, most: int) -> dict[str, Any]:
    """The chosen pairs as JSON, by number, as many as ``MOST_BYTES`` allows.

    Raises ReorientError where the first one cannot be made again: the meshes of an old run can be missing.
    """
    by_cell: dict[int, list[Row]] = {}
    for row, cell in zip(rows, cells_of(rows), strict=True):
        by_cell.setdefault(cell, []).append(row)
    ends, others = chosen_pairs(rows, most)
    found: dict[str, Any] = {}
    size = 0
    for cell in (*ends, *others):
        found[str(cell)] = pair_data(by_cell[cell], config, ends.get(cell, ()))
        size += len(json.dumps(found[str(cell)]))
        if size > MOST_BYTES:
            break
    return found


def pair_data(rows: Sequence[Row], config: Evaluation, again: Iterable[str] = ()) -> dict[str, Any]:
    """One pair as JSON: both images, the truth, the answer of each row; ``again``: estimators whose alternatives are
    estimated anew, unless they are not of the package.

    The rows have rotations only, so the object rotates about its own origin.
    """
    pair, _ = regenerate(config, rows[0])
    current, goal = (at_most(image, _LARGEST_PX) for image in framed([pair.current, pair.goal]))
    compared, center_m = Compared(current, goal), pair.placement.center_m

    def about(label: str, R: Float[np.ndarray, "3 3"], probability: float | None = None) -> Hypothesis:
        return compared.hypothesis(label, R, center_m - R @ center_m, probability)

    hypotheses = [
        hypothesis_data(about(row["estimator"], _answer(row), float(row["confidence"]) if row["confidence"] else None))
        | {"note": f"error {float(row['error_deg']):.2f}°"}
        for row in rows
    ]
    hypotheses.append(hypothesis_data(about("truth", pair.R_goal_current)))
    for name in again:
        with suppress(ReorientError, *USER_ERRORS):
            estimate = load_estimator(name).estimate(pair.current, pair.goal, pair.pivot_m if config.pivot else None)
            hypotheses += [
                hypothesis_data(about(f"{name}, alternative {number}", R, probability))
                for number, (R, probability) in enumerate(estimate.alternatives, start=1)
            ]
    return {"current": image_data(current, _STEPS), "goal": image_data(goal, _STEPS), "hypotheses": hypotheses}


def three_panels(row: Row, config: Evaluation) -> list[Image.Image]:
    """Start, goal, and the start rotated by a row's estimate, rendered exactly from the mesh.

    Raises ReorientError if the meshes are missing.
    """
    pair, renderer = regenerate(config, row)
    camera = pair.goal.camera
    rotated = DepthImage(renderer.depth(camera, _answer(row) @ pair.R_camera_object, pair.placement), camera)
    images = framed([pair.current, pair.goal, rotated])
    return [shade(image, _PANEL_PX, depth_range(images)) for image in images]


def _answer(row: Row) -> Float[np.ndarray, "3 3"]:
    """The rotation of a row."""
    return so3.matrix_from_quat(so3.normalize(np.array([float(row[name]) for name in ("qw", "qx", "qy", "qz")])))
