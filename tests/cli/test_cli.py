"""Every verb end to end on tiny data; every bad input one line and exit code 2."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from reorient import so3
from reorient.cli import main
from reorient.imaging import DepthImage
from reorient.imaging.files import read_depth, write_camera, write_depth
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")


def refused(capsys, *arguments) -> str:
    """The one line that a refused command says."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert ended.value.code == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("reorient: ")
    assert "\n" not in said
    return said


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """(folder with now.npz, goal.npz and raw.png of a whole scene, the truth)."""
    import trimesh

    folder = tmp_path_factory.mktemp("pair")
    arms = [trimesh.creation.box(bounds=[(-0.2, -0.2, -0.2), end]) for end in ((1, 0.2, 0.2), (0.2, 0.7, 0.2))]
    turn = np.radians(20)
    pair = sample_pair(
        np.random.default_rng(0), Renderer(trimesh.util.concatenate(arms)), WORLD, randomised(), turn, turn
    )
    write_depth(folder / "now.npz", pair.current)
    write_depth(folder / "goal.npz", pair.goal)
    scene = np.where(pair.current.valid, pair.current.depth_m, 0.9)
    Image.fromarray(np.rint(scene * 1000).astype(np.uint16)).save(folder / "raw.png")
    Image.fromarray(pair.current.valid).convert("L").save(folder / "mask.png")
    write_camera(folder / "camera.json", WORLD.camera)
    return folder, pair


def test_estimate(pair, capsys):
    folder, truth = pair
    main(["estimate", str(folder / "now.npz"), str(folder / "goal.npz"), "--json", "--pivot", "0", "0", "0.6"])
    said = json.loads(capsys.readouterr().out)
    R = np.array(said["R_goal_current"])
    assert np.degrees(so3.angle_difference(R, truth.R_goal_current)) < 0.5
    np.testing.assert_allclose(so3.matrix_from_quat(np.array(said["quat_wxyz"])), R, atol=1e-9)
    assert said["angle_deg"] == pytest.approx(20, abs=0.5)
    assert 0 < said["confidence"] <= 1
    assert said["evidence"]["fit"] > 0.5
    main(["estimate", str(folder / "now.npz"), str(folder / "goal.npz"), "--estimator", "icp"])
    words = capsys.readouterr().out
    assert all(word in words for word in ("degrees about [", "wxyz", "matrix", "evidence", "not calibrated"))
    main(["estimate", str(folder / "now.npz"), str(folder / "goal.npz"), "--explain", str(folder / "why.png")])
    assert "sure to be within 5 degrees" in capsys.readouterr().out
    assert Image.open(folder / "why.png").width > 1000


def test_estimate_from_raw_frames_isolated_separately(pair, capsys):
    folder, truth = pair
    common = [
        "estimate",
        str(folder / "raw.png"),
        str(folder / "goal.npz"),
        "--camera",
        str(folder / "camera.json"),
        "--json",
    ]
    ways = (["--far", "0.85"], ["--mask", str(folder / "mask.png"), "-"], ["--far", "0.85", "2", "--near", "0.3"])
    for way in ways:
        main(common + way)
        R = np.array(json.loads(capsys.readouterr().out)["R_goal_current"])
        assert np.degrees(so3.angle_difference(R, truth.R_goal_current)) < 1
    assert "isolate the object: returns fill 100% of the image" in refused(capsys, *common)
    assert "--far with 3 values: expected one for both images, or two" in refused(capsys, *common, "--far", 1, 2, 3)
    assert "--box with 3 numbers" in refused(capsys, *common, "--box", 1, 2, 3)


def test_bad_images(pair, capsys, tmp_path, unchecked):
    folder, truth = pair
    good = folder / "goal.npz"
    camera = WORLD.camera
    depth_m = truth.current.depth_m

    def said(name, array, *more):
        np.save(tmp_path / name, array)
        return refused(capsys, "estimate", tmp_path / name, good, "--camera", folder / "camera.json", *more)

    assert "looks like millimetres" in said("mm.npy", depth_m * 1000)
    assert "NaN or infinite pixels: expected 0" in said("nan.npy", np.where(depth_m > 0, depth_m, np.nan))
    assert "expected no negative value" in said("negative.npy", depth_m - 0.3)
    assert "0 everywhere" in said("zero.npy", 0 * depth_m)
    assert "dtype uint16: expected floating-point metres" in said("dtype.npy", (depth_m * 1000).astype(np.uint16))
    assert "expected (height, width) = (128, 128)" in said("size.npy", depth_m[:100])
    assert "one channel" in said("channels.npy", np.stack([depth_m] * 3, axis=-1))
    np.save(tmp_path / "fine.npy", depth_m)
    assert "missing intrinsics" in refused(capsys, "estimate", tmp_path / "fine.npy", good)
    (tmp_path / "half.npz").write_bytes(good.read_bytes()[:500])
    assert "expected a complete file" in refused(capsys, "estimate", tmp_path / "half.npz", good)
    (tmp_path / "camera.json").write_text("{")
    assert "is not JSON" in refused(
        capsys, "estimate", tmp_path / "fine.npy", good, "--camera", tmp_path / "camera.json"
    )
    Image.fromarray(np.zeros((128, 128), np.uint8)).save(tmp_path / "black.png")
    assert "mask is empty" in said("fine.npy", depth_m, "--mask", tmp_path / "black.png")
    assert "expected an existing file" in refused(capsys, "estimate", tmp_path / "none.npz", good)
    assert "did you mean 'gicp'" in refused(capsys, "estimate", good, good, "--estimator", "gipc")
    write_depth(tmp_path / "dot.npz", DepthImage(np.pad([[0.6]], ((0, 127), (0, 127))), camera))
    assert "has 1 returns: expected at least" in refused(capsys, "estimate", tmp_path / "dot.npz", good)


def test_capture_and_orient(capsys, tmp_path):
    goal = tmp_path / "goal.png"
    main(["capture", str(goal)])
    assert read_depth(goal).camera == WORLD.camera
    capsys.readouterr()
    one = ["orient", str(goal), "--strategy", "algorithm1", "--estimator", "gicp"]
    main([*one, "--turn-deg", "12", "--eta", "0.5", "--out", str(tmp_path / "run")])
    said = capsys.readouterr().out
    assert "Done after" in said
    assert (tmp_path / "run" / "loop.gif").is_file()
    assert "not converged after 1 moves: limit of 1 images" in refused(capsys, *one, "--turn-deg", 12, "--max-steps", 1)
    assert "expected K >= 1, 0 < eta <= 1" in refused(capsys, *one, "--eta", 0)
    fusing = ["orient", goal, "--strategy", "fusing"]
    assert "--eta and --delta-deg are Algorithm 1's" in refused(capsys, *fusing, "--eta", 0.5)
    assert "did you mean 'fusing'" in refused(capsys, "orient", goal, "--strategy", "fusin")


def test_orient_with_limits_a_record_and_its_replay(capsys, tmp_path, monkeypatch):
    goal, record = tmp_path / "goal.npz", tmp_path / "record"
    main(["capture", str(goal)])
    turned = ["orient", goal, "--turn-deg", 100, "--noise-mm", 1, "--estimator", "fast"]
    main([str(a) for a in [*turned, "--dry-run", "--record", tmp_path / "dry"]])
    assert "dry run: would turn by" in capsys.readouterr().out
    main(["replay", str(tmp_path / "dry")])
    assert "dry run: would turn by" in capsys.readouterr().out
    monkeypatch.setattr("builtins.input", lambda question: "n")
    assert "was not confirmed" in refused(capsys, *turned, "--confirm-first-move")
    assert "would exceed the largest total" in refused(capsys, *turned, "--largest-total-deg", 40)
    assert "expected angles above 0" in refused(capsys, *turned, "--largest-step-deg", 0)
    monkeypatch.setattr("builtins.input", lambda question: "y")
    capsys.readouterr()
    main([str(a) for a in [*turned, "--confirm-first-move", "--largest-step-deg", 60, "--record", record]])
    said = capsys.readouterr().out.splitlines()
    assert said[-1].startswith("Done after")
    assert {"station", "version", "commit", "estimator"} <= set(json.loads((record / "record.json").read_text()))
    main(["replay", str(record), "--out", str(tmp_path / "again")])
    again = capsys.readouterr().out.splitlines()
    assert [line for line in again if str(tmp_path) not in line] == said
    assert "turns by" in (tmp_path / "again" / "loop.html").read_text()
    assert "holds a record: expected a new folder" in refused(capsys, *turned, "--record", record)
    assert "no record in" in refused(capsys, "replay", tmp_path)


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ({"estimator": 3}, "unknown estimator '3'"),
        *(
            ({"strategy": strategy}, "the record does not say how it was made")
            for strategy in (["algorithm1", "x"], ["algorithm1", "x", None, None], ["auto", "x", None, None], [3] * 4)
        ),
    ],
)
def test_broken_records_are_refused(broken, said, capsys, tmp_path, unchecked):
    (tmp_path / "goal.npz").write_bytes(_depth(tmp_path).read_bytes())
    record = {"estimator": "fast", "strategy": ["auto"] + [None] * 3, "largest_step_deg": 180, "pivot_m": None}
    (tmp_path / "record.json").write_text(json.dumps(record | {"acts": []} | broken))
    assert said in refused(capsys, "replay", tmp_path)


def test_the_verifier_is_not_trained_without_the_extra(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("reorient.cli.learning.find_spec", lambda module: None)
    message = refused(capsys, "verifier", "train", tmp_path, "verifier.npz")
    assert "sklearn is not installed: expected `pip install" in message


def test_the_strategy_follows_the_confidence(capsys, tmp_path, monkeypatch):
    """Algorithm 1 for a class of one's own that has none; for one that has, only if its settings are given."""
    (tmp_path / "my_estimators.py").write_text(
        "from dataclasses import replace\nfrom reorient import load_estimator\n"
        "class Plain:\n    confidence = None\n    def estimate(self, *given):\n"
        "        return replace(load_estimator('gicp').estimate(*given), confidence=self.confidence)\n"
        "class Sure(Plain):\n    confidence = 0.9\n"
    )
    monkeypatch.chdir(tmp_path)
    main(["capture", "goal.npz"])
    one = ["orient", "goal.npz", "--turn-deg", "12", "--dry-run", "--estimator"]
    for more, said in (
        (["my_estimators:Plain"], "would turn by 2.4"),
        (["my_estimators:Sure"], "would turn by 12"),
        (["my_estimators:Sure", "--eta", "0.5"], "would turn by 6"),
        (["gicp", "--max-steps", "3"], "would turn by 2.4"),
    ):
        main([*one, *more])
        assert said in capsys.readouterr().out


def test_nothing_is_left_behind_where_the_estimator_is_unknown(capsys, tmp_path):
    main(["capture", str(tmp_path / "goal.npz")])
    one = ["orient", tmp_path / "goal.npz", "--record", tmp_path / "record"]
    assert "did you mean 'gicp'" in refused(capsys, *one, "--estimator", "gipc")
    (tmp_path / "file").write_text("")
    assert "cannot make folder" in refused(capsys, *one, "--out", tmp_path / "file")
    assert not (tmp_path / "record").exists()


def test_a_failed_capture_leaves_the_old_goal(capsys, tmp_path, monkeypatch):
    (tmp_path / "broken_cell.py").write_text(
        "class Cell:\n    pivot_m = None\n    def capture(self):\n        raise OSError('no camera')\n"
        "    def rotate(self, R_step):\n        return R_step\n"
        "class Half:\n    pivot_m = None\n"
        "class Wordy:\n    def __init__(self):\n        raise OSError('no camera\\n  on bus 3')\n"
    )
    monkeypatch.chdir(tmp_path)
    goal = tmp_path / "goal.npz"
    goal.write_bytes(b"old")
    assert "failed to capture (OSError: no camera)" in refused(capsys, "capture", goal, "--station", "broken_cell:Cell")
    assert goal.read_bytes() == b"old"
    assert list(tmp_path.glob(".*goal*")) == []
    assert "has no capture, rotate" in refused(capsys, "capture", goal, "--station", "broken_cell:Half")
    assert "(OSError: no camera on bus 3)" in refused(capsys, "capture", goal, "--station", "broken_cell:Wordy")
    assert "cannot make station" in refused(capsys, "capture", goal, "--station", "nowhere:Cell")
    assert "expected 'rendered' or my_module:MyStation" in refused(capsys, "capture", goal, "--station", "rendred")
    assert "expected an existing folder" in refused(capsys, "capture", tmp_path / "none" / "goal.npz")


def test_demo(capsys, tmp_path):
    main(["demo", "--out", str(tmp_path / "demo"), "--start-deg", "100", "--estimator", "fast"])
    said = capsys.readouterr().out.strip().splitlines()
    assert "truly" in said[1]
    assert "Done after" in said[-3]
    for path in map(Path, said[-2:]):
        assert path.is_file()
        assert path.suffix in (".gif", ".html")


def test_objects(capsys, tmp_path):
    main(["objects", "list", "--count", "3"])
    assert capsys.readouterr().out.split() == [f"generated-0-00000{i}" for i in range(3)]
    main(["objects", "make", str(tmp_path / "parts"), "--count", "3"])
    assert len(list((tmp_path / "parts").glob("*.ply"))) == 3
    (tmp_path / "parts" / "broken.stl").write_text("solid nothing")
    capsys.readouterr()
    main(["objects", "check", "--meshes", str(tmp_path / "parts"), "--out", str(tmp_path / "check.csv.gz")])
    said = capsys.readouterr().out
    assert "symmetric (residual below 0.05)" in said
    assert "refused: " in said
    assert (tmp_path / "check.csv.gz").is_file()
    main(["objects", "montage", str(tmp_path / "bin.png"), "--count", "4", "--columns", "2", "--size-px", "64"])
    assert Image.open(tmp_path / "bin.png").width > 128
    assert "no folder" in refused(capsys, "objects", "list", "--meshes", tmp_path / "none")


def test_evaluate_and_report(capsys, tmp_path):
    out = tmp_path / "run"
    main(["evaluate", str(out), "--count", "2", "--pairs", "2", "--ranges-deg", "0", "30", "--noise-mm", "0"])
    said = capsys.readouterr().out
    assert "gicp" in said
    assert str(out / "rows.csv.gz") in said.replace("\n", "")
    assert "| 0 mm | 0–30° | gicp | 2 |" in (out / "table.md").read_text()
    main(["report", str(out)])
    page = Path(capsys.readouterr().out.strip())
    assert page.is_file()
    assert "expected config.json" in refused(capsys, "report", tmp_path)


def test_help_and_light_imports():
    """The robot's verbs start without torch, mujoco or open3d; help shows an example."""
    code = (
        "import sys; from reorient.cli import main\n"
        "try: main(['estimate', '--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'torch', 'mujoco', 'open3d'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "For example: reorient estimate" in done.stdout


def test_usage_errors_are_one_line(capsys, tmp_path):
    assert "Required options" in refused(capsys, "estimate")
    assert "--nope" in refused(capsys, "estimate", "a", "b", "--nope", 3)
    assert "Available subcommands: estimate, demo" in refused(capsys, "estmate")
    assert "--pairs" in refused(capsys, "evaluate", tmp_path, "--pairs", "many")
    assert "--far x: expected metres" in refused(capsys, "estimate", _depth(tmp_path), _depth(tmp_path), "--far", "x")


@pytest.mark.parametrize(
    "verb", [["evaluate", "out", "--pairs"], ["cell", "out", "--trials"], ["verifier", "make", "out", "--pairs"]]
)
def test_what_a_config_refuses_is_said_in_its_own_words(verb, capsys):
    assert refused(capsys, *verb, 0).startswith("reorient: expected at least one ")


@pytest.mark.parametrize(
    "wrong", [["--noise-mm", "nan"], ["--noise-mm", "inf"], ["--turn-deg", "nan"], ["--pose-seed", -1]]
)
def test_stations_that_cannot_be_rendered_are_refused(wrong, capsys, tmp_path):
    assert "a turn and noise from 0 on, all finite" in refused(capsys, "capture", tmp_path / "goal.npz", *wrong)


def test_outputs_that_cannot_be_made_are_refused_before_anything_moves(capsys, tmp_path):
    (tmp_path / "file").write_text("")
    assert "cannot make folder" in refused(capsys, "demo", "--out", tmp_path / "file")
    assert "cannot make folder" in refused(capsys, "objects", "make", tmp_path / "file", "--count", 1)
    assert "cannot make folder" in refused(capsys, "evaluate", tmp_path / "file", "--count", 1, "--pairs", 1)


@pytest.mark.parametrize("verb", [["estimate", "none.npz", "none.npz", "--explain"], ["objects", "montage"]])
def test_pictures_of_an_unknown_kind_are_refused_before_the_work(verb, capsys, tmp_path):
    assert "cannot write a picture as 'why.foo': expected one of .png" in refused(capsys, *verb, tmp_path / "why.foo")


def _depth(folder: Path) -> Path:
    write_depth(folder / "ball.npz", DepthImage(np.pad(np.full((20, 20), 0.6), 54), WORLD.camera))
    return folder / "ball.npz"
