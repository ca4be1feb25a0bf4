"""The verbs of goals end to end: capture --views, goal check, goal from-mesh, estimate, orient, replay, transfer."""

import json

import numpy as np
import pytest

from reorient import read_goal, se3, so3
from reorient.cli import main
from reorient.cli.stations import StationChoice
from reorient.imaging.files import read_depth, write_depth
from reorient.imaging.goal_files import read_provenance
from reorient.perception.transfer import read_tool_poses, write_tool_poses
from reorient.world.objects import generated

RENDERED = ("--station", "rendered", "--noise-mm", "0.5")


def ended(capsys, *words) -> tuple[int, str, str]:
    code = 0
    try:
        main([str(word) for word in words])
    except SystemExit as end:
        code = int(end.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A taught goal, a start 40 degrees away, and the mesh of the simulator's object in millimetres."""
    folder = tmp_path_factory.mktemp("goals")
    main(["capture", str(folder / "goal.npz"), *RENDERED, "--views", "2", "--captures", "2"])
    main(["capture", str(folder / "now.npz"), *RENDERED, "--captures", "1", "--start-deg", "40"])
    objects = generated(1)
    mesh = objects.load(objects.names[0])
    mesh.apply_scale(100 / np.linalg.norm(mesh.vertices - mesh.bounds.mean(axis=0), axis=1).max())
    mesh.export(folder / "part.stl")
    return folder


def test_a_taught_goal_is_whole_and_states_what_it_tells(folder, capsys):
    goal = read_goal(folder / "goal.npz")
    assert len(goal.views) == 2
    assert (folder / "goal.png").stat().st_size > 1000
    provenance = read_provenance(folder / "goal.npz")
    assert (provenance["station"], provenance["captures_per_view"]) == ("rendered", 2)
    code, out, _ = ended(capsys, "goal", "check", folder / "goal.npz", "--picture", folder / "sheet.png")
    assert code == 0
    for expected in ("by reorient 0", "3 views, object of", "overlap with any start", "no remaining flip"):
        assert expected in out
    assert (folder / "sheet.png").is_file()
    code, out, _ = ended(capsys, "goal", "check", folder / "now.npz")
    assert "1 view, object of" in out
    assert "a loop can end unsure" in out


@pytest.mark.slow
def test_estimate_orient_and_replay_take_the_whole_goal(folder, capsys):
    code, out, _ = ended(capsys, "estimate", folder / "now.npz", folder / "goal.npz", "--json", "--estimator", "fast")
    assert abs(json.loads(out)["angle_deg"] - 40) < 2
    loop = ("orient", folder / "goal.npz", *RENDERED, "--start-deg", "15", "--estimator", "gicp")
    code, out, _ = ended(capsys, *loop, "--record", folder / "record")
    assert code == 0
    recorded, goal = read_goal(folder / "record" / "goal.npz"), read_goal(folder / "goal.npz")
    assert [view.R_goal_view.tolist() for view in recorded.views] == [v.R_goal_view.tolist() for v in goal.views]
    assert ended(capsys, "replay", folder / "record")[1] == out


@pytest.mark.slow
def test_orient_with_translation_is_recorded_and_replayed(folder, capsys):
    loop = ("orient", folder / "goal.npz", *RENDERED, "--start-deg", "15", "--estimator", "gicp", "--translation")
    code, out, err = ended(capsys, *loop, "--record", folder / "placed")
    assert (code, err) == (0, "")
    assert "mm from the goal's place" in out
    assert ended(capsys, "replay", folder / "placed")[1] == out


def test_a_goal_from_a_mesh_has_camera_and_place_of_the_capture(folder, capsys):
    now = read_depth(folder / "now.npz")
    out = folder / "cad.npz"
    code, text, _ = ended(
        capsys, *("goal", "from-mesh", folder / "part.stl", "--unit", "mm", "--rotation", 30, -20, 10),
        *("--capture", folder / "now.npz", "--out", out, "--views", 3),
    )  # fmt: skip
    assert code == 0
    assert "4 views, object of" in text
    goal = read_goal(out)
    assert goal.image.camera == now.camera
    assert "the capture shows this mesh" in text
    place_m = StationChoice("rendered").open().placement.center_m
    for view in goal.views:
        assert np.linalg.norm(view.R_goal_view @ place_m + view.t_goal_view_m - place_m) < 0.003
    assert read_provenance(out)["mesh"] == "part.stl"
    assert (folder / "cad.png").is_file()
    c = now.camera
    lens = {"width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "ppx": c.cx - 0.5, "ppy": c.cy - 0.5}
    lens |= {"model": "brown_conrady", "coeffs": [0.1, 0, 0, 0, 0]}  # estimate undoes it, so the goal has none
    (folder / "camera.json").write_text(json.dumps(lens))
    R = so3.exp(np.radians([30.0, -20.0, 10.0]))
    code, *_ = ended(
        capsys, *("goal", "from-mesh", folder / "part.stl", "--unit", "mm", "--rotation", *R.ravel()),
        *("--camera", folder / "camera.json", "--center", 0, 0, 0.6, "--out", folder / "other.npz", "--views", 0),
    )  # fmt: skip
    assert code == 0
    other = read_goal(folder / "other.npz").image
    assert other.camera == c
    low, high = np.percentile(other.points(), (1, 99), axis=0)
    assert np.linalg.norm((low + high)[:2] / 2) < 0.01


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--unit", "m", "--capture", "now.npz"), "is the unit mm"),
        (("--unit", "in", "--capture", "now.npz"), "is the unit mm"),
        (("--unit", "mm"), "expected one of --capture and --camera"),
        (("--unit", "mm", "--camera", "camera.json"), "--camera without --center"),
        (("--unit", "mm", "--capture", "now.npz", "--rotation", 1, 2), "expected a rotation vector"),
        (("--unit", "ell", "--capture", "now.npz"), "expected one of m, cm, mm, in"),
    ],
)
def test_wrong_options_of_from_mesh_are_refused_and_write_nothing(folder, capsys, monkeypatch, words, expected):
    monkeypatch.chdir(folder)
    code, _, err = ended(capsys, "goal", "from-mesh", "part.stl", *words, "--out", "none.npz")
    assert code == 2
    assert expected in err
    assert err.count("\n") == 1
    assert not (folder / "none.npz").exists()


def test_wrong_options_of_capture_are_refused_before_anything_moves(folder, capsys):
    assert "expected .npz" in ended(capsys, "capture", folder / "goal.tif", "--views", "2")[2]
    assert "expected an existing folder" in ended(capsys, "capture", folder / "absent" / "goal.npz")[2]
    assert "expected a number from 0" in ended(capsys, "capture", folder / "x.npz", "--views", "-1")[2]


# --- transfer -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cell(folder):
    """Taught poses, and a calibration."""
    T_base_camera = se3.transform(so3.exp(np.array([2.0, 0.3, -0.4])), np.array([0.4, 0.1, 0.7]))
    (folder / "calibration.json").write_text(
        json.dumps({"T_base_camera": T_base_camera.tolist(), "p_tool_object_m": [0, 0, 0.1]})
    )
    taught = np.array([T_base_camera @ se3.transform(np.eye(3), np.array([0.0, 0.0, z])) for z in (0.5, 0.55)])
    write_tool_poses(folder / "poses.csv", taught)
    return T_base_camera, taught


def test_transfer_writes_the_poses_for_the_object_now(folder, cell, capsys):
    T_base_camera, taught = cell
    words = ("transfer", folder / "now.npz", folder / "goal.npz", folder / "poses.csv")
    words += ("--calibration", folder / "calibration.json", "--estimator", "fast")
    code, out, _ = ended(capsys, *words, "--least-confidence", 0, "--out", folder / "moved.csv")
    assert code == 0
    assert "mm and" in out
    _, text, _ = ended(capsys, "estimate", folder / "now.npz", folder / "goal.npz", "--json", "--estimator", "fast")
    data = json.loads(text)
    T = se3.transform(np.array(data["R_goal_current"]), np.array(data["t_goal_current_m"]))
    expected = T_base_camera @ se3.inverse(T) @ se3.inverse(T_base_camera) @ taught
    np.testing.assert_allclose(read_tool_poses(folder / "moved.csv"), expected, atol=1e-6)
    code, out, _ = ended(capsys, *words, "--least-confidence", 0)
    assert out == (folder / "moved.csv").read_text()


def test_transfer_refuses_an_unsure_estimate_and_wrong_files(folder, cell, capsys):
    words = ["transfer", folder / "now.npz", folder / "goal.npz", folder / "poses.csv"]
    words += ["--calibration", folder / "calibration.json"]
    code, out, err = ended(capsys, *words, "--estimator", "gicp", "--out", folder / "none.csv")
    assert (code, out) == (1, "")
    assert "expected at least 0.9" in err
    assert not (folder / "none.csv").exists()
    (folder / "broken.csv").write_text("1,2,3\n")
    words[3] = folder / "broken.csv"
    code, _, err = ended(capsys, *words)
    assert (code, err.count("\n")) == (2, 1)


# --- scale ----------------------------------------------------------------------------------------------------------


def test_a_goal_of_another_scale_is_refused_by_the_unit(folder, capsys):
    now = read_depth(folder / "now.npz")
    near = type(now)(now.depth_m / 10, now.camera)  # an object of a tenth of the size, at a tenth of the distance
    write_depth(folder / "near.npz", near)
    code, _, err = ended(capsys, "estimate", folder / "near.npz", folder / "goal.npz")
    assert code == 2
    assert "a factor of about 10, as of a mesh in mm that is read as cm" in err
