"""The symmetry of a goal that shows all sides."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from reorient import so3
from reorient.controller.arrival import Observation
from reorient.controller.hypotheses import BeliefSettings, Viewpoint, hypotheses_of
from reorient.estimators import load_estimator
from reorient.estimators.goal_symmetry import Symmetry, shows_all_sides, symmetries
from reorient.imaging import Goal
from reorient.registration import aligned_goal
from reorient.world.goals import sample_goal
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import Sensor

WORLD = load_world("benchmark")


def pair_and_goal(mesh, views, angle_deg=170):
    """A box's three half rotations are its symmetries."""
    rng, renderer, angle = np.random.default_rng(3), Renderer(mesh), np.radians(angle_deg)
    pair = sample_pair(rng, renderer, WORLD, Sensor(noise_m=0.0005), angle, angle)
    goal, _ = aligned_goal(sample_goal(rng, renderer, WORLD, Sensor(noise_m=0.0005), pair, views), pair.pivot_m)
    return pair, goal


@pytest.fixture(scope="module")
def box():
    return pair_and_goal(trimesh.creation.box((1.0, 0.7, 0.4)), 6)


@pytest.mark.slow
def test_a_box_has_three_half_rotations(box):
    pair, goal = box
    R = symmetries(goal).rotations
    np.testing.assert_allclose(np.degrees(so3.angle(R)), 180, atol=2)
    to_goal = pair.R_goal_current @ pair.R_camera_object
    axes = np.array([so3.log(x) / np.pi for x in to_goal.T @ R @ to_goal])
    np.testing.assert_allclose(np.sort(np.abs(axes).argmax(axis=1)), [0, 1, 2])


@pytest.mark.slow
def test_no_symmetry_of_an_asymmetric_object_nor_of_few_views(mesh, box):
    assert not symmetries(pair_and_goal(mesh, 6)[1])
    few = Goal(box[1].image, box[1].views[:2])
    assert shows_all_sides(box[1])
    assert not shows_all_sides(few)
    assert not symmetries(few)


@pytest.mark.slow
@pytest.mark.parametrize(("body", "swaps"), [("cylinder", 1), ("cone", 0)])
def test_a_solid_of_revolution_has_an_axis_and_the_error_none_about_it(body, swaps):
    mesh = {
        "cylinder": lambda: trimesh.creation.cylinder(0.4, 1.4, sections=64),
        "cone": lambda: trimesh.creation.cone(0.5, 1.2, sections=64),
    }[body]()
    pair, goal = pair_and_goal(mesh, 6, angle_deg=120)
    group = symmetries(goal)
    axis = (pair.R_goal_current @ pair.R_camera_object)[:, 2]
    assert np.degrees(np.arccos(min(abs(group.axis @ axis), 1))) < 2
    assert len(group.separate) == swaps
    assert len(group.rotations) == 18 * (1 + swaps) - 1
    estimate = load_estimator("default").estimate(pair.current, goal, pair.pivot_m)
    error_deg = np.degrees(group.apart_rad(estimate.R_goal_current[None], pair.R_goal_current))
    assert error_deg < 2
    assert np.degrees(abs(so3.twist_angle(estimate.R_goal_current, group.axis))) < 1  # the smallest of the rotations
    assert estimate.confidence > 0.7
    assert estimate.candidates[0].probability == estimate.confidence  # the same rotations share nothing
    np.testing.assert_allclose(estimate.free_axis, group.axis, atol=1e-3)
    assert estimate.free_axis @ estimate.covariance_rad2 @ estimate.free_axis < 1e-12
    assert np.trace(estimate.covariance_rad2) > 0


def test_the_projection_takes_out_rotations_about_the_axis_and_nothing_else(rng):
    """The axis is beside the point about which small motions rotate."""
    axis, unit_m = so3.sample_axes(rng, 1)[0], 0.05
    point_m, about_m = rng.normal(0, 0.1, (2, 3))
    projection = Symmetry(axis=axis, point_m=point_m).projection(about_m, unit_m)

    def small(rotvec, center_m):
        R = so3.exp(rotvec)
        return np.concatenate([rotvec, (R @ (about_m - center_m) + center_m - about_m) / unit_m])

    np.testing.assert_allclose(projection @ small(1e-6 * axis, point_m), 0, atol=1e-11)
    across = np.cross(axis, so3.sample_axes(rng, 1)[0])
    np.testing.assert_allclose(projection @ small(1e-6 * across, point_m), small(1e-6 * across, point_m), atol=1e-11)


@pytest.mark.slow
def test_the_smallest_equivalent_is_the_answer_without_doubt(box):
    pair, goal = box
    estimate = load_estimator("fast").estimate(pair.current, goal, pair.pivot_m)
    same = np.stack([pair.R_goal_current, *(S @ pair.R_goal_current for S in symmetries(goal).rotations)])
    smallest = same[np.argmin(so3.angle(same))]
    assert np.degrees(so3.angle_difference(estimate.R_goal_current, smallest)) < 3
    for R, _ in estimate.alternatives:
        assert np.degrees(so3.angle_difference(same, R)).min() > 10
    assert len(estimate.symmetries) == 3


def test_equivalent_answers_from_two_sides_are_one_hypothesis(box):
    """From another viewpoint another one of the equivalent rotations is the smallest."""
    pair, goal = box
    estimate = load_estimator("fast").estimate(pair.current, goal, pair.pivot_m)
    R, S = estimate.R_goal_current, estimate.symmetries[0]
    other = replace(estimate, R_goal_current=S @ R)
    views = [
        Viewpoint((Observation(pair.current, x),), R_then) for x, R_then in ((estimate, np.eye(3)), (other, np.eye(3)))
    ]
    assert len(hypotheses_of(views, BeliefSettings())) == 1
    distinct = [
        replace(x, observations=(Observation(pair.current, replace(x.observations[0].estimate, symmetries=())),))
        for x in views
    ]
    assert len(hypotheses_of(distinct, BeliefSettings())) == 2
