"""Every verb end to end on tiny data; every bad input one line and exit code 2."""

import json
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from reorient import so3
from reorient.cli import main
from reorient.cli.estimating import as_data, in_words
from reorient.errors import MOST
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage
from reorient.imaging.files import read_depth, write_camera, write_depth
from reorient.registration import Evidence
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")
COUNTS = (
    ("evaluate out", "pairs"),
    ("evaluate out", "count"),
    ("cell out", "trials"),
    ("loops out", "trials"),
    ("loops out", "objects"),
    ("verifier make out", "pairs"),
    ("verifier make out", "per-shard"),
    ("generate out", "pairs-per-object"),
    ("train pairs out", "epochs"),
    ("train pairs out", "threads"),
    ("objects montage a.png", "columns"),
    ("orient goal.npz", "max-images"),
)
"""Verbs and their options that count something."""


def refused(capsys, *arguments) -> str:
    """The one line of a refused command on standard error."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert ended.value.code == 2
    text = capsys.readouterr().err.strip()
    assert text.startswith("reorient: ")
    assert "\n" not in text
    return text


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
    data = json.loads(capsys.readouterr().out)
    R = np.array(data["R_goal_current"])
    assert np.degrees(so3.angle_difference(R, truth.R_goal_current)) < 0.5
    np.testing.assert_allclose(so3.matrix_from_quat(np.array(data["quat_wxyz"])), R, atol=1e-9)
    np.testing.assert_allclose(so3.exp(np.array(data["rotvec_rad"])), R, atol=1e-9)
    np.testing.assert_allclose(R @ truth_center(truth) + data["t_goal_current_m"], truth_center(truth), atol=0.01)
    assert data["angle_deg"] == pytest.approx(20, abs=0.5)
    assert 0 < data["confidence"] <= 1
    evidence = data["evidence"]
    assert evidence["inlier_ratio"] > 0.5
    assert evidence["covisible_inlier_ratio"] == pytest.approx(evidence["inlier_ratio"] / (1 - evidence["occluded"]))


def truth_center(pair) -> np.ndarray:
    """The point that the rotation of a pair keeps."""
    return pair.placement.center_m


def test_estimate_explained(pair, capsys):
    folder, _ = pair
    main(["estimate", str(folder / "now.npz"), str(folder / "goal.npz"), "--explain", str(folder / "why.png")])
    assert re.search(r"^confidence +\d\d\.\d% \(error below 5 deg\)$", capsys.readouterr().out, re.MULTILINE)
    assert Image.open(folder / "why.png").width > 1000


def test_an_estimate_in_words():
    """One line for each part, the numbers rounded for people; what is not known is a dash."""
    evidence = Evidence(0.3, 0.02, 0.03, 0.65, 0.00049)
    R = so3.exp(np.radians([0.0, 42.3, 0.0]))
    flipped = so3.exp(np.array([0.0, 0.0, np.pi])) @ R
    sure = RotationEstimate(R, np.array([0.1, 0, -0.02]), evidence, 0.9989, ((flipped, 0.123),))
    assert in_words(sure).splitlines() == [
        "rotation      42.30 deg about [0.0000 1.0000 0.0000] (camera axes)",
        "quaternion    [0.932639 0.000000 0.360811 0.000000] (wxyz)",
        "matrix         0.739631  0.000000  0.673013",
        "               0.000000  1.000000  0.000000",
        "              -0.673013  0.000000  0.739631",
        "translation   [0.1000 0.0000 -0.0200] m",
        "confidence    99.9% (error below 5 deg)",
        "inliers       30% (86% of co-visible points), residual 0.49 mm",
        "violations    free space 2%, silhouette 3%",
        "occluded      65%",
        "alternative   12.3%: the estimate rotated by 180.00 deg about [0.0000 0.0000 1.0000]",
    ]
    lost = RotationEstimate(np.eye(3), np.zeros(3), Evidence(0.0, 0.0, 0.0, 1.0, float("nan")))
    words = in_words(lost)
    assert "confidence    not available (estimator is not calibrated)" in words
    assert "inliers       0% (- of co-visible points), residual - mm" in words
    assert as_data(lost)["evidence"]["residual_m"] is None


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
    assert "--far x: expected metres from 0" in refused(capsys, *common, "--far", "x")


def test_bad_images(pair, capsys, tmp_path, unchecked):
    folder, truth = pair
    good = folder / "goal.npz"
    camera = WORLD.camera
    depth_m = truth.current.depth_m

    def text(name, array, *more):
        np.save(tmp_path / name, array)
        return refused(capsys, "estimate", tmp_path / name, good, "--camera", folder / "camera.json", *more)

    assert "looks like millimetres" in text("mm.npy", depth_m * 1000)
    assert "0 everywhere" in text("nan.npy", np.full_like(depth_m, np.nan))
    assert "expected no negative value" in text("negative.npy", depth_m - 0.3)
    assert "0 everywhere" in text("zero.npy", 0 * depth_m)
    assert "dtype uint8: expected 16 bits or more" in text("dtype.npy", (depth_m * 100).astype(np.uint8))
    assert "has 128 x 100, another aspect ratio" in text("size.npy", depth_m[:100])
    assert "a picture of three colours is no depth" in text("channels.npy", np.stack([depth_m] * 3, axis=-1))
    (tmp_path / "pickle.npy").write_bytes(pickle.dumps(depth_m))
    assert "is a pickle" in refused(capsys, "estimate", tmp_path / "pickle.npy", good)
    np.save(tmp_path / "fine.npy", depth_m)
    assert "missing intrinsics" in refused(capsys, "estimate", tmp_path / "fine.npy", good)
    (tmp_path / "half.npz").write_bytes(good.read_bytes()[:500])
    assert "expected a complete file" in refused(capsys, "estimate", tmp_path / "half.npz", good)
    (tmp_path / "camera.json").write_text("{")
    assert "is not JSON" in refused(
        capsys, "estimate", tmp_path / "fine.npy", good, "--camera", tmp_path / "camera.json"
    )
    Image.fromarray(np.zeros((128, 128), np.uint8)).save(tmp_path / "black.png")
    assert "mask is empty" in text("fine.npy", depth_m, "--mask", tmp_path / "black.png")
    assert "expected an existing file" in refused(capsys, "estimate", tmp_path / "none.npz", good)
    assert "did you mean 'gicp'" in refused(capsys, "estimate", good, good, "--estimator", "gipc")
    write_depth(tmp_path / "dot.npz", DepthImage(np.pad([[0.6]], ((0, 127), (0, 127))), camera))
    assert "has 1 returns: expected at least" in refused(capsys, "estimate", tmp_path / "dot.npz", good)


def test_a_camera_file_of_another_resolution_is_scaled_and_noted(pair, caplog, tmp_path):
    folder, _ = pair
    K = {"K": [[662.0, 0, 127.5], [0, 662.0, 127.5], [0, 0, 1]], "width": 256, "height": 256}
    (tmp_path / "K.json").write_text(json.dumps(K))
    main(["estimate", str(folder / "now.npz"), str(folder / "goal.npz"), "--camera", str(tmp_path / "K.json")])
    assert "is for 256 x 256 px, scaled by 0.5 to the 128 x 128 px" in caplog.text


def ended(capsys, *arguments) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    code = 0
    try:
        main([str(a) for a in arguments])
    except SystemExit as end:
        code = int(end.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_capture_and_orient(capsys, tmp_path):
    goal = tmp_path / "goal.png"
    main(["capture", str(goal)])
    assert read_depth(goal).camera == WORLD.camera
    capsys.readouterr()
    one = [
        "orient",
        goal,
        "--station",
        "rendered",
        "--strategy",
        "algorithm1",
        "--estimator",
        "gicp",
        "--start-deg",
        12,
    ]
    code, out, _ = ended(capsys, *one, "--eta", "0.5", "--out", tmp_path / "run")
    assert code == 0
    lines = out.splitlines()
    moves = sum("rotating by 50%" in line for line in lines)
    assert moves >= 4  # 12 degrees halved until 0.5 is left
    assert f"converged after {moves} moves, confidence not available (estimator is not calibrated)" in lines
    assert (tmp_path / "run" / "loop.gif").is_file()
    code, out, err = ended(capsys, *one, "--max-images", 1)
    assert code == 1
    assert err.startswith("reorient: not converged after 1 move (max_images): ")
    assert "did you mean 'fusing'" in refused(capsys, "orient", goal, "--station", "rendered", "--strategy", "fusin")


def test_orient_with_limits_a_record_and_its_replay(capsys, tmp_path, monkeypatch):
    goal, record = tmp_path / "goal.npz", tmp_path / "record"
    main(["capture", str(goal)])
    capsys.readouterr()
    rotated = ["orient", goal, "--station", "rendered", "--start-deg", 100, "--noise-mm", 1, "--estimator", "fast"]
    dry = ended(capsys, *rotated, "--dry-run", "--record", tmp_path / "dry")
    assert dry[0] == 0
    assert re.match(r"dry run: would rotate by [\d.]+ deg \(rotation vector \[.*\] deg, ", dry[1].splitlines()[-1])
    assert ended(capsys, "replay", tmp_path / "dry") == dry
    monkeypatch.setattr("builtins.input", lambda: "n")
    code, _, err = ended(capsys, *rotated, "--confirm-first-move")
    assert code == 1
    assert err.splitlines()[-1].startswith("reorient: not converged after 0 moves (declined): ")
    code, _, err = ended(capsys, *rotated, "--max-rotation-deg", 40)
    assert code == 1
    assert err.startswith("reorient: not converged after 0 moves (max_rotation): ")
    monkeypatch.setattr("builtins.input", lambda: "y")
    code, out, asked = ended(capsys, *rotated, "--confirm-first-move", "--max-step-deg", 60, "--record", record)
    assert code == 0
    assert re.fullmatch(
        r"first move: [\d.]+ deg \(rotation vector \[.*\] deg, camera axes\)\nmake this move\? \[y/N\]\n", asked
    )
    assert re.search(r"^converged after [1-9]", out, re.MULTILINE)
    about = json.loads((record / "record.json").read_text())
    assert {"station", "version", "commit", "estimator"} <= set(about)
    code, again, _ = ended(capsys, "replay", record, "--out", tmp_path / "again")
    assert code == 0
    assert [line for line in again.splitlines() if str(tmp_path) not in line] == out.splitlines()
    assert (tmp_path / "again" / "loop.html").is_file()
    assert "holds a record: expected a new folder" in refused(capsys, *rotated, "--record", record)
    assert "no record.json in" in refused(capsys, "replay", tmp_path)


SETTINGS = {"strategy": "auto", "max_images": None, "eta": None, "delta_deg": None}


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ({"estimator": 3}, "unknown estimator '3'"),
        ({"strategy": SETTINGS | {"strategy": "fusin"}}, "did you mean 'fusing'"),
        *(
            (broken, "lacks valid settings")
            for broken in (
                {"strategy": None},
                {"strategy": [3] * 4},
                {"strategy": SETTINGS | {"eta": "x"}},
                {"strategy": SETTINGS | {"delta_deg": "x"}},
                {"strategy": SETTINGS | {"speed": 1}},
                {"limits": {"max_step_deg": "x"}},
                {"limits": 3},
            )
        ),
    ],
)
def test_broken_records_are_refused(broken, message, capsys, tmp_path, unchecked):
    (tmp_path / "goal.npz").write_bytes(_depth(tmp_path).read_bytes())
    record = {"estimator": "fast", "strategy": SETTINGS, "limits": {}, "pivot_m": None, "acts": []}
    (tmp_path / "record.json").write_text(json.dumps(record | broken))
    assert message in refused(capsys, "replay", tmp_path)


def test_the_verifier_is_not_trained_without_the_extra(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("reorient.extras.find_spec", lambda module: None)
    message = refused(capsys, "verifier", "train", tmp_path, "verifier.npz")
    assert "needs sklearn: pip install 'reorient[train]'" in message


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
    one = ["orient", "goal.npz", "--station", "rendered", "--start-deg", "12", "--dry-run", "--estimator"]
    for more, angle_deg in (
        (["my_estimators:Plain"], 2.4),
        (["my_estimators:Sure"], 12),
        (["my_estimators:Sure", "--eta", "0.5"], 6),
        (["my_estimators:Sure", "--strategy", "direct"], 12),
        (["gicp", "--strategy", "algorithm1", "--max-images", "3"], 2.4),
    ):
        main([*one, *more])
        planned = re.search(r"rotate by ([\d.]+) deg", capsys.readouterr().out)
        assert planned
        assert float(planned[1]) == pytest.approx(angle_deg, abs=0.2)


def test_nothing_is_left_behind_where_the_estimator_is_unknown(capsys, tmp_path):
    main(["capture", str(tmp_path / "goal.npz")])
    one = ["orient", tmp_path / "goal.npz", "--station", "rendered", "--record", tmp_path / "record"]
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
    assert "failed to capture: OSError: no camera [broken_cell.py, line 4]" in refused(
        capsys, "capture", goal, "--station", "broken_cell:Cell"
    )
    assert goal.read_bytes() == b"old"
    assert list(tmp_path.glob(".*goal*")) == []
    assert "has no capture, rotate" in refused(capsys, "capture", goal, "--station", "broken_cell:Half")
    assert "(OSError: no camera on bus 3 [broken_cell.py, line 11])" in refused(
        capsys, "capture", goal, "--station", "broken_cell:Wordy"
    )
    assert "cannot make station" in refused(capsys, "capture", goal, "--station", "nowhere:Cell")
    assert "expected 'rendered', a robot.toml or my_module:MyStation" in refused(
        capsys, "capture", goal, "--station", "rendred"
    )
    assert "expected an existing folder" in refused(capsys, "capture", tmp_path / "none" / "goal.npz")


def test_demo(capsys, tmp_path):
    main(["demo", "--out", str(tmp_path / "demo"), "--start-deg", "100", "--estimator", "fast"])
    lines = capsys.readouterr().out.strip().splitlines()
    assert lines[0] == "Generated object 51, 100 deg from its goal; estimator fast"
    assert lines[1].startswith("[1] true error 100.00 deg; ")
    errors_deg = [float(line.split()[3]) for line in lines if line.startswith("[")]
    assert errors_deg[-1] < 1
    assert re.fullmatch(r"converged after [1-9] moves?, confidence \d\d\.\d% \(error below 5 deg\)", lines[-3])
    for path in map(Path, lines[-2:]):
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
    text = capsys.readouterr().out
    assert "symmetric (residual below 0.05)" in text
    assert "refused: " in text
    assert (tmp_path / "check.csv.gz").is_file()
    main(["objects", "montage", str(tmp_path / "bin.png"), "--count", "4", "--columns", "2", "--size-px", "64"])
    assert Image.open(tmp_path / "bin.png").width > 128
    assert "no folder" in refused(capsys, "objects", "list", "--meshes", tmp_path / "none")


def test_evaluate_and_report(capsys, tmp_path):
    out = tmp_path / "run"
    main(["evaluate", str(out), "--count", "2", "--pairs", "2", "--ranges-deg", "0", "30", "--noise-mm", "0"])
    text = capsys.readouterr().out
    assert "gicp" in text
    assert str(out / "rows.csv.gz") in text.replace("\n", "")
    assert "| 0 mm | 0–30° | gicp | 2 |" in (out / "table.md").read_text()
    main(["report", str(out)])
    page = Path(capsys.readouterr().out.strip())
    assert page.is_file()
    assert "expected config.json" in refused(capsys, "report", tmp_path)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        *(
            (f"{verb} --{name} 0", f"--{name} 0: expected a number from 1 to {1024 if name == 'threads' else MOST}")
            for verb, name in COUNTS
        ),
        ("evaluate out --noise-mm 1 -1", "--noise-mm 1 -1: expected numbers from 0"),
        ("evaluate out --ranges-deg 30 0", "--ranges-deg 30 0: expected 0 <= low <= high <= 180"),
        ("cell out --ranges-deg 0 30", "--ranges-deg 0 30: expected 0 < low <= high <= 180"),
        ("cell out --noise-mm 100", "--noise-mm 100: expected a number from 0 and below 100"),
        ("loops out --faults 2", "--faults 2: expected a number from 0 to 1"),
        ("loops out --slack-deg -1", "--slack-deg -1: expected a number from 0"),
        ("loops out --start-deg any 0", "--start-deg any 0: expected degrees above 0, at most 180, or 'any'"),
        ("loops out --workers 0", "--workers 0: expected at least 1, or -1 for one per core"),
        ("objects list --object-seed -1", "--object-seed -1: expected a number from 0"),
        ("objects montage a.png --size-px 4", "--size-px 4: expected a number from 8 to 4096"),
        ("capture goal.npz --noise-mm nan", "--noise-mm nan: expected a number from 0"),
        ("capture goal.npz --noise-mm inf", "--noise-mm inf: expected a number from 0"),
        ("capture goal.npz --pose-seed -1", "--pose-seed -1: expected a number from 0"),
        ("demo --start-deg 181", "--start-deg 181: expected a number from 0 to 180"),
        ("orient goal.npz --start-deg 200", "--start-deg 200: expected a number from 0 to 180"),
        ("orient goal.npz --max-step-deg 0", "--max-step-deg 0: expected a number above 0"),
        ("orient goal.npz --max-rotation-deg -5", "--max-rotation-deg -5: expected a number above 0"),
        ("orient goal.npz --eta 0", "--eta 0: expected a number above 0 to 1"),
        ("orient goal.npz --delta-deg -1", "--delta-deg -1: expected a number from 0 to 180"),
    ],
)
def test_a_value_out_of_range_is_named_by_its_option(command, message, capsys):
    assert refused(capsys, *command.split()) == f"reorient: {message}"


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("orient goal.npz --max-images 5", "--max-images 5: expected --strategy with it"),
        ("orient goal.npz --strategy fusing --eta 0.3", "--eta is an option of algorithm1, not of fusing"),
        ("orient goal.npz --strategy direct --eta 0.3", "--eta is an option of algorithm1, not of direct"),
        (
            "orient a --strategy fusing --delta-deg 1",
            "--delta-deg is an option of algorithm1 and direct, not of fusing",
        ),
        ("evaluate out --only none.txt", "no file 'none.txt': expected object names, one a line"),
        ("replay none", "no record.json in 'none': expected a folder of `reorient orient --record`"),
    ],
)
def test_options_and_files_that_do_not_fit(command, message, capsys):
    assert refused(capsys, *command.split()) == f"reorient: {message}"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("ball.npz --near 1 --far 0.5", "--near 1 --far 0.5: expected --near below --far"),
        ("none.npz --near 1 --far 0.5", "--near 1 --far 0.5: expected --near below --far"),  # before reading
        (
            "ball.npz --near 0.7 --far 0.9",
            "ball.npz: no returns in the depth range: depths are 0.60-0.60 m; --near is 0.7, --far is 0.9",
        ),
        ("ball.npz --near 5", "ball.npz: no returns in the depth range: depths are 0.60-0.60 m; --near is 5"),
        ("ball.npz --near nan", "--near nan: expected metres from 0, or '-' for none"),
        (". --near 0.3", "'.' is a folder: expected a file"),
    ],
)
def test_images_without_the_object_are_named(words, message, capsys, tmp_path, monkeypatch):
    _depth(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert refused(capsys, "estimate", *words.split()[:1], "ball.npz", *words.split()[1:]) == f"reorient: {message}"


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
