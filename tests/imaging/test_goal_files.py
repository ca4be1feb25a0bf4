"""Goals go to disk and come back whole; broken files are refused in one line."""

import json
import zipfile

import numpy as np
import pytest

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage, Goal, GoalView
from reorient.imaging.files import read_depth, write_depth
from reorient.imaging.goal_files import read_goal, read_provenance, write_goal


def image_of(camera: Camera, seed: int) -> DepthImage:
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0.5, 0.7, (camera.height, camera.width))
    return DepthImage(np.where(rng.random(depth_m.shape) < 0.6, 0, depth_m), camera, 10.0 + seed, depth_m > 0.69)


@pytest.fixture
def goal(camera: Camera) -> Goal:
    R = so3.grid(2)
    views = (GoalView(image_of(camera, 1), R[0], np.array([0.1, 0.0, -0.2])), GoalView(image_of(camera, 2), R[1]))
    return Goal(image_of(camera, 0), views)


def test_a_goal_comes_back_whole(tmp_path, goal):
    write_goal(tmp_path / "goal.npz", goal, {"station": "rendered"})
    back = read_goal(tmp_path / "goal.npz")
    for one, other in zip((back, *back.views), (goal, *goal.views), strict=True):
        assert np.array_equal(one.image.depth_m, other.image.depth_m)
        assert np.array_equal(one.image.unknown, other.image.unknown)
        assert one.image.camera == other.image.camera
        assert one.image.stamp_s == other.image.stamp_s
    for one, other in zip(back.views, goal.views, strict=True):
        assert np.array_equal(one.R_goal_view, other.R_goal_view)
    assert np.array_equal(back.views[0].t_goal_view_m, goal.views[0].t_goal_view_m)
    assert back.views[1].t_goal_view_m is None
    provenance = read_provenance(tmp_path / "goal.npz")
    assert provenance["station"] == "rendered"
    assert {"reorient", "date"} <= set(provenance)


def test_a_goal_file_is_also_a_depth_image_and_any_depth_image_a_goal(tmp_path, goal):
    write_goal(tmp_path / "goal.npz", goal)
    assert np.array_equal(read_depth(tmp_path / "goal.npz").depth_m, goal.image.depth_m)
    for name in ("one.npz", "one.tif"):
        write_goal(tmp_path / name, Goal(goal.image))
        assert np.array_equal(read_depth(tmp_path / name).depth_m, goal.image.depth_m)
        assert read_goal(tmp_path / name).views == ()
    write_depth(tmp_path / "plain.png", goal.image)
    assert read_goal(tmp_path / "plain.png").views == ()
    assert read_provenance(tmp_path / "plain.png") == {}
    with pytest.raises(ReorientError, match="3 views.*expected .npz"):
        write_goal(tmp_path / "goal.png", goal)


def test_the_cameras_of_several_views_are_their_own(tmp_path, goal, camera):
    write_goal(tmp_path / "goal.npz", goal)
    other = Camera(camera.width, camera.height, 200.0, 200.0, 40.0, 30.0)
    assert read_goal(tmp_path / "goal.npz", other).image.camera == camera
    write_depth(tmp_path / "one.npz", goal.image)
    assert read_goal(tmp_path / "one.npz", other).image.camera == other


def rewritten(path, **changed):
    with np.load(path) as arrays:
        kept = dict(arrays) | changed
    np.savez(path, **{name: array for name, array in kept.items() if array is not None})


@pytest.mark.parametrize(
    "changed",
    [
        {"view_2_depth_m": None},
        {"t_goal_view_m": None},
        {"R_goal_view": np.zeros((2, 3, 3))},
        {"R_goal_view": np.eye(3)},
        {"R_goal_view": np.eye(3)[None]},
        {"t_goal_view_m": np.full((2, 3), np.inf)},
        {"view_1_depth_m": np.zeros((3, 3))},
        {"stated": np.array(json.dumps({"camera": {"width": 96, "height": 72, "fx": 1, "fy": 1, "cx": 1, "cy": 1}}))},
        {"view_1_depth_m": np.array([{}], object)},
    ],
)
def test_broken_goals_are_refused_in_one_line(tmp_path, goal, changed):
    path = tmp_path / "goal.npz"
    write_goal(path, goal)
    rewritten(path, **changed)
    with pytest.raises(ReorientError, match="expected") as caught:
        read_goal(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_truncated_and_missing_files_are_refused(tmp_path, goal):
    path = tmp_path / "goal.npz"
    write_goal(path, goal)
    whole = path.read_bytes()
    for end in (0, 100, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:end])
        with pytest.raises(ReorientError, match="expected"):
            read_goal(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("R_goal_view.npy", b"nothing")
    with pytest.raises(ReorientError, match="expected"):
        read_goal(path)
    with pytest.raises(ReorientError, match="no goal at"):
        read_goal(tmp_path / "absent.npz")
