"""The shipped networks, run without torch: known rotations, whatever the camera, and the direction of the answer."""

import subprocess
import sys

import numpy as np
import pytest

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators import learned, load_estimator
from reorient.imaging import Camera, DepthImage
from reorient.world import shapes
from reorient.world.rendering import Placement, Renderer

CAMERAS = {
    "f = 300": Camera(128, 128, 300.0, 300.0, 64.0, 64.0),
    "f = 535": Camera(320, 240, 535.0, 535.0, 160.0, 120.0),
    "f = 1122": Camera(1032, 772, 1122.0, 1122.0, 512.0, 384.5),
    "off-centre": Camera(400, 300, 535.0, 520.0, 90.5, 230.0),
}
OBJECTS = range(16)  # of a sequence that no network was trained on
WITHIN_DEG = {"paper": 10.0, "swift": 5.0}


def pairs(camera, turn_deg):
    """One pair of each object, a known rotation apart."""
    rng = np.random.default_rng(5)
    middle = np.array([(camera.width / 2 - camera.cx) / camera.fx, (camera.height / 2 - camera.cy) / camera.fy, 1.0])
    placement = Placement(0.1, 0.6 * middle)
    turn = np.radians(turn_deg)
    for index in OBJECTS:
        renderer = Renderer(shapes.generate(77, index))
        R_start = so3.sample_uniform(rng, 1)[0]
        R = so3.matrix_from_quat(so3.sample_bounded(rng, 1, turn, turn))[0]
        images = (DepthImage(renderer.depth(camera, pose, placement), camera) for pose in (R_start, R @ R_start))
        yield *images, R, placement.center_m


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "swift"])
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_known_rotations_whatever_the_camera(name, camera):
    estimator = load_estimator(name)
    errors, inverse = [], []
    for current, goal, R, _ in pairs(camera, 20):
        answer = estimator.estimate(current, goal).R_goal_current
        errors.append(np.degrees(so3.angle_difference(answer, R)))
        inverse.append(np.degrees(so3.angle_difference(answer.T, R)))
    assert np.median(errors) < WITHIN_DEG[name]
    assert np.median(inverse) > 25


@pytest.mark.parametrize("name", ["paper", "swift"])
def test_the_translation_brings_the_object_to_the_goal(name):
    for current, goal, R, pivot_m in pairs(CAMERAS["f = 300"], 10):
        estimate = load_estimator(name).estimate(current, goal, pivot_m)
        moved = estimate.R_goal_current @ pivot_m + estimate.t_goal_current_m
        assert np.allclose(moved, pivot_m, atol=1e-9)
        assert estimate.evidence.inlier_ratio > 0.2
        assert so3.angle(R) == pytest.approx(np.radians(10))


@pytest.mark.parametrize("name", ["paper", "swift"])
def test_stray_returns_and_dropouts_change_little(name, rng):
    """Both images are zoomed to the outline of the object, and gaps are filled."""
    estimator = load_estimator(name)
    moved = []
    for current, goal, _, pivot_m in list(pairs(CAMERAS["f = 300"], 20))[:6]:
        before = estimator.estimate(current, goal, pivot_m).R_goal_current
        lossy = [np.where(rng.random(image.depth_m.shape) < 0.02, 0, image.depth_m) for image in (current, goal)]
        lossy[0][2, 3], lossy[1][120, 5] = 3.0, 0.15
        images = (DepthImage(depth_m, current.camera) for depth_m in lossy)
        moved.append(np.degrees(so3.angle_difference(estimator.estimate(*images, pivot_m).R_goal_current, before)))
    assert np.median(moved) < 1


def test_rounds_make_it_better():
    """Each round sees the current image turned by the answer so far."""
    once, thrice = learned.Learned("swift", rounds=1), learned.Learned("swift", rounds=3)
    errors = np.array(
        [
            [so3.angle_difference(e.estimate(current, goal).R_goal_current, R) for e in (once, thrice)]
            for current, goal, R, _ in pairs(CAMERAS["f = 300"], 25)
        ]
    )
    assert np.median(errors[:, 1]) < 0.8 * np.median(errors[:, 0])


@pytest.mark.slow
def test_near_the_goal_the_exchanged_pair_is_asked_too(monkeypatch):
    swift = load_estimator("swift")

    def mean_error(angle_deg):
        near = pairs(CAMERAS["f = 300"], angle_deg)
        return np.mean([so3.angle_difference(swift.estimate(*images, p).R_goal_current, R) for *images, R, p in near])

    assert mean_error(0) < np.radians(0.3)
    both_ways = mean_error(2)
    monkeypatch.setattr(learned, "NEAR_RAD", 0.0)
    assert both_ways < 0.93 * mean_error(2)


def test_the_same_images_give_the_same_answer():
    current, goal, _, _ = next(pairs(CAMERAS["f = 535"], 15))
    answers = [load_estimator("swift").estimate(current, goal).R_goal_current for _ in range(2)]
    assert np.array_equal(*answers)


def test_missing_weights_are_said():
    with pytest.raises(ReorientError, match=r"no weights nothing.onnx in this installation"):
        learned.load_session("nothing")


def test_no_torch_is_loaded():
    code = (
        "import sys; from reorient import load_estimator; load_estimator('swift'); "
        "print(*{'torch', 'zarr', 'joblib'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""
