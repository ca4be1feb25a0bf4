"""What real frames bring: stray returns, missing parts, parts that do not move, wrong pivots, symmetric objects."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from reorient import so3
from reorient.estimators import load_estimator
from reorient.estimators.equivalents import free_axis, smallest_equivalent
from reorient.estimators.static_part import find_static_part
from reorient.imaging import DepthImage
from reorient.registration import Hypotheses, build_problem
from reorient.world.pairs import sample_pair, scene_of
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import Sensor, randomised
from reorient.world.static_parts import with_static_part

WORLD = load_world("benchmark")


def pair_of(mesh, seed=0, angle_deg=40.0, noise_m=0.001):
    angle_rad = np.radians(angle_deg)
    sensor = randomised(noise_m) if noise_m else Sensor()
    return sample_pair(np.random.default_rng(seed), Renderer(mesh), WORLD, sensor, angle_rad, angle_rad)


def error_deg(estimate, pair):
    return float(np.degrees(so3.angle_difference(estimate.R_goal_current, pair.R_goal_current)))


def truth_of(pair):
    center, R = pair.placement.center_m, pair.R_goal_current
    return Hypotheses(R[None], (center - R @ center)[None])


@pytest.mark.parametrize("name", ["default", "gicp"])
def test_stray_returns_cost_nothing(name, mesh, rng):
    pair = pair_of(mesh, angle_deg=20)
    clean = load_estimator(name).estimate(pair.current, pair.goal)
    depth_m = pair.current.depth_m.copy()
    background = np.argwhere(depth_m == 0)
    for (row, column), stray_m in zip(rng.choice(background, 3), (0.1, 0.62, 65.0), strict=True):
        depth_m[row, column] = stray_m
    stray = load_estimator(name).estimate(replace(pair.current, depth_m=depth_m), pair.goal)
    assert np.degrees(so3.angle_difference(clean.R_goal_current, stray.R_goal_current)) < 0.5
    if clean.confidence is not None:
        assert stray.confidence == pytest.approx(clean.confidence, abs=0.02)


def test_a_third_beyond_the_frame_costs_nothing(mesh):
    pair = pair_of(mesh, seed=3, angle_deg=25)
    columns = np.nonzero(pair.goal.valid)[1]
    goal = pair.goal.cropped(0, 0, int(np.quantile(columns, 2 / 3)), pair.goal.camera.height)
    assert error_deg(load_estimator().estimate(pair.current, goal), pair) < 2


@pytest.mark.parametrize("seed", [3, 4, 5, 6, 7])
def test_unmarked_holes_in_both_images(mesh, seed):
    """The gripper cuts other parts of the object out of each image, and nothing marks them."""
    pair = pair_of(mesh, seed=seed, angle_deg=35)
    images = []
    for image, side in ((pair.current, 0), (pair.goal, 1)):
        rows = np.nonzero(image.valid)[0]
        cut = np.arange(image.camera.height)[:, None] < np.quantile(rows, 0.25)
        cut = cut if side == 0 else np.arange(image.camera.width)[None] > np.quantile(np.nonzero(image.valid)[1], 0.75)
        images.append(replace(image, depth_m=np.where(cut, 0, image.depth_m)))
    estimate = load_estimator().estimate(*images)
    assert error_deg(estimate, pair) < 3


@pytest.mark.parametrize(
    ("kind", "shares"), [("table", (0.2, 0.33)), ("gripper", (0.2, 0.33)), ("gripper", (0.5, 0.6))]
)
def test_a_part_that_does_not_move(mesh, kind, shares):
    pair = pair_of(mesh, seed=4, angle_deg=30)
    scene = scene_of(Renderer(mesh), pair)
    images = with_static_part(np.random.default_rng(0), scene, kind, shares, 0.001).images
    estimate = load_estimator().estimate(*images)
    assert error_deg(estimate, pair) < 5 or estimate.confidence < 0.5
    assert any("did not move" in x for x in estimate.warnings)


def test_at_the_goal_nothing_is_static(mesh):
    pair = pair_of(mesh, angle_deg=0)
    problem = build_problem(pair.current, pair.goal, None)
    assert find_static_part(problem, np.eye(3), np.zeros(3), False) is None
    estimate = load_estimator().estimate(pair.current, pair.goal)
    assert not estimate.warnings
    assert estimate.confidence > 0.8


@pytest.mark.parametrize("offset_m", [(0.15, 0.0, 0.0), (0.0, 0.3, 0.8)])
def test_a_wrong_pivot_is_not_used(mesh, offset_m):
    pair = pair_of(mesh, seed=2, angle_deg=50)
    without = load_estimator().estimate(pair.current, pair.goal)
    wrong = load_estimator().estimate(pair.current, pair.goal, pair.placement.center_m + np.array(offset_m))
    assert error_deg(without, pair) < 2
    assert error_deg(wrong, pair) < 2
    (warning,) = wrong.warnings
    assert "cm off: it was not used" in warning


def test_a_good_pivot_is_used(mesh):
    pair = pair_of(mesh, seed=2, angle_deg=50)
    assert not load_estimator().estimate(pair.current, pair.goal, pair.pivot_m).warnings


def test_without_covisible_inliers_there_is_no_confidence(mesh):
    pair = pair_of(mesh)
    plank = np.zeros_like(pair.goal.depth_m)
    plank[60:64, 10:118] = 0.6
    estimate = load_estimator().estimate(pair.current, DepthImage(plank, pair.goal.camera))
    assert estimate.confidence <= 0.5


@pytest.mark.parametrize("noise_m", [0.0, 0.001])
def test_a_can_has_a_free_axis_and_takes_the_smallest_rotation(noise_m):
    can = trimesh.creation.cylinder(radius=0.4, height=1.2)
    pair = pair_of(can, seed=0, angle_deg=71, noise_m=noise_m)
    problem, truth = build_problem(pair.current, pair.goal, None), truth_of(pair)
    axis = pair.R_goal_current @ pair.R_camera_object @ np.array([0.0, 0.0, 1.0])
    nothing = truth[np.zeros(0, int)]
    smallest, found = smallest_equivalent(problem, truth, nothing)
    assert abs(found @ axis) > np.cos(np.radians(2))
    before = pair.R_camera_object @ np.array([0.0, 0.0, 1.0])
    swing_rad = np.arccos(np.clip(axis @ before, -1, 1))
    assert so3.angle(smallest.R[0]) == pytest.approx(swing_rad, abs=np.radians(3))


def test_a_corner_has_no_free_axis(mesh):
    pair = pair_of(mesh, seed=1)
    assert free_axis(build_problem(pair.current, pair.goal, None), truth_of(pair)) is None
