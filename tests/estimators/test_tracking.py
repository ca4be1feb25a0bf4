"""Tracking: it stays at the truth, does not drift, knows when the object is lost, and finds it again."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate, with_evidence
from reorient.estimators.rotation_search import RotationSearch
from reorient.estimators.tracking import RETRY_IMAGES, Tracker, problem_of, seen_share, track
from reorient.imaging import DepthImage, Goal, GoalView
from reorient.registration import DepthView, Hypotheses
from reorient.world.rendering import Placement, Renderer, load_world
from reorient.world.sensing import randomised, sense

WORLD = load_world("benchmark")
SENSOR = replace(randomised(0.001), rectangle=False)
CENTER_M = np.array([0.0, 0.0, 0.6])
AXIS = np.array([2.0, 1.0, -2.0]) / 3


class Scene:
    """An object before a camera, at orientations relative to the goal pose."""

    def __init__(self, mesh, seed=0):
        self.rng = np.random.default_rng(seed)
        self.renderer = Renderer(mesh)
        self.scale_m = 0.1 / float(np.linalg.norm(self.renderer.mesh.vertices, axis=1).max())
        self.R_goal = so3.sample_uniform(np.random.default_rng(2), 1)[0]
        self.goal = self.image(np.eye(3))

    def image(self, R_object, shift_m=(0.0, 0.0, 0.0)):
        """The object rotated away from the goal by a rotation."""
        placement = Placement(self.scale_m, CENTER_M + np.array(shift_m))
        return sense(self.rng, self.renderer, WORLD.camera, R_object @ self.R_goal, placement, SENSOR)

    def truth(self, R_object, shift_m=(0.0, 0.0, 0.0)):
        """The estimate without an error."""
        image, R = self.image(R_object, shift_m), R_object.T
        t_m = CENTER_M - R @ (CENTER_M + np.array(shift_m))
        return with_evidence(DepthView(image), DepthView(self.goal), R, t_m, confidence=0.9)


@pytest.fixture(scope="module")
def scene(mesh):
    return Scene(mesh)


def about(angle_deg, axis=AXIS):
    return so3.exp(np.radians(angle_deg) * axis)


def error_deg(estimate, R_object):
    return float(np.degrees(so3.angle_difference(estimate.R_goal_current, R_object.T)))


class Counting:
    """An estimator that counts its calls and answers with one estimate."""

    def __init__(self, answer):
        self.answer, self.calls = answer, 0

    def estimate(self, current, goal, pivot_m=None, history=()):
        self.calls += 1
        return self.answer


def test_it_stays_at_the_truth_in_fast_motion(scene):
    """90 degrees a second at 30 images a second, with a shift."""
    estimate, errors = scene.truth(about(45)), []
    for k, angle_deg in enumerate(np.arange(42, -45, -3)):
        shift_m = 0.01 * np.sin(k / 3 + np.arange(3))
        estimate = track(scene.image(about(angle_deg), shift_m), scene.goal, estimate)
        errors.append(error_deg(estimate, about(angle_deg)))
        assert estimate.confidence > 0.5
    assert np.median(errors) < 0.5
    assert max(errors) < 3


def test_there_and_back_is_the_same_estimate(scene):
    """Always against the goal: where one has been makes no difference, but for where an iteration stops."""
    image = scene.image(about(10))
    first = track(image, scene.goal, scene.truth(about(10)))
    estimate = first
    for angle_deg in (14, 18, 22, 26, 22, 18, 14):
        estimate = track(scene.image(about(angle_deg)), scene.goal, estimate)
    back = track(image, scene.goal, estimate)
    assert np.degrees(so3.angle_difference(back.R_goal_current, first.R_goal_current)) < 0.05


def test_deterministic(scene):
    image, previous = scene.image(about(20)), scene.truth(about(22))
    first, second = (track(image, scene.goal, previous) for _ in range(2))
    np.testing.assert_array_equal(first.R_goal_current, second.R_goal_current)
    assert first.confidence == second.confidence


def test_the_motion_takes_current_to_the_goal(scene):
    shift_m = (0.01, -0.02, 0.03)
    truth = scene.truth(about(20), shift_m)
    tracked = RotationSearch("fast").track(scene.image(about(20), shift_m), scene.goal, scene.truth(about(17)))
    np.testing.assert_allclose(tracked.T_goal_current, truth.T_goal_current, atol=0.02)
    assert np.linalg.norm(tracked.t_goal_current_m - truth.t_goal_current_m) < 0.005


def test_the_nearest_goal_view_is_used(mesh):
    """100 degrees from the primary view hardly any of its surface is left; a view from there has it all."""
    scene, away = Scene(mesh), about(100)
    view = GoalView(scene.image(away), away.T)
    previous = scene.truth(about(98))
    with_view = track(scene.image(away), Goal(scene.goal, (view,)), previous)
    assert error_deg(with_view, away) < 0.5
    t_m = CENTER_M - away.T @ CENTER_M
    np.testing.assert_allclose(with_view.t_goal_current_m, t_m, atol=0.03)  # the views hardly overlap
    exact = track(scene.image(away), Goal(scene.goal, (replace(view, t_goal_view_m=t_m),)), previous)
    assert np.linalg.norm(exact.t_goal_current_m - t_m) < 0.003
    assert with_view.confidence > 0.9


def test_a_free_axis_stays_and_the_smallest_rotation_is_tracked():
    cone = trimesh.creation.cone(0.5, 1.2, sections=64)
    scene, tip = Scene(cone), about(20)
    axis = scene.R_goal[:, 2]
    R = about(40, axis) @ tip.T  # an equivalent rotation, 40 degrees about the axis of the cone too far
    previous = replace(scene.truth(tip), R_goal_current=R, t_goal_current_m=CENTER_M - R @ CENTER_M, free_axis=axis)
    tracked = track(scene.image(tip), scene.goal, previous)
    np.testing.assert_array_equal(tracked.free_axis, axis)
    smallest = so3.exp(-so3.twist_angle(tip.T, axis) * axis) @ tip.T
    assert np.degrees(so3.angle_difference(tracked.R_goal_current, smallest)) < 3


@pytest.mark.parametrize("fault", ["swapped", "hidden"])
def test_a_lost_object_is_flagged_within_three_images_and_found_again(scene, fault):
    other = Scene(trimesh.creation.icosphere())
    tracker = Tracker(Counting(scene.truth(about(10))), scene.goal)
    for _ in range(3):
        assert error_deg(tracker.update(scene.image(about(10))), about(10)) < 2
    for k in range(6):
        image = other.image(about(10))
        if fault == "hidden":
            image = scene.image(about(10))
            strip = np.arange(128) > np.quantile(np.nonzero(image.valid)[1], 0.1)
            image = DepthImage(np.where(strip, 0, image.depth_m), image.camera)
        tracker.estimator.answer = replace(tracker.estimator.answer, confidence=0.1)
        estimate = tracker.update(image)
        assert (estimate is None) == tracker.lost
        assert tracker.lost or k < 2
    found = [tracker.update(scene.image(about(12))) for _ in range(2)][-1]
    assert error_deg(found, about(12)) < 2
    assert not tracker.lost


class Scripted(Counting):
    """One that tracks to the estimates of a list."""

    def __init__(self, answer, tracked):
        super().__init__(answer)
        self.tracked = iter(tracked)

    def track(self, current, goal, previous):
        return next(self.tracked)


def test_a_doubt_that_comes_and_goes_is_a_loss_and_one_alone_is_none(scene):
    sure, unsure = scene.truth(about(10)), replace(scene.truth(about(10)), confidence=0.1)
    image = scene.image(about(10))
    for confidences, lost in (((0.9, 0.1, 0.9, 0.9), False), ((0.2, 0.9, 0.2, 0.9), True)):
        tracker = Tracker(Scripted(sure, [replace(sure, confidence=x) for x in confidences]), scene.goal)
        tracker.update(image)
        tracker.estimator.answer = unsure
        for _ in confidences:
            tracker.update(image)
        assert tracker.lost == lost


def test_a_leap_is_left_to_an_estimate(scene):
    """A sure rotation 12 degrees away counts only where an estimate without initial guess agrees to be sure."""
    near, far, image = scene.truth(about(10)), scene.truth(about(22)), scene.image(about(10))
    tracker = Tracker(Scripted(near, [near, far, near, far, far, near]), scene.goal)
    for _ in range(2):
        tracker.update(image)
    assert tracker.estimator.calls == 1
    tracker.estimator.answer = found = scene.truth(about(24))
    assert tracker.update(image) is found
    tracker.estimator.answer = replace(near, confidence=0.1)
    tracker.update(image)  # leaps back to 10 degrees
    assert tracker.estimator.calls == 3
    assert not tracker.lost
    assert tracker.update(image) is far  # and is there again
    tracker.update(image)


def test_most_of_the_prediction_is_missing_where_little_of_the_object_is_left(scene):
    image, R = scene.image(about(20)), about(20).T
    motion = Hypotheses(R[None], (CENTER_M - R @ CENTER_M)[None])
    columns = np.nonzero(image.valid)[1]
    shares = []
    for left in (1.0, 0.5, 0.1):
        strip = np.arange(128) > np.quantile(columns, left)
        part = DepthImage(np.where(strip, 0, image.depth_m), image.camera, unknown=np.tile(strip, (128, 1)))
        shares.append(seen_share(problem_of(DepthView(part), DepthView(scene.goal)), motion))
    assert shares[0] > 0.7
    assert shares[0] > shares[1] + 0.2 > shares[2] + 0.4


def test_searches_are_rare_while_the_object_is_lost(scene):
    unsure = replace(scene.truth(about(10)), confidence=0.2)
    tracker, searched = Tracker(Counting(unsure), scene.goal), []
    for _ in range(2 * RETRY_IMAGES + 3):
        before, expected = tracker.estimator.calls, tracker.searches_next
        assert tracker.update(scene.image(about(10))) is None
        searched.append(tracker.estimator.calls > before)
        assert searched[-1] == expected
    assert np.flatnonzero(searched).tolist() == [0, RETRY_IMAGES + 1, 2 * RETRY_IMAGES + 2]


def test_after_a_jump_the_rotation_is_searched(scene):
    tracker = Tracker(Counting(scene.truth(about(40))), scene.goal)
    tracker.update(scene.image(about(40)))
    far = about(120, np.array([0.0, 1.0, 0.0]))
    tracker.estimator.answer = scene.truth(far)
    estimates = [tracker.update(scene.image(far)) for _ in range(2)]
    assert tracker.estimator.calls == 2
    assert error_deg(estimates[-1], far) == 0


def test_a_match_is_confirmed_by_a_sure_estimate_that_agrees(scene):
    tracker = Tracker(Counting(scene.truth(about(4))), scene.goal)
    image = scene.image(about(4))
    tracker.update(image)
    assert tracker.confirm(image) is tracker.estimator.answer
    tracker.estimator.answer = replace(tracker.estimator.answer, confidence=0.3)
    assert tracker.confirm(image) is None
    tracker.estimator.answer = scene.truth(about(30))
    assert tracker.confirm(image) is None
    tracked = tracker.update(scene.image(about(30)))  # it goes on from the estimate that did not agree
    assert error_deg(tracked, about(30)) < 2


def test_an_image_without_the_object_is_lost_and_a_goal_without_one_refused(scene):
    empty = np.zeros((128, 128), np.float32)
    empty[60:62, 60:64] = 0.6
    few = DepthImage(empty, WORLD.camera)
    tracker = Tracker(Counting(scene.truth(about(10))), scene.goal)
    tracker.update(scene.image(about(10)))
    tracker.estimator.answer = replace(tracker.estimator.answer, confidence=0.1)
    for _ in range(2):
        tracker.update(few)
    assert tracker.lost
    with pytest.raises(ReorientError, match="8 returns"):
        Tracker(tracker.estimator, few)
    with pytest.raises(ReorientError, match="8 returns"):
        track(few, scene.goal, scene.truth(about(10)))


def test_an_estimator_without_confidence_is_trusted_at_first(scene):
    tracker = Tracker(Counting(replace(scene.truth(about(10)), confidence=None)), scene.goal)
    estimate = tracker.update(scene.image(about(10)))
    assert isinstance(estimate, RotationEstimate)
    assert tracker.update(scene.image(about(11))).confidence > 0.5
