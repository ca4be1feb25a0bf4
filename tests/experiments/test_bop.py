"""A miniature BOP dataset, written here with the renderer, and the errors of BOP on it."""

import csv
import gzip
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from reorient import se3, so3
from reorient.cli import main
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.experiments.bop import BOP_COLUMNS, BopEvaluation, evaluate_bop
from reorient.experiments.bop_data import load_model, views
from reorient.imaging import Camera
from reorient.registration import Evidence
from reorient.reporting.bop import bop_table, recall
from reorient.reporting.rows import read_rows
from reorient.runs.pool import Pool
from reorient.world.rendering import Placement, Renderer

K = [220.0, 0, 79.5, 0, 220.0, 59.5, 0, 0, 1]
CAMERA = Camera.from_K(np.array(K).reshape(3, 3), 160, 120)
TURNS_DEG = (0, 15, 40, 100)  # of the scene about a tilted axis, one image each


def corner() -> trimesh.Trimesh:
    arms = [trimesh.creation.box(bounds=[(-20, -20, -20), end]) for end in ((60, 0, 0), (0, 45, 0), (0, 0, 30))]
    return trimesh.boolean.union(arms, engine="manifold")


MODELS = {1: corner(), 2: trimesh.creation.cylinder(25, 80, sections=64)}
INFO = {
    1: {"diameter": 100.0},
    2: {
        "diameter": 94.3,
        "symmetries_discrete": [np.diag([1.0, -1, -1, 1]).ravel().tolist()],
        "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}],
    },
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """One scene of two objects before a wall; its images differ by known rotations of everything."""
    root = tmp_path_factory.mktemp("bop") / "mini"
    scene = root / "test" / "000048"
    for folder in (root / "models_eval", scene / "depth", scene / "mask_visib"):
        folder.mkdir(parents=True)
    for obj_id, mesh in MODELS.items():
        mesh.export(root / "models_eval" / f"obj_{obj_id:06d}.ply")
    (root / "models_eval" / "models_info.json").write_text(json.dumps(INFO))
    renderers = {obj_id: Renderer(mesh) for obj_id, mesh in MODELS.items()}
    shift = {obj_id: mesh.bounds.mean(axis=0) for obj_id, mesh in MODELS.items()}  # the renderer centres the mesh
    cameras, truth, info = {}, {}, {}
    for index, turn in enumerate(TURNS_DEG):
        image, R = 3 * index + 1, so3.exp(np.radians(turn) * np.array([0.48, 0.64, 0.6]))
        depths, annotations = [], []
        for obj_id, center_m in ((2, [-0.07, 0.0, 0.5]), (1, [0.05, 0.01, 0.55])):
            R_model = R @ so3.exp(np.array([0.5, 0.3 * obj_id, 0.2]))
            depths.append(renderers[obj_id].depth(CAMERA, R_model, Placement(0.001, np.array(center_m))))
            t_mm = 1000 * np.array(center_m) - R_model @ shift[obj_id]
            annotations.append(
                {"cam_R_m2c": R_model.round(8).ravel().tolist(), "cam_t_m2c": t_mm.tolist(), "obj_id": obj_id}
            )
        nearest = np.min([np.where(depth > 0, depth, 1.2) for depth in depths], axis=0)
        Image.fromarray(np.rint(nearest * 10000).astype(np.uint16)).save(scene / "depth" / f"{image:06d}.png")
        for place, depth in enumerate(depths):
            mask = (depth > 0) & (depth <= nearest)
            Image.fromarray(mask).convert("L").save(scene / "mask_visib" / f"{image:06d}_{place:06d}.png")
        cameras[image], truth[image] = {"cam_K": K, "depth_scale": 0.1}, annotations
        info[image] = [{"visib_fract": 1.0}, {"visib_fract": 1.0}]
    for name, content in (("scene_camera", cameras), ("scene_gt", truth), ("scene_gt_info", info)):
        (scene / f"{name}.json").write_text(json.dumps(content))
    return root


def run(config, out):
    list(evaluate_bop(config, out, Pool()))
    with gzip.open(out / "rows.csv.gz", "rt", newline="") as file:
        return list(csv.DictReader(file))


def test_a_view_is_the_object_alone_at_its_pose(dataset):
    """The model at the stated pose explains the depth: every return lies on its surface."""
    surface = cKDTree(trimesh.sample.sample_surface(MODELS[1], 100_000, seed=0)[0])
    for view in views(dataset, "test", (1,)):
        points = se3.apply(se3.inverse(view.pose()), view.depth().points())
        assert len(points) > 300
        assert surface.query(1000 * points)[0].max() < 1


def test_small_rotations_between_views_are_found(dataset, tmp_path):
    (tmp_path / "pairs.csv").write_text("scene_id,obj_id,im_id,im_id_goal\n48,1,1,4\n48,1,4,7\n48,2,1,4\n48,2,7,4\n")
    rows = run(BopEvaluation(dataset, pair_list=tmp_path / "pairs.csv", estimators=("gicp",)), tmp_path / "out")
    assert list(rows[0]) == BOP_COLUMNS
    assert [float(row["angle_deg"]) for row in rows] == pytest.approx([15, 25, 15, 25], abs=1e-3)
    assert [row["object"] for row in rows] == ["obj_000001"] * 2 + ["obj_000002"] * 2
    for row in rows:
        assert float(row["error_sym_deg"]) < 2
        assert float(row["mssd_mm"]) < 3
    assert recall(rows) == 1.0
    assert max(float(row["error_deg"]) for row in rows[:2]) < 2


class Nothing:
    """Estimates the identity."""

    def estimate(self, current, goal, pivot_m=None, history=()):
        return RotationEstimate(np.eye(3), np.zeros(3), Evidence(1.0, 0.0, 0.0, 0.0, 0.0))


def test_no_rotation_has_the_error_of_the_truth(dataset, tmp_path, monkeypatch):
    """Errors by hand: the identity misses the whole rotation; about the cylinder's axis only its tilt counts."""
    import reorient.experiments.bop as bop

    monkeypatch.setattr(bop, "cached_estimator", lambda name: Nothing())
    rows = run(BopEvaluation(dataset, pairs=12, seed=1), tmp_path / "out")
    assert len(rows) == 24
    by_image = {(view.obj_id, view.image): view for view in views(dataset, "test", ())}
    for row in rows:
        obj_id = int(row["object"][-1])
        current, goal = (by_image[obj_id, int(row[name])].pose() for name in ("image", "image_goal"))
        turned = goal[:3, :3] @ current[:3, :3].T
        assert float(row["error_deg"]) == pytest.approx(float(row["angle_deg"]), abs=1e-3)
        assert float(row["angle_deg"]) == pytest.approx(np.degrees(so3.angle(turned)), abs=1e-3)
        if obj_id == 1:
            assert float(row["error_sym_deg"]) == pytest.approx(float(row["error_deg"]), abs=1e-3)
        else:
            tilt = np.degrees(np.arccos(abs(current[:3, 2] @ goal[:3, 2])))
            assert float(row["error_sym_deg"]) == pytest.approx(tilt, abs=1e-3)
    assert 0 < recall(rows) < 1


def test_symmetric_poses_have_no_error(dataset, rng):
    for obj_id in (1, 2):
        model = load_model(dataset, obj_id)
        T = se3.transform(so3.sample_uniform(rng, 1)[0], np.array([0.1, 0.2, 0.6]))
        spin = se3.transform(so3.exp(np.array([0.0, 0.0, 2 * np.pi * 40 / 315])), np.zeros(3))
        flip = np.diag([1.0, -1, -1, 1])
        symmetric = spin @ flip if obj_id == 2 else np.eye(4)
        assert np.degrees(model.rotation_error((T @ symmetric)[:3, :3], T[:3, :3])) < 1e-4
        assert model.mssd_m(T @ symmetric, T) < 1e-9
        tilted = T @ se3.transform(so3.exp(np.array([0.3, 0.0, 0.0])), np.array([0.0, 0.0, 0.01]))
        assert model.rotation_error(tilted[:3, :3], T[:3, :3]) == pytest.approx(0.3)


def test_an_axis_of_symmetry_may_lie_anywhere(dataset):
    """A model that is not centred: its axis passes through the offset."""
    model, offset_m = load_model(dataset, 2), np.array([0.02, -0.01, 0.03])
    shifted = replace(model, vertices_m=model.vertices_m + offset_m, discrete=np.eye(4)[None], offsets_m=offset_m[None])
    R = so3.exp(np.array([0.0, 0.0, 2 * np.pi * 40 / 315]))
    assert shifted.mssd_m(se3.transform(R, offset_m - R @ offset_m), np.eye(4)) < 1e-9
    assert shifted.mssd_m(se3.transform(R, np.zeros(3)), np.eye(4)) > 0.01


def test_mssd_is_the_largest_distance_over_all_vertices(dataset, rng):
    """By its definition, without the convex hull: the least over the symmetries of the largest vertex distance."""
    T, T_true = (
        se3.transform(R, t) for R, t in zip(so3.sample_uniform(rng, 2), rng.normal(0, 0.1, (2, 3)), strict=True)
    )
    vertices_m = MODELS[1].vertices / 1000
    expected = np.linalg.norm(se3.apply(T, vertices_m) - se3.apply(T_true, vertices_m), axis=1).max()
    assert load_model(dataset, 1).mssd_m(T, T_true) == pytest.approx(expected)
    vertices_m = MODELS[2].vertices / 1000
    spins = [Rotation.from_euler("z", angle).as_matrix() for angle in np.linspace(0, 2 * np.pi, 316)[:-1]]
    least = min(
        np.linalg.norm(se3.apply(T, vertices_m) - se3.apply(T_true, vertices_m @ (spin @ flip).T), axis=1).max()
        for spin in spins
        for flip in (np.eye(3), np.diag([1.0, -1, -1]))
    )
    assert load_model(dataset, 2).mssd_m(T, T_true) == pytest.approx(least)


def test_hidden_objects_are_no_views(dataset, tmp_path):
    info = dataset / "test" / "000048" / "scene_gt_info.json"
    before = info.read_text()
    shares = json.loads(before)
    shares["4"][1]["visib_fract"] = 0.05
    try:
        info.write_text(json.dumps(shares))
        from reorient.experiments import bop_data

        bop_data._scene.cache_clear()
        assert [view.image for view in views(dataset, "test", (1,))] == [1, 7, 10]
    finally:
        info.write_text(before)
        bop_data._scene.cache_clear()


def test_the_command_line(dataset, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--bop", str(dataset), "--objects", "1", "--pairs", "4", "--estimators", "gicp", "--seed", "3"]
    main(["evaluate", str(out), *options])
    printed = capsys.readouterr().out
    assert "| rotation | estimator | pairs | refused |" in printed
    assert "| all | gicp | 4 | 0 |" in printed
    before = (out / "rows.csv.gz").read_bytes()
    main(["evaluate", str(out), *options])  # finished: nothing is measured again
    assert (out / "rows.csv.gz").read_bytes() == before
    rows = read_rows(out)
    assert len({(row["image"], row["image_goal"]) for row in rows}) == 4
    assert all(row["image"] != row["image_goal"] for row in rows)
    assert bop_table(rows) == (out / "table.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--split", "val"), r"no scenes in .*val.*: expected folders with scene_gt.json .*--split test"),
        (("--objects", "9"), r"no views of object 9 in .*expected some of \[1, 2\]"),
        (("--pairs", "500"), r"\d+ different pairs found: expected 500"),
        (("--pair-list", "nowhere.csv"), "no list of pairs at 'nowhere.csv'"),
        (("--pair-list", "empty.csv"), "lacks columns or rows: expected scene_id"),
        (("--pair-list", "wrong.csv"), "line 2 of 'wrong.csv': 0 views of object 7 in image 1 of scene 48"),
        (("--pair-list", "words.csv"), "line 2 of 'words.csv': expected whole numbers"),
        (("--estimators", "gipc"), "did you mean 'gicp'"),
    ],
)
def test_what_cannot_be_measured_is_refused(options, message, dataset, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.csv").write_text("")
    header = "scene_id,obj_id,im_id,im_id_goal\n"
    (tmp_path / "wrong.csv").write_text(header + "48,7,1,4\n")
    (tmp_path / "words.csv").write_text(header + "48,one,1,4\n")
    with pytest.raises(SystemExit):
        main(["evaluate", "out", "--bop", str(dataset), "--pairs", "2", *options])
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(message, error), error


def test_options_of_bop_need_a_dataset(capsys):
    with pytest.raises(SystemExit):
        main(["evaluate", "out", "--objects", "3"])
    assert "expected --bop DATASET" in capsys.readouterr().err


def test_a_broken_dataset_is_refused(dataset, tmp_path):
    for name in ("scene_gt.json", "scene_camera.json"):
        broken = tmp_path / name
        scene = broken / "test" / "000001"
        scene.mkdir(parents=True)
        (scene / "scene_gt.json").write_text("[1]" if name == "scene_gt.json" else json.dumps({"1": [], "2": []}))
        with pytest.raises(ReorientError, match="expected"):
            run(BopEvaluation(broken), tmp_path / f"out-{name}")


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("scene_gt.json", "obj_id", None),
        ("scene_gt.json", "cam_R_m2c", [1.0, 0.0]),
        ("scene_gt.json", "cam_t_m2c", "near"),
        ("models_info.json", "diameter", None),
        ("models_info.json", "symmetries_discrete", [[1.0] * 15]),
    ],
)
def test_what_is_missing_or_wrong_in_a_file_is_named(dataset, tmp_path, name, key, value):
    broken = tmp_path / "broken"
    shutil.copytree(dataset, broken)
    (file,) = broken.rglob(name)
    content = json.loads(file.read_text())
    (content["1"][1] if name == "scene_gt.json" else content["1"])[key] = value
    file.write_text(json.dumps(content))
    with pytest.raises(ReorientError, match=rf"{name}' is not in BOP's layout \(.*\): expected"):
        run(BopEvaluation(broken, objects=(1,), pairs=6, estimators=("gicp",)), tmp_path / "out")


def test_files_that_contradict_each_other_are_refused(dataset, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(dataset, broken)
    (file,) = broken.rglob("scene_gt_info.json")
    file.write_text(json.dumps({"4": [{"visib_fract": 1.0}]}))  # of two instances
    with pytest.raises(ReorientError, match=r"expected obj_id of each instance, as many as scene_gt_info.json has"):
        views(broken, "test", ())
