"""The isolation options of the command line, on raw frames of an object on a table."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

from reorient import so3
from reorient.cli import main
from reorient.imaging import Camera, DepthImage
from reorient.imaging.files import read_depth, read_mask, write_camera, write_depth
from reorient.world.rendering import Placement, Renderer

CAMERA = Camera(200, 160, 260.0, 260.0, 100.0, 80.0)
R_CAMERA_WORLD = so3.exp(np.radians([130.0, 0.0, 0.0]))
MIDDLE_M = np.array([0.0, 0.0, 0.45])
ANGLE_DEG = 30.0


def view(*meshes):
    """Depth of meshes, and the pixels of the first one."""
    mesh = trimesh.util.concatenate(list(meshes))
    placement = Placement(1.0, R_CAMERA_WORLD @ mesh.bounds.mean(axis=0) + MIDDLE_M)
    renderer = Renderer(mesh, every_pixel=True)
    face = renderer.faces(CAMERA, R_CAMERA_WORLD, placement)
    depth_m = renderer.depth(CAMERA, R_CAMERA_WORLD, placement)
    return depth_m, (face >= 0) & (face < len(meshes[0].faces))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """now.png, goal.png of a part that is rotated on a table, empty.png of the table, their masks and camera."""
    folder = tmp_path_factory.mktemp("bench")
    bounds = (
        [(-0.06, -0.02, 0), (0.03, 0.02, 0.05)],
        [(0.03, -0.02, 0), (0.06, 0.06, 0.03)],
        [(-0.06, -0.05, 0), (-0.03, 0, 0.02)],
    )
    part = trimesh.util.concatenate([trimesh.creation.box(bounds=each) for each in bounds])
    table = trimesh.creation.box(bounds=[(-1, -1, -0.02), (1, 1, 0)])
    write_camera(folder / "camera.json", CAMERA)
    rng = np.random.default_rng(0)
    for name, angle_deg in (("now", 0.0), ("goal", ANGLE_DEG)):
        rotation = trimesh.transformations.rotation_matrix(np.radians(angle_deg), [0, 0, 1])
        depth_m, seen = view(part.copy().apply_transform(rotation), table)
        Image.fromarray(np.rint(1000 * (depth_m + rng.normal(0, 0.0005, depth_m.shape))).astype(np.uint16)).save(
            folder / f"{name}.png"
        )
        Image.fromarray(seen).convert("L").save(folder / f"{name}-mask.png")
        cut_out = np.dstack([np.full((*seen.shape, 3), 90, np.uint8), 255 * seen.astype(np.uint8)])
        Image.fromarray(cut_out).save(folder / f"{name}-cut-out.png")
    Image.fromarray(np.rint(1000 * view(table)[0]).astype(np.uint16)).save(folder / "empty.png")
    return folder


def run(capsys, folder, *options):
    """Output and errors of the estimate with these options."""
    main(
        [
            str(x)
            for x in ("estimate", folder / "now.png", folder / "goal.png", "--camera", folder / "camera.json", *options)
        ]
    )
    return capsys.readouterr()


def refusal(capsys, folder, *options):
    with pytest.raises(SystemExit) as ended:
        run(capsys, folder, *options)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


BOX = ("--box", "45", "25", "110", "110")


@pytest.mark.parametrize(
    "options",
    [
        ("--remove-plane",),
        ("--remove-plane", *BOX),
        ("--remove-plane", "--box-xyxy", "45", "25", "155", "135"),
        ("--remove-plane", "--around", "0", "0", "0.45", "0.12"),
        ("--background", "empty.png"),
        ("--mask", "now-mask.png", "goal-mask.png"),
        ("--mask", "now-cut-out.png", "goal-cut-out.png"),
    ],
)
def test_each_way_of_isolating_gives_the_rotation(options, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    data = json.loads(run(capsys, folder, *options, "--estimator", "gicp", "--json").out)
    expected = R_CAMERA_WORLD @ so3.exp(np.radians([0.0, 0.0, ANGLE_DEG])) @ R_CAMERA_WORLD.T
    assert np.degrees(so3.angle_difference(np.array(data["R_goal_current"]), expected)) < 3
    for name in ("current", "goal"):
        assert 0.1 < data[name]["size_m"][0] < 0.16
        assert data[name]["distance_m"] == pytest.approx(0.44, abs=0.03)
        assert not data[name]["touches_frame"]


def test_a_table_in_the_frame_is_refused_with_the_cure(folder, capsys):
    assert "add --remove-plane" in refusal(capsys, folder, *BOX, "--far", "0.9")
    assert "add --remove-plane" in refusal(capsys, folder, "--far", "0.45")
    line = refusal(capsys, folder, "--far", "0.2")
    assert "depths are 0." in line
    assert "--far is 0.2" in line


def test_the_input_is_shown_and_described(folder, capsys, tmp_path):
    out = run(
        capsys, folder, "--remove-plane", "--estimator", "gicp", "--show-input", tmp_path / "in.png"
    ).out.splitlines()
    assert out[0].startswith("current       object of 1")
    assert out[1].startswith("goal          object of 1")
    picture = np.asarray(Image.open(tmp_path / "in.png").convert("RGB")).astype(int)
    green = (picture[..., 1] > 2 * picture[..., 0]) & (picture[..., 1] > 1.2 * picture[..., 2])
    whole, near = green[30:360], green[420:760]
    assert 0 < 2 * whole.sum() < near.sum()
    refusal(capsys, folder, *BOX, "--show-input", tmp_path / "refused.png")
    assert Image.open(tmp_path / "refused.png").width < picture.shape[1]  # one frame, with what would be kept


def test_an_object_at_the_end_of_the_frame_and_another_size_are_warned_about(tmp_path, capsys):
    depth_m = np.zeros((160, 200), np.float32)
    rows, columns = np.mgrid[:160, :200]
    depth_m[40:120, 60:140] = 0.5 + 0.001 * ((rows + 2 * columns) % 37)[40:120, 60:140]
    write_depth(tmp_path / "now.npz", DepthImage(depth_m, CAMERA))
    write_depth(tmp_path / "goal.npz", DepthImage(np.roll(depth_m * (columns > 105), 60, axis=1), CAMERA))
    main(["estimate", str(tmp_path / "now.npz"), str(tmp_path / "goal.npz"), "--estimator", "gicp"])
    first, second = capsys.readouterr().err.splitlines()
    assert "warning: the object touches the frame of the goal image" in first
    assert "is it the same object" in second


def test_options_that_contradict_each_other_are_refused(folder, capsys):
    assert "--box with --box-xyxy: expected one of them" in refusal(capsys, folder, *BOX, "--box-xyxy", 1, 2, 3, 4)
    assert "expected left < right and top < bottom" in refusal(capsys, folder, "--box-xyxy", 5, 2, 3, 4)
    assert "--around with 3 numbers: expected x y z radius" in refusal(capsys, folder, "--around", 1, 2, 3)


def test_the_alpha_of_a_cut_out_is_a_mask_and_opaque_pictures_are_as_before(folder, tmp_path):
    seen = np.asarray(Image.open(folder / "now-mask.png")) > 0
    assert np.array_equal(read_mask(folder / "now-cut-out.png"), seen)
    opaque = np.dstack([*[255 * seen.astype(np.uint8)] * 3, np.full(seen.shape, 255, np.uint8)])
    Image.fromarray(opaque).save(tmp_path / "opaque.png")
    assert np.array_equal(read_mask(tmp_path / "opaque.png"), seen)


STATION = """
from dataclasses import replace
import numpy as np, trimesh
from reorient.stations.rendered import RenderedStation
from reorient.world.rendering import load_world
from reorient.world.sensing import Sensor

class Raw:
    'A station before a wall, which is in its images.'
    def __init__(self):
        ends = ((1, 0.2, 0.2), (0.2, 0.7, 0.2), (0.2, 0.1, 0.5))
        arms = [trimesh.creation.box(bounds=[(-0.2,) * 3, end]) for end in ends]
        mesh = trimesh.util.concatenate(arms)
        self._inner = RenderedStation(mesh, load_world("benchmark"), Sensor(), np.random.default_rng(0))
        self.pivot_m, self.rotate = self._inner.pivot_m, self._inner.rotate
    def capture(self):
        image = self._inner.capture()
        return replace(image, depth_m=np.where(image.valid, image.depth_m, np.float32(0.9)))
"""


def test_a_station_that_captures_whole_frames_is_isolated_by_the_options(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "raw_station.py").write_text(STATION)
    station = ["--station", "raw_station:Raw", "--far", "0.8"]
    main(["capture", "goal.npz", *station])
    goal = read_depth(tmp_path / "goal.npz")
    assert 0.05 < goal.valid.mean() < 0.5
    orient = ["orient", "goal.npz", *station, "--estimator", "gicp", "--strategy", "direct", "--dry-run"]
    main([*orient, "--isolate-station"])
    assert "estimate 0.00 deg: converged" in capsys.readouterr().out  # it is at its goal
    with pytest.raises(SystemExit) as ended:
        main(orient)
    assert ended.value.code == 1
    assert "isolate the object: returns fill 100%" in capsys.readouterr().err
