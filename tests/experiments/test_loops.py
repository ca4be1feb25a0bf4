"""Closed loops in simulation: the same starts for all systems, rows that add up, and a summary of them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from reorient.cli import main
from reorient.controller import orient
from reorient.errors import ReorientError
from reorient.estimators import load_estimator
from reorient.experiments import loops
from reorient.experiments.loops import COLUMNS, Loops, run_loops, run_trial, trials
from reorient.reporting.loop_tables import markdown_loops, read_loop_rows
from reorient.world.objects import ObjectSource, generated

SMALL = Loops(
    ObjectSource(count=3, object_seed=7), ("gicp/algorithm1", "icp/direct"), objects=1, trials=1, start_deg=("10",)
)


class Confident:
    """``gicp`` with a confidence."""

    def estimate(self, *given):
        return replace(load_estimator("gicp").estimate(*given), confidence=0.99)


def rows_of(config):
    return [row for trial in trials(config).values() for row in run_trial(trial)["rows"]]


@pytest.mark.slow
def test_all_systems_share_the_start_and_end_near_the_goal():
    rows = rows_of(SMALL)
    assert [f"{row['estimator']}/{row['strategy']}" for row in rows] == list(SMALL.systems)
    assert len({row["angle_deg"] for row in rows}) == 1
    for row in rows:
        assert list(row) == COLUMNS
        trajectory = [float(x) for x in row["trajectory_deg"].split()]
        assert trajectory[0] == 10
        assert len(trajectory) == int(row["moves"]) + 1
        assert trajectory[-1] == pytest.approx(float(row["error_deg"]), abs=0.006)
        assert float(row["error_sym_deg"]) <= float(row["error_deg"]) + 1e-3
    assert float(rows[0]["error_deg"]) < 1
    assert rows[0]["status"] == "converged"


@pytest.mark.slow
def test_the_strategy_is_the_one_named_whatever_the_confidence():
    config = replace(SMALL, systems=("test_loops:Confident/algorithm1", "test_loops:Confident/fusing"))
    slow, few = (int(row["moves"]) for row in rows_of(config))
    assert slow > 8  # a fifth of the rest at a time
    assert few < 8


def test_starts_noise_and_faults_are_those_of_the_seed():
    config = replace(SMALL, systems=("gicp/direct",), start_deg=("10", "any"), faults=0.4)
    first, again = ([row | {"seconds": ""} for row in rows_of(config)] for _ in range(2))
    assert first == again
    assert any(row["faults_met"] for row in first)
    assert float(first[1]["angle_deg"]) != pytest.approx(10, abs=0.1)
    other = rows_of(replace(config, seed=1))
    assert [row["trajectory_deg"] for row in other] != [row["trajectory_deg"] for row in first]


def test_goal_views_are_means_of_captures(monkeypatch):
    goals = []

    def noted(station, goal, *more, **options):
        goals.append(goal.image.depth_m)
        return orient(station, goal, *more, **options)

    monkeypatch.setattr(loops, "orient", noted)
    for captures in (1, 5):
        rows_of(replace(SMALL, systems=("gicp/direct",), goal_captures=captures))
    once_m, mean_m = goals
    both = (once_m > 0) & (mean_m > 0)
    assert 0.5e-3 < np.median(np.abs(once_m - mean_m)[both]) < 1e-3  # noise of 1 mm, and little in the mean


def test_symmetric_objects_can_be_chosen(tmp_path):
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "box.ply")
    generated(1).load("generated-0-000000").export(tmp_path / "generated.ply")
    config = Loops(ObjectSource(meshes=tmp_path), trials=1)
    assert {trial.object for trial in trials(config).values()} == {"box", "generated"}
    assert {trial.object for trial in trials(replace(config, symmetric=True)).values()} == {"box"}
    (tmp_path / "box.ply").unlink()
    with pytest.raises(ReorientError, match="none of 1 objects has a symmetry"):
        trials(replace(config, symmetric=True))


def test_the_summary_counts():
    def row(**cells):
        common = {"start_deg": "any", "noise_mm": "1", "slack_deg": "0", "faults": "0.08"}
        return dict.fromkeys(COLUMNS, "1") | common | {"estimator": "e", "strategy": "s"} | cells

    rows = [row(error_sym_deg="0.5", status="converged", moves="3")] * 6
    rows += [row(error_sym_deg="9", status="converged", moves="5")] + [row(error_sym_deg="9", status="unsure")] * 3
    (*_, line) = (x for x in markdown_loops(rows).splitlines() if x.startswith("| any"))
    cells = [cell.strip() for cell in line.split("|")[1:-1]]
    assert cells[:4] == ["any, 1 mm, faults 8%", "e/s", "10", "0.50"]
    assert cells[4:7] == ["60.0% (31.3–83.2)", "1 (1.8–40.4%)", "3 (10.8–60.3%)"]
    assert cells[7:11] == ["3", "5", "9.00", "60.0%"]


@pytest.mark.slow
def test_the_verb_leaves_rows_and_a_table(tmp_path, capsys):
    arguments = ["--count", "2", "--objects", "1", "--trials", "2", "--start-deg", "10", "any"]
    main(["loops", str(tmp_path), *arguments, "--systems", "gicp/direct"])
    assert "gicp/direct" in capsys.readouterr().out
    rows = read_loop_rows(tmp_path)
    assert [(row["trial"], row["start_deg"]) for row in rows] == [("0", "10"), ("0", "any"), ("1", "10"), ("1", "any")]
    assert (tmp_path / "table.md").read_text().count("gicp/direct") == 2
    with pytest.raises(ReorientError, match="another config"):
        list(run_loops(SMALL, tmp_path))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"systems": ("gicp/tomorrow",)}, "strategy.* 'tomorrow'"),
        ({"systems": ("gicq/direct",)}, "did you mean 'gicp'"),
        ({"systems": ()}, "at least one system"),
        ({"start_deg": ("0",)}, "start_deg=.*: expected degrees above 0, at most 180, or 'any'"),
        ({"start_deg": ("all",)}, "start_deg=.*all.*: expected degrees"),
        ({"noise_mm": (-1.0,)}, "noise_mm=.*: expected numbers from 0"),
        ({"slack_deg": np.nan}, "slack_deg=nan: expected a number from 0"),
        ({"faults": 1.1}, "faults=1.1: expected a number from 0 to 1"),
        ({"world": "papre"}, "did you mean 'paper'"),
        ({"seed": -1}, "seed=-1: expected a number from 0"),
    ],
)
def test_refusals(wrong, message):
    with pytest.raises(ReorientError, match=message):
        Loops(**wrong)
