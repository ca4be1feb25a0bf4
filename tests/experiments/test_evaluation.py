"""Evaluations: rows that can be trusted, made again, and resumed."""

import csv
import gzip
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators.base import with_evidence
from reorient.experiments.cells import COLUMNS, answer_cells
from reorient.experiments.evaluation import Evaluation, evaluate, measure_pairs, read_config, regenerate
from reorient.registration import DepthView
from reorient.reporting.rows import estimators, read_rows
from reorient.runs.pool import Pool
from reorient.world.objects import ObjectSource

TINY = Evaluation(ObjectSource(count=2), ("gicp", "icp"), ranges_deg=((0, 30), (30, 60)), noise_mm=(0.0, 1.0), pairs=3)


def run(config, out, workers=1):
    return list(evaluate(config, out, Pool(workers)))


def rows_of(out: Path):
    with gzip.open(out / "rows.csv.gz", "rt", newline="") as file:
        return list(csv.DictReader(file))


def without_times(rows):
    return [{k: v for k, v in row.items() if k != "seconds"} for row in rows]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("evaluation") / "run"
    states = run(TINY, out)
    assert states[0] == (0, 3)
    assert states[-1] == (3, 3)
    return out


def test_one_row_each(finished):
    rows = rows_of(finished)
    assert len(rows) == 3 * 2 * 2 * 2
    assert list(rows[0]) == list(COLUMNS)
    cells = {(r["pair"], r["low_deg"], r["noise_mm"], r["estimator"]) for r in rows}
    assert len(cells) == len(rows)
    for row in rows:
        assert float(row["low_deg"]) <= float(row["angle_deg"]) <= float(row["high_deg"])
        assert float(row["error_sym_deg"]) <= float(row["error_deg"]) + 1e-3
    near = [float(r["error_deg"]) for r in rows if r["estimator"] == "gicp" and r["low_deg"] == "0"]
    assert np.median(near) < 1


def test_a_cad_goal_is_exact_and_shows_the_goal_pose(tmp_path):
    config = replace(TINY, estimators=("gicp",), ranges_deg=((0, 30),), noise_mm=(1.0,), pairs=1, goal_views=(6,))
    goals = []

    def measure(config, pair, goal, group, pivot_m):
        goals.append((goal, pair))
        return [answer_cells(pair.R_goal_current, pair, group)]

    for cad in (False, True):
        list(measure_pairs(replace(config, cad=cad), tmp_path / str(cad), measure))
    (sensed, _), (rendered, pair) = goals
    assert len(rendered.views) == len(sensed.views) == 5
    both = rendered.image.valid & pair.goal.valid
    away_m = np.abs(rendered.image.depth_m - pair.goal.depth_m)[both]
    assert np.median(away_m) < 0.002  # the sensor's noise
    assert away_m.max() > 0
    center_m = pair.placement.center_m
    for view in rendered.views:
        np.testing.assert_allclose(view.R_goal_view @ center_m + view.t_goal_view_m, center_m, atol=1e-9)
    with pytest.raises(ReorientError, match="--cad with --slip-deg 1"):
        replace(config, cad=True, slip_deg=1.0)


def test_estimators_meet_the_same_pairs(finished):
    by_cell: dict = {}
    for row in rows_of(finished):
        by_cell.setdefault((row["pair"], row["low_deg"], row["noise_mm"]), set()).add(row["angle_deg"])
    assert all(len(angles) == 1 for angles in by_cell.values())


@pytest.mark.slow
def test_goals_of_several_views_are_of_the_same_pairs(finished, tmp_path):
    config = replace(TINY, estimators=("gicp",), goal_views=(1, 3), pairs=1, noise_mm=(0.0,))
    list(evaluate(config, tmp_path / "run"))
    rows = rows_of(tmp_path / "run")
    assert [row["goal_views"] for row in rows] == ["1", "3", "1", "3"]
    one = {row["low_deg"]: row for row in rows_of(finished) if (row["pair"], row["noise_mm"]) == ("0", "0.0")}
    for row in rows:  # one view is all that this estimator knows
        assert row["angle_deg"] == one[row["low_deg"]]["angle_deg"]
    assert rows[0]["error_deg"] == rows[1]["error_deg"]
    assert estimators(read_rows(tmp_path / "run")) == ["gicp", "gicp, 3 goal views"]


def test_rows_can_be_made_again(finished):
    config = read_config(finished)
    assert config == TINY
    for row in rows_of(finished)[::7]:
        pair, renderer = regenerate(config, row)
        assert np.degrees(so3.angle(pair.R_goal_current)) == pytest.approx(float(row["angle_deg"]), abs=1e-3)
        R = so3.matrix_from_quat(np.array([float(row[f"q{x}"]) for x in "wxyz"]))
        error = np.degrees(so3.angle_difference(R, pair.R_goal_current))
        assert error == pytest.approx(float(row["error_deg"]), abs=1e-3)
        assert len(renderer.mesh.faces) > 0


def test_workers_do_not_change_the_rows(finished, tmp_path):
    run(TINY, tmp_path / "two", workers=2)
    assert without_times(rows_of(tmp_path / "two")) == without_times(rows_of(finished))


def test_goes_on_after_being_killed_in_the_middle_of_a_row(finished, tmp_path):
    out = tmp_path / "killed"
    states = evaluate(TINY, out)
    for done, _ in states:
        if done == 1:
            break
    states.close()
    with (out / "partial.jsonl").open("a") as file:
        file.write('{"task": "1", "rows": [{"object": "gener')  # half a row, as kill -9 leaves it
    assert run(TINY, out)[0] == (1, 3)
    assert without_times(rows_of(out)) == without_times(rows_of(finished))
    assert not (out / "partial.jsonl").exists()
    assert run(TINY, out) == [(3, 3)]  # nothing left to do


@dataclass(frozen=True)
class Fixed:
    """An estimator that is not of the package: always the same rotation about the optical axis, or a refusal."""

    angle_rad: float | None

    def estimate(self, current, goal, pivot_m=None, history=()):
        if self.angle_rad is None:
            raise ReorientError("too dark")
        R = so3.exp(np.array([0, 0, self.angle_rad]))
        return with_evidence(DepthView(current), DepthView(goal), R, np.zeros(3))


def test_an_estimator_that_refuses_has_answered_nothing(tmp_path):
    config = Evaluation(ObjectSource(count=1), ("dark",), ranges_deg=((10, 20),), noise_mm=(0.0,), pairs=1)
    list(evaluate(config, tmp_path / "run", own={"dark": Fixed(None)}))
    (row,) = rows_of(tmp_path / "run")
    assert re.fullmatch(r"too dark \[\S*test_evaluation\.py, line \d+\]", row["message"])
    assert float(row["error_deg"]) == pytest.approx(float(row["angle_deg"]), abs=1e-3)


def test_estimators_of_ones_own_stand_beside_the_package_s(tmp_path):
    config = Evaluation(ObjectSource(count=1), ("mine", "gicp"), ranges_deg=((10, 20),), noise_mm=(0.0,), pairs=2)
    list(evaluate(config, tmp_path / "run", Pool(2), own={"mine": Fixed(0.3)}))
    rows = rows_of(tmp_path / "run")
    assert [row["estimator"] for row in rows] == ["mine", "gicp"] * 2
    assert all(float(row["qw"]) == pytest.approx(np.cos(0.15)) for row in rows[::2])
    assert rows[0]["angle_deg"] == rows[1]["angle_deg"]
    with pytest.raises(ReorientError, match="holds a run of another config"):
        list(evaluate(config, tmp_path / "run", own={"mine": Fixed(0.4)}))
    with pytest.raises(ReorientError, match="unknown estimator 'mine'"):
        run(config, tmp_path / "other")


class Ordinary:
    """An estimator of one's own that is no dataclass; its repr is another in every process."""

    estimate = Fixed(0.3).estimate


def test_ordinary_objects_can_go_on(tmp_path):
    config = Evaluation(ObjectSource(count=1), ("mine",), ranges_deg=((10, 20),), noise_mm=(0.0,), pairs=1)
    first, again = Ordinary(), Ordinary()
    list(evaluate(config, tmp_path / "run", own={"mine": first}))
    assert list(evaluate(config, tmp_path / "run", own={"mine": again})) == [(1, 1)]
    with pytest.raises(ReorientError, match="holds a run of another config"):
        list(evaluate(config, tmp_path / "run", own={"mine": Fixed(0.3)}))


def test_anything_can_be_measured_of_the_same_pairs(finished, tmp_path):
    def truth(config, pair, goal, group, pivot_m):
        assert (pivot_m is None) != config.pivot
        return [answer_cells(pair.R_goal_current, pair, group) for _ in config.estimators]

    config = replace(TINY, estimators=("truth",), pivot=True)
    list(measure_pairs(config, tmp_path / "run", truth))
    rows = rows_of(tmp_path / "run")
    assert all(float(row["error_sym_deg"]) < 0.01 for row in rows)
    assert [row["angle_deg"] for row in rows] == [row["angle_deg"] for row in rows_of(finished)[::2]]


def test_rows_of_another_version_are_not_mixed(tmp_path):
    states = evaluate(TINY, tmp_path / "run")
    next(state for state in states if state[0] == 1)
    states.close()
    partial = tmp_path / "run" / "partial.jsonl"
    partial.write_text(partial.read_text().replace('"seconds"', '"duration"'))
    with pytest.raises(ReorientError, match="rows with other columns: it was begun by another version"):
        run(TINY, tmp_path / "run")


def test_refusals(finished, tmp_path):
    with pytest.raises(ReorientError, match="holds a run of another config"):
        run(Evaluation(ObjectSource(count=3)), finished)
    with pytest.raises(ReorientError, match="unknown estimator"):
        run(Evaluation(estimators=("nope",)), tmp_path)
    with pytest.raises(ReorientError, match="unknown world 'benchmrak': .*did you mean 'benchmark'"):
        run(Evaluation(world="benchmrak"), tmp_path)
    with pytest.raises(ReorientError, match="workers=0: expected at least 1"):
        run(TINY, tmp_path, workers=0)
    for wrong in ({"pairs": 0}, {"seed": -1}, {"noise_mm": (-1.0,)}, {"ranges_deg": ((30, 10),)}, {"estimators": ()}):
        with pytest.raises(ReorientError, match="expected"):
            Evaluation(**wrong)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "broken.stl").write_text("solid nothing")
    with pytest.raises(ReorientError, match="1 of 1 meshes are refused .*name the others with --only"):
        run(Evaluation(ObjectSource(meshes=tmp_path / "meshes")), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    for torn in ('{"config": ', '{"config": 3}', "[]"):
        (tmp_path / "config.json").write_text(torn)
        with pytest.raises(ReorientError, match="broken .*config.json"):
            read_config(tmp_path)
    (tmp_path / "config.json").unlink()
    with pytest.raises(ReorientError, match="expected config.json"):
        read_config(tmp_path)
    with pytest.raises(ReorientError, match="expected one source"):
        ObjectSource(meshes=tmp_path, package="rtb-data").open()
    with pytest.raises(ReorientError, match="expected object names, one a line"):
        ObjectSource(only=tmp_path / "none.txt").open()
