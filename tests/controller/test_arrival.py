"""The arrival test and the symmetry test on rendered images."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracles import BOX, WORLD, answer, cell, lying_box

from reorient import load_estimator, se3, so3
from reorient.controller.arrival import ArrivalTest, Observation, PreparedImage
from reorient.controller.symmetry import SymmetryTest, dominant_axes
from reorient.stations.rendered import RenderedStation
from reorient.stations.simulated import SimulatedCell
from reorient.world.objects import generated
from reorient.world.sensing import randomised

STILL = answer(np.eye(3))
TEST = ArrivalTest()


def observed(station, count, estimate=STILL):
    return [Observation(station.capture(), estimate) for _ in range(count)]


def test_log_odds_separate_the_goal_pose_from_another(mesh):
    station, goal, R_goal = cell(mesh, noise_m=0.001)
    for R, right in ((R_goal, True), (so3.exp(np.array([np.pi, 0, 0])) @ R_goal, False)):
        station.R_camera_object = R
        assert (TEST.log_odds(observed(station, 2), PreparedImage(goal)) > 0) == right


@pytest.mark.parametrize("seed", [0, 1])
def test_an_object_beside_its_place_in_the_goal_image_arrives_too(seed):
    """15 mm aside its pixels show other points of the surface, and a wrong orientation remains one."""
    objects = generated(1)
    station = SimulatedCell(objects.load(objects.names[0]), np.random.default_rng(seed))
    goal, T_goal = PreparedImage(station.frame()), station.T_camera_object
    aside = np.array([0.009, 0.009, 0.0075])
    log_odds = []
    for angle_deg in (0, 6, 180):
        R = so3.exp(np.radians([0, 0, angle_deg])) @ T_goal[:3, :3]
        T_camera_object = se3.transform(R, T_goal[:3, 3] + aside)
        station.T_base_tool = station.T_base_camera @ T_camera_object @ se3.inverse(station.T_tool_object)
        images = [station.frame() for _ in range(3)]
        estimate = replace(STILL, t_goal_current_m=-aside)
        log_odds.append(TEST.log_odds([Observation(image, estimate) for image in images], goal))
    assert log_odds[0] > 0.5
    assert max(log_odds[1:]) < -3


def test_small_depth_differences_add_up():
    """A plate of 3 mm on a box, under noise of 1 mm: inlier ratios hardly differ, the likelihood does."""
    plates = [
        trimesh.creation.box((0.4, 0.7, 0.018), trimesh.transformations.translation_matrix((0.3, 0, z)))
        for z in (-0.259, 0.259)
    ]
    station, goal, R_goal = cell(trimesh.util.concatenate([BOX, *plates]), seed=3, noise_m=0.001)
    nll = []
    for about in ([0, 0, 0], R_goal[:, 2]):
        station.R_camera_object = so3.exp(np.pi * np.array(about)) @ R_goal
        nll.append(TEST.depth_nll(observed(station, 3), PreparedImage(goal)))
    assert 3 * (nll[1] - nll[0]) > 2


def test_the_likelihood_is_largest_under_the_true_motion(mesh):
    station, goal, R_goal = cell(mesh, seed=3, noise_m=0.001)
    left, center = so3.exp(np.array([0.02, -0.05, 0.04])), station.placement.center_m
    station.R_camera_object = left.T @ R_goal
    images = [station.capture(), station.capture()]

    def nll(R):
        estimate = replace(STILL, R_goal_current=R, t_goal_current_m=center - R @ center)
        return TEST.depth_nll([Observation(image, estimate) for image in images], PreparedImage(goal))

    assert nll(left) < nll(np.eye(3)) < nll(left.T)


def test_estimates_that_lead_away_are_replaced(mesh):
    station, goal, R_goal = cell(mesh, seed=3, noise_m=0.001)
    station.R_camera_object = R_goal
    images = [station.capture(), station.capture()]
    away = answer(so3.exp(np.array([0, 0, 1.0])))
    right, one_away, both_away = (
        TEST.depth_nll([Observation(*x) for x in zip(images, estimates, strict=True)], PreparedImage(goal))
        for estimates in ((STILL, STILL), (STILL, away), (away, away))
    )
    assert one_away == right
    assert both_away == pytest.approx(right, rel=0.2)


THIN = trimesh.creation.box((0.08, 0.08, 1.0))
ROUND = trimesh.creation.cylinder(radius=0.15, height=1.0, sections=64)


@pytest.mark.parametrize(("body", "weak"), [(THIN, True), (ROUND, False), (BOX, False)])
def test_the_weak_axis_of_a_thin_rod_matters_and_that_of_a_round_one_does_not(body, weak):
    test = replace(TEST, weak_axis_rad=np.radians(0.7))  # between those of these bodies
    station, goal, R_goal = cell(body, seed=3, noise_m=0.001)
    station.R_camera_object = R_goal
    estimator, images = load_estimator("default"), [station.capture(), station.capture()]
    observations = [Observation(image, estimator.estimate(image, goal)) for image in images]
    error_deg = np.degrees([np.sqrt(np.linalg.eigvalsh(x.estimate.covariance_rad2)[-1]) for x in observations])
    wide = error_deg.min() > np.degrees(test.weak_axis_rad)
    assert wide == (body is not BOX)  # the curvature does not separate rod and cylinder
    weak_deg = np.degrees(test.weak_axis_error_rad(observations, PreparedImage(goal)))
    assert (error_deg.min() - 1e-9 <= weak_deg <= error_deg.max() + 1e-9) if weak else weak_deg == 0
    unknown = [Observation(x.image, replace(x.estimate, covariance_rad2=None)) for x in observations]
    assert test.weak_axis_error_rad(unknown, PreparedImage(goal)) == 0


@pytest.mark.parametrize("symmetric", [True, False])
def test_flips_of_a_box_lose_no_score(mesh, symmetric):
    """Of a box one flip or more loses next to nothing; of another body all lose."""
    station, goal, R_goal = cell(BOX if symmetric else mesh, seed=3, noise_m=0.001)
    before, R_before = station.capture(), station.R_camera_object
    station.R_camera_object = R_goal
    flips = SymmetryTest().flips(PreparedImage(station.capture()), goal, [(before, R_goal @ R_before.T)])
    assert len(flips) == 3
    assert all(np.degrees(so3.angle(flip.R_goal_current)) > 120 for flip in flips)
    assert (min(flip.score_loss for flip in flips) < 0.1) == symmetric


def test_dominant_axes_of_a_box_are_its_own():
    station = RenderedStation(BOX, WORLD, randomised(), np.random.default_rng(2))
    axes = dominant_axes(PreparedImage(station.capture_goal()))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-6)
    assert np.abs(axes @ station.R_camera_object).max(axis=1).min() > np.cos(np.radians(3))


@pytest.mark.parametrize(("knob", "symmetric"), [(0.0, True), (0.15, False)])
def test_a_view_repeats_where_the_object_is_symmetric(knob, symmetric):
    mesh, flip = lying_box(knob)
    station, _, R_goal = cell(mesh, seed=3, noise_m=0.001)
    away = so3.exp(np.array([2.5, 0.5, 0]))
    reference = [PreparedImage(station.capture()), PreparedImage(station.capture())]
    views = []
    for R in (away @ R_goal, away @ flip @ R_goal):
        station.R_camera_object = R
        views.append(PreparedImage(station.capture()))
    assert SymmetryTest().images_agree(*views, reference) == symmetric


@pytest.mark.parametrize(
    ("body", "symmetric"), [(trimesh.creation.cylinder(radius=0.5, height=0.8, sections=3), True), (BOX, False)]
)
def test_a_third_of_a_rotation_is_a_symmetry_of_a_prism_and_not_of_a_box(body, symmetric):
    """120 degrees, not 180: the order and the direction of the rotations count."""
    station, _, R_goal = cell(body, seed=3, noise_m=0.001)
    third = so3.exp(2 * np.pi / 3 * R_goal[:, 2])
    station.R_camera_object = R_goal
    reference = [PreparedImage(station.capture()), PreparedImage(station.capture())]
    views = [(reference[0], np.eye(3))]
    for _ in range(2):
        known, R_elsewhere = SymmetryTest().symmetric(third, reference, views)
        assert known is None
        station.R_camera_object = R_elsewhere @ R_goal
        views.insert(0, (PreparedImage(station.capture()), R_elsewhere))
    assert SymmetryTest().symmetric(third, reference, views)[0] == symmetric


def test_what_is_computed_of_an_image_is_kept_with_it(mesh):
    image = PreparedImage(cell(mesh)[1])
    assert image.view is image.view
    assert image.points_m is image.points_m
