"""Calibration of sets and covariances, on a few objects and on rows with known errors."""

import numpy as np
import pytest

from reorient.cli import main
from reorient.errors import ReorientError
from reorient.estimators.calibration import Calibration, load_calibration
from reorient.estimators.views_verifier import fingerprint
from reorient.learning.calibration import CalibrationData, fit, fitted_covariance, measure, read
from reorient.world.objects import ObjectSource


def test_calibrate_writes_what_the_estimator_reads(tmp_path, capsys):
    out = tmp_path / "calibration.json"
    options = ["--count", "2", "--pairs", "2", "--most-noise-mm", "0.5", "--write", str(out)]
    assert main(["verifier", "calibrate", str(tmp_path / "run"), *options]) in (0, None)
    made = load_calibration(out)
    assert made.verifiers[0] == fingerprint()
    assert sum(len(x) for x in made.truth.values()) == len(read(tmp_path / "run")) == 4
    assert made.scale > 0
    assert "estimates: 4" in capsys.readouterr().out
    again = tmp_path / "again"
    list(measure(CalibrationData(ObjectSource(count=2, object_seed=61), pairs=2, most_noise_mm=0.5), again))
    assert read(again) == read(tmp_path / "run")


def rows_of(rng, scale, floor_rad, count=900):
    """Rows whose errors are normal with ``scale * shape + floor^2``; the estimates state the shape alone."""
    for k in range(count):
        shape = np.diag(rng.uniform(0.2, 3, 3) * 1e-5) * (1, 10, 90)[k % 3]
        covariance = scale * shape + floor_rad**2 * np.eye(3)
        rotvec = rng.multivariate_normal(np.zeros(3), covariance)
        yield {
            "views": "1",
            "noise": "0.005",
            "noise_mm": str((0, 1, 3)[k % 3]),
            "found": "0.99",
            "truth": "0.99" if k % 50 else "0",
            "error_deg": str(np.degrees(np.linalg.norm(rotvec))),
            "rotvec_rad": " ".join(map(str, rotvec)),
            "covariance_rad2": " ".join(map(str, shape.ravel())),
        }


def test_scale_and_floor_are_found(rng):
    rows = list(rows_of(rng, 0.6, np.radians(0.13)))
    scale, floor_rad, coverage = fitted_covariance(rows, Calibration(("", ""), {}, 1.0, 0.0))
    assert scale == pytest.approx(0.6, rel=0.25)
    assert np.degrees(floor_rad) == pytest.approx(0.13, abs=0.05)
    assert all(abs(x - (0.68 if "68%" in name else 0.95)) < 0.05 for name, x in coverage.items())


def test_the_guaranteed_level_is_the_share_that_is_found(rng, tmp_path):
    fit(list(rows_of(rng, 1.0, 0.001)), tmp_path / "x.json", Calibration(("", ""), {}, 1.0, 0.0))
    made = load_calibration(tmp_path / "x.json")
    (group,) = made.truth
    assert made.guaranteed(group) == pytest.approx(882 / 901)
    assert made.level(group, 0.995) == 0
    assert made.level(group, 0.5) == pytest.approx(882 / 901)
    assert made.guaranteed("another") == 0


def test_nothing_to_read(tmp_path):
    with pytest.raises(ReorientError, match="no rows in .*expected the folder of `reorient verifier calibrate`"):
        read(tmp_path)
