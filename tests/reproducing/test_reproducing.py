"""The paper's figures at tiny size, and the arithmetic that says what holds."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from reorient import so3
from reorient.cli import main
from reorient.errors import ReorientError
from reorient.estimators import load_estimator
from reorient.experiments.loops import COLUMNS
from reorient.reporting.rows import read_table
from reorient.reproducing import NAMES
from reorient.reproducing.best_worst import BestWorst
from reorient.reproducing.conclusions import conclude
from reorient.reproducing.conditions import SWEEPS, Condition, see
from reorient.reproducing.controller import Controller, by_iteration
from reorient.reproducing.figure import load_figure
from reorient.reproducing.findings import Finding, held, interval, share
from reorient.reproducing.full import Full, shape_match
from reorient.reproducing.making import verdicts
from reorient.reproducing.object_sets import ObjectSets
from reorient.reproducing.one_shot import NOTHING, RELEASED
from reorient.reproducing.setting import Setting
from reorient.reproducing.sweeps import SweepFigure
from reorient.runs.files import write_table
from reorient.world.objects import generated
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised


@pytest.fixture
def lists(tmp_path):
    """A folder with lists of a few names."""
    folder = tmp_path / "lists"
    folder.mkdir()
    sets = {"non-symmetric": (110, 2021, 10), "full-test": (872, 2020, 3), "generated-reporting": (400, 100, 3)}
    for name, (count, seed, kept) in sets.items():
        (folder / f"{name}.txt").write_text("".join(f"{x}\n" for x in generated(count, seed).names[:kept]))
    return folder


@pytest.fixture
def setting(tmp_path, lists):
    return Setting(tmp_path / "data", tmp_path / "out", lists)


# --- intervals and verdicts -----------------------------------------------------------------------------------------


def test_intervals_cover_the_truth_as_often_as_they_say(rng):
    """Errors of one object go together: with pairs drawn singly, the intervals would be far too narrow."""
    inside = 0
    for _ in range(60):
        objects = np.repeat(np.arange(25), 8)
        values = np.repeat(rng.standard_normal(25), 8) + 0.2 * rng.standard_normal(200)
        low, high = interval(values, [str(x) for x in objects])
        inside += low < 0 < high
    assert inside >= 50


def test_intervals_of_medians_and_shares():
    values = np.arange(100.0)
    low, high = interval(values, [str(x) for x in range(100)], "median")
    assert 30 < low < 49.5 < high < 70
    every = share("all", np.ones(20, bool), ["a"] * 20)
    assert (every.value, every.high) == (100, 100)
    assert 80 < every.low < 90


def test_what_holds():
    def finding(value, low, high):
        return Finding("x", value, low, high, 10)

    assert held(finding(1.0, 0.8, 1.2), finding(1.1, 1.0, 1.2))
    assert held(finding(1.0, 0.8, 1.2), finding(1.0, 1.0, 1.0))
    assert not held(finding(1.0, 0.9, 1.1), finding(2.0, 1.9, 2.1))
    assert not held(finding(2.0, 1.9, 2.1), finding(1.0, 0.9, 1.1))
    assert held(finding(1.0, np.nan, np.nan), finding(2.0, 1.9, 2.1)) is None


def test_conclusions_name_the_winner_level_by_level():
    def rows(level_rows):
        return [
            {"estimator": name, "error_deg": str(error), "object": str(i)}
            for name, errors in level_rows.items()
            for i, error in enumerate(errors)
        ]

    good, bad = [1.0] * 30, [9.0] * 30
    levels = {
        "0 mm": rows({"swift": bad, "gicp": good, "paper": good, "icp": bad}),
        "5 mm": rows({"swift": good, "gicp": bad, "paper": bad, "icp": bad}),
    }
    first, ours, papers = conclude({"depth noise, mm": levels})
    assert first == "Learning (swift) is ahead of geometry (gicp) at 1 of 2 levels: 5 mm."
    assert "swift is ahead at 5 mm (100% and 0%); gicp is ahead at 0 mm (0% and 100%)" in ours
    assert "paper is ahead at 0 mm (100% and 0%); no difference is significant at 5 mm (0% and 0%)" in papers
    levels["0 mm"] = levels["5 mm"]
    _, ours, _ = conclude({"depth noise, mm": levels})
    assert "gicp: swift is ahead at every level, from 0 mm (100% and 0%) to 5 mm (100% and 0%)." in ours


# --- baselines ------------------------------------------------------------------------------------------------------


def test_baselines_by_name(mesh, rng):
    turn = np.radians(10)
    pair = sample_pair(rng, Renderer(mesh), load_world("paper"), randomised(), turn, turn)
    nothing, released, right = (
        load_estimator(name).estimate(pair.current, pair.goal).R_goal_current for name in (NOTHING, RELEASED, "icp")
    )
    np.testing.assert_array_equal(nothing, np.eye(3))
    assert so3.is_rotation(released)
    errors = [so3.angle_difference(R, pair.R_goal_current) for R in (released, right)]
    assert errors[0] > errors[1]


def test_own_estimators_are_refused_in_a_line():
    for name, said in (
        ("nowhere:Thing", "cannot make estimator 'nowhere:Thing' .*: expected an importable class"),
        ("pathlib:Path", "estimator 'pathlib:Path' has no estimate"),
        ("none.onnx", "no weights none.onnx: expected what `reorient export` wrote"),
    ):
        with pytest.raises(ReorientError, match=said):
            load_estimator(name)


def test_shape_match_forgives_what_the_vertices_cannot_tell(rng):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) / np.sqrt(3)
    R = so3.sample_uniform(rng, 1)[0]
    quarter = so3.exp(np.array([0.0, 0.0, np.pi / 2]))
    assert shape_match(corners, R @ quarter, R) == pytest.approx(0, abs=1e-12)
    small = so3.exp(np.array([0.0, 0.0, 0.1]))
    moved = np.linalg.norm(corners @ (R @ small).T - corners @ R.T, axis=1)
    assert shape_match(corners, R @ small, R) == pytest.approx(np.mean(moved**2) / 2)


# --- rows -----------------------------------------------------------------------------------------------------------


def test_only_loops_that_end_at_the_limit_are_counted_as_such(tmp_path):
    rows = [
        dict.fromkeys(COLUMNS, "1") | {"estimator": "gicp", "trajectory_deg": "30 9", "status": status}
        for status in ("max_images", "station_failed", "converged")
    ]
    write_table(tmp_path / "rows.csv.gz", rows)
    (at_limit,) = [f for f in Controller().findings(tmp_path) if "ended at the limit" in f.what]
    assert at_limit.value == pytest.approx(100 / 3)


def test_an_ended_loop_keeps_its_last_error():
    curve = by_iteration([{"trajectory_deg": "30 10 2"}, {"trajectory_deg": "30 4"}])
    assert curve.y.tolist() == [30, 7, 3]


def test_sweeps_vary_one_thing_and_show_the_same_orientations(mesh):
    renderer, usual = Renderer(mesh), Condition()
    pairs = {
        name: see(renderer, condition, np.random.default_rng(3))
        for name, condition in {
            "usual": usual,
            "wrong": replace(usual, focal_error=0.05),
            "small": replace(usual, size_px=32),
            "occluded": replace(usual, occluded=0.5),
            "seen": replace(usual, occluded=0.0),
            "exact": replace(usual, noise_mm=0.0),
        }.items()
    }
    for pair in pairs.values():
        np.testing.assert_array_equal(pair.R_goal_current, pairs["usual"].R_goal_current)
        np.testing.assert_array_equal(pair.R_camera_object, pairs["usual"].R_camera_object)
    assert pairs["wrong"].goal.camera.fx / pairs["usual"].goal.camera.fx in (pytest.approx(1.05), pytest.approx(0.95))
    np.testing.assert_array_equal(pairs["wrong"].goal.depth_m, pairs["usual"].goal.depth_m)
    assert pairs["small"].goal.depth_m.shape == (32, 32)
    returns = {name: np.count_nonzero(pair.current.depth_m) for name, pair in pairs.items()}
    assert returns["exact"] == pytest.approx(returns["usual"], rel=0.03)  # without noise, too, as many are lost
    assert returns["occluded"] == pytest.approx(returns["seen"] / 2, rel=0.03)


# --- whole figures --------------------------------------------------------------------------------------------------


def made(figure, setting):
    folder = setting.folder(figure.name)
    figure.measure(setting)
    return folder, figure.findings(folder), figure.draw(setting, folder)


def check_written(written):
    assert written[-1].name == "report.html"
    page = written[-1].read_text()
    assert page.count("data:image") >= 1
    assert "http" not in page.replace("http://www.w3.org", "")
    for path in written:
        if path.suffix == ".png":
            assert Image.open(path).width > 500


@pytest.mark.slow
def test_object_sets(setting):
    folder, findings, written = made(ObjectSets(full=Full(count=12), shown=4), setting)
    check_written(written)
    assert [finding.n for finding in findings] == [10, 12]
    assert len(read_table(folder / "rows.csv.gz", ["symmetry_residual"])) == 22


@pytest.mark.slow
def test_best_worst(setting):
    figure = BestWorst(pairs=4)
    folder, findings, written = made(figure, setting)
    check_written(written)
    assert len(findings) == 6 + 6
    for best, worst in zip(findings[:6:2], findings[1:6:2], strict=True):
        assert best.value <= worst.value
    lines = verdicts(figure, findings, folder, folder)
    assert lines[0].startswith("best-worst: holds: 6 of 6 numbers")
    assert lines[0].endswith("6 have no interval or no counterpart")
    assert "none of its 6 numbers has an interval" in verdicts(figure, findings[:6], folder, folder)[0]


@pytest.mark.slow
def test_controller_whole_and_quick(setting):
    figure = Controller(estimators=("gicp",), objects=3, trials=2)
    folder, findings, written = made(figure, setting)
    check_written(written)
    assert next(f.n for f in findings if f.what == "gicp: median final error") == 6
    part = replace(setting, share=0.5)
    assert part.folder("controller") != folder
    other, again, _ = made(figure, part)
    assert next(f.n for f in again if f.what == "gicp: median final error") == 3
    agree = sum(bool(held(a, b)) for a, b in zip(again, findings, strict=True))
    (head, *differing) = verdicts(figure, again, folder, other)
    assert f": {agree} of {len(again)} numbers agree" in head
    assert head.startswith("controller: holds" if agree >= len(again) - 1 else "controller: DOES NOT HOLD")
    assert len(differing) == len(again) - agree
    assert "not compared, there are no whole rows" in verdicts(figure, again, setting.out / "none", other)[0]


def test_a_part_that_differs_does_not_hold(tmp_path):
    """The verdict of a part whose errors are ten times those of the whole."""
    figure = Controller()
    for name, error_deg in (("whole", 1.0), ("part", 10.0)):
        (tmp_path / name).mkdir()
        rows = [
            dict.fromkeys(COLUMNS, "1")
            | {"object": f"o{k}", "estimator": "gicp", "moves": f"{20 * error_deg + k % 3}"}
            | {"error_deg": f"{error_deg + 0.01 * k}", "error_sym_deg": f"{error_deg + 0.01 * k}"}
            for k in range(20)
        ]
        write_table(tmp_path / name / "rows.csv.gz", rows)
    same = verdicts(figure, figure.findings(tmp_path / "whole"), tmp_path / "whole", tmp_path / "whole")
    assert same == [f"controller: holds: 8 of 8 numbers{same[0].partition('8 of 8 numbers')[2]}"]
    head, *differing = verdicts(figure, figure.findings(tmp_path / "part"), tmp_path / "whole", tmp_path / "part")
    assert head.startswith("controller: DOES NOT HOLD: 2 of 8 numbers")
    assert len(differing) == 6
    assert differing[0].startswith("  differs: gicp: median final error: 10.")


@pytest.mark.slow
def test_sweeps_end_to_end(setting):
    few = {name: replace(sweep, conditions=dict(list(sweep.conditions.items())[:2])) for name, sweep in SWEEPS.items()}
    folder, findings, written = made(SweepFigure(pairs=3, sweeps=few), setting)
    check_written(written)
    assert len(findings) == 6 * 2 * 4 * 2
    names = {finding.what for finding in findings}
    assert {"0 mm of noise, swift: median", "10 to 20 degrees, icp: within 5°"} <= names
    text = (folder / "conclusions.md").read_text()
    assert text.startswith("# Where learning beats geometry\n\n- Learning (swift) is ahead")


def test_refusals(capsys, tmp_path):
    with pytest.raises(ReorientError, match=r"unknown figure 'sweep': .*did you mean 'sweeps'"):
        load_figure("sweep")
    for arguments, said in (
        (["reproduce"], "no figure named: expected one of object-sets, best-worst"),
        (["reproduce", "nothing"], "nothing"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
        assert said in capsys.readouterr().err
    assert [load_figure(name).name for name in NAMES] == list(NAMES)
