"""Every example runs."""

import functools
import importlib
import runpy
from pathlib import Path

import numpy as np
import pytest

from reorient import so3
from reorient.cli import main

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_example_runs(path):
    runpy.run_path(str(path), run_name="__main__")


def test_estimate_from_arrays_is_right(capsys):
    runpy.run_path(str(ROOT / "examples" / "estimate_from_arrays.py"), run_name="__main__")
    assert float(capsys.readouterr().out.split()[1]) == pytest.approx(12, abs=0.3)


def test_my_station_rotates_its_object_to_the_goal(capsys, tmp_path, monkeypatch):
    """25 degrees away, at most 10 degrees a move: three moves or more, as the camera sees no less than was moved."""
    monkeypatch.chdir(ROOT)
    goal = tmp_path / "goal.npz"
    main(["capture", str(goal), "--station", "examples.my_station:at_goal"])
    station = importlib.import_module("examples.my_station").TurntableStation
    rotations = []

    class Watched(station):
        def rotate(self, R_step):
            rotations.append(super().rotate(R_step))
            return rotations[-1]

    monkeypatch.setattr("examples.my_station.TurntableStation", Watched)
    main(["orient", str(goal), "--station", "examples.my_station:TurntableStation", "--yes"])  # a failure is SystemExit
    assert f"converged after {len(rotations)} moves" in capsys.readouterr().out
    assert len(rotations) >= 3
    rotvec_deg = np.degrees(so3.log(functools.reduce(lambda done, R: R @ done, rotations, np.eye(3))))
    np.testing.assert_allclose(rotvec_deg, [0, -25, 0], atol=0.7)
