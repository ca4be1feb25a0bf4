"""Every example runs."""

import runpy
from pathlib import Path

import pytest

from reorient.cli import main

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_example_runs(path):
    runpy.run_path(str(path), run_name="__main__")


def test_estimate_from_arrays_is_right(capsys):
    runpy.run_path(str(ROOT / "examples" / "estimate_from_arrays.py"), run_name="__main__")
    assert float(capsys.readouterr().out.split()[2]) == pytest.approx(12, abs=0.3)


def test_my_station_serves_the_loop(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    goal = tmp_path / "goal.npz"
    main(["capture", str(goal), "--station", "examples.my_station:TurntableStation"])
    main(["orient", str(goal), "--station", "examples.my_station:TurntableStation"])
    assert "Done after" in capsys.readouterr().out
