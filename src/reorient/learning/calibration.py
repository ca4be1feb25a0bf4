"""Calibration of confidence sets and covariances, on generated objects that the verifier was not trained on.

A resumable run (``reorient.runs``) with a row for each estimate; ``fit`` makes the package's ``calibration.json`` of
its rows.
"""

import csv
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError, check_range
from reorient.estimators import load_estimator
from reorient.estimators.base import RotationEstimate
from reorient.estimators.calibration import Calibration, load_calibration
from reorient.estimators.confidence_sets import group_of
from reorient.estimators.views_verifier import fingerprint
from reorient.learning.verifier import RIGHT_DEG
from reorient.learning.verifier_data import Sample, VerifierData, samples
from reorient.registration import DepthView
from reorient.runs.files import replacing
from reorient.runs.pool import Pool
from reorient.runs.run import Progress, Row, RowStore, Tables, resumable
from reorient.world.goals import ALL_ROUND
from reorient.world.objects import ObjectSource
from reorient.world.rendering import Renderer
from reorient.world.symmetry import SymmetryGroup, nearest_equivalent, rotation_group, symmetric_error

LEVELS = (0.68, 0.95)
WITHIN = (3.506, 7.815)  # quantiles of chi-squared with three degrees of freedom at these levels
SCALES, FLOORS_RAD = np.geomspace(0.02, 50, 80), np.radians([0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.3])
NOISE_MM = (0.1, 1.01)  # separates the rows between which the coverage of a covariance is balanced


@dataclass(frozen=True)
class CalibrationData:
    """Estimates to make: pairs of the preset benchmark with exact intrinsics, a nominal pivot given to 60% of them."""

    objects: ObjectSource = field(default_factory=lambda: ObjectSource(count=500, object_seed=61))
    """Objects of the pairs: others than the verifier was trained on."""
    pairs: int = 4
    """Number of pairs of each object."""
    most_noise_mm: float = 3.0
    """Largest depth noise: a quarter of the pairs has none, half up to 1 mm, the rest up to this."""
    goal_views: tuple[int, ...] = (1,)
    """Numbers of goal views, of which each pair has one at random."""
    seed: int = 0
    """Seed of the pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "pairs", low=1)
        check_range(self, "goal_views", low=1, high=ALL_ROUND)
        check_range(self, "seed", "most_noise_mm")

    @property
    def pairs_of_objects(self) -> VerifierData:
        """The same as data for the verifier, whose pairs these are."""
        return VerifierData(
            self.objects,
            pairs=self.pairs,
            most_noise_mm=self.most_noise_mm,
            most_wrong_focal=0.0,
            goal_views=self.goal_views,
            seed=self.seed,
        )


def measure(config: CalibrationData, out: Path, pool: Pool | None = None) -> Progress:
    """Run; yields (objects done, objects in all). The rows are in ``out/rows.csv.gz`` when it ends.

    Raises ReorientError as ``resumable``.
    """
    tasks = {name: (config, number, name) for number, name in enumerate(config.objects.open().names)}
    yield from resumable(
        out, config, tasks, _measure_object, RowStore(), pool, verifiers=[fingerprint(), fingerprint(several=True)]
    )


def _measure_object(task: tuple[CalibrationData, int, str]) -> Tables:
    """A row for each estimate of an object."""
    config, number, name = task
    try:
        renderer = Renderer(config.objects.open().load(name))
    except ReorientError:
        return {"rows": []}
    group, estimator = rotation_group(renderer.mesh), load_estimator("default")
    found = samples(config.pairs_of_objects, renderer, number)
    return {"rows": [_row(name, group, x, estimator.estimate(x.current, x.goal, x.pivot_m)) for _, x in found]}


def _row(name: str, group: SymmetryGroup, sample: Sample, estimate: RotationEstimate) -> Row:
    pair, views = sample.pair, (sample.current, sample.goal.image, *(x.image for x in sample.goal.views))

    def error_deg(R: Float[np.ndarray, "3 3"]) -> float:
        return float(np.degrees(symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object)))

    true = nearest_equivalent(group, estimate.R_goal_current, pair.R_goal_current, pair.R_camera_object)
    truth = [x.probability for x in estimate.candidates if error_deg(x.R_goal_current) < RIGHT_DEG]
    return {
        "object": name,
        "low_deg": f"{sample.low_deg:g}",
        "noise_mm": f"{1000 * sample.noise_m:.3f}",
        "pivot": str(int(sample.pivot_m is not None)),
        "views": str(len(views) - 1),
        "noise": f"{estimate.evidence.residual_m / max(DepthView(x).diameter_m for x in views):.6f}",
        "confidence": f"{estimate.confidence:.5f}",
        "found": f"{sum(x.probability for x in estimate.candidates):.5f}",
        "truth": f"{max(truth, default=0.0):.5f}",
        "candidates": str(len(estimate.candidates)),
        "error_deg": f"{error_deg(estimate.R_goal_current):.5f}",
        "rotvec_rad": "" if true is None else _numbers(so3.log(true @ estimate.R_goal_current.T)),
        "covariance_rad2": _numbers(np.asarray(estimate.covariance_rad2).ravel()),
    }


def _numbers(values: Float[np.ndarray, " n"]) -> str:
    return " ".join(f"{x:.6g}" for x in values)


# --- fitting --------------------------------------------------------------------------------------------------------


def read(folder: Path) -> list[Row]:
    """The rows of a finished run. Raises ReorientError where there are none."""
    try:
        with gzip.open(folder / "rows.csv.gz", "rt", encoding="utf-8", newline="") as text:
            return list(csv.DictReader(text))
    except OSError as error:
        raise ReorientError(
            f"no rows in {str(folder)!r}: expected the folder of `reorient verifier calibrate`"
        ) from error


def fit(rows: Sequence[Row], out: Path | None = None, present: Calibration | None = None) -> dict[str, float]:
    """Write the calibration (.json) that rows give, unless ``out`` is None; returns its figures by name.

    ``present``: the calibration with which the rows were made; None: the package's.
    """
    present = present or load_calibration()
    truth: dict[str, list[float]] = {}
    for row in rows:
        group = group_of(int(row["views"]), float(row["noise"]), float(row["found"]))
        truth.setdefault(group, []).append(np.floor(1e4 * float(row["truth"])) / 1e4)
    scale, floor_rad, coverage = fitted_covariance(rows, present)
    document = {
        "verifiers": [fingerprint(), fingerprint(several=True)],
        "scale": round(scale, 4),
        "floor_rad": round(floor_rad, 6),
        "truth": {name: sorted(truth[name]) for name in sorted(truth)},
    }
    if out is not None:
        with replacing(out) as temporary:
            temporary.write_text(json.dumps(document).replace("], ", "],\n") + "\n", encoding="utf-8")
    shares = {
        f"{name}: truth among the candidates, of {len(x)}": float(np.count_nonzero(x)) / len(x)
        for name, x in sorted(truth.items())
    }
    return {"estimates": len(rows), "scale": scale, "floor in degrees": np.degrees(floor_rad)} | coverage | shares


def fitted_covariance(rows: Sequence[Row], present: Calibration) -> tuple[float, float, dict[str, float]]:
    """Scale and floor with which the ellipsoids of right answers hold the truth as often as they state, whatever the
    noise: the squared deviations over levels and ranges of noise are least. And their coverage by name."""
    used = [row for row in rows if row["rotvec_rad"] and float(row["error_deg"]) < RIGHT_DEG]
    if not used:
        raise ReorientError("no right answer with an unambiguous rotation: expected more pairs")
    rotvec = np.array([row["rotvec_rad"].split() for row in used], float)
    stated = np.array([row["covariance_rad2"].split() for row in used], float).reshape(-1, 3, 3)
    shape = (stated - present.floor_rad**2 * np.eye(3)) / present.scale
    noise = np.searchsorted(NOISE_MM, [float(row["noise_mm"]) for row in used])

    def coverage(scale: float, floor_rad: float) -> dict[str, float]:
        covariance = scale * shape + (floor_rad**2 + 1e-12) * np.eye(3)
        distance2 = np.einsum("ni,ni->n", rotvec, np.linalg.solve(covariance, rotvec[..., None])[..., 0])
        return {
            f"within {level:.0%}, noise {kind} ({np.count_nonzero(noise == kind)} answers)": float(
                np.mean(distance2[noise == kind] <= within)
            )
            for kind in np.unique(noise)
            for level, within in zip(LEVELS, WITHIN, strict=True)
        }

    def deviation(settings: tuple[float, float]) -> float:
        return sum(abs(x - LEVELS[k % 2]) ** 2 for k, x in enumerate(coverage(*settings).values()))

    best = min(((float(s), float(f)) for s in SCALES for f in FLOORS_RAD), key=deviation)
    return *best, coverage(*best)
