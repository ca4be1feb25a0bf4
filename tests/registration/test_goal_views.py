"""The laws of a goal of several views: one view is the image, order and axes do not matter, wrong views are named."""

from dataclasses import replace

import numpy as np
import pytest

from reorient import so3
from reorient.estimators import load_estimator
from reorient.imaging import Goal, GoalView
from reorient.registration import Hypotheses, aligned_goal, build_problem
from reorient.world.goals import rotations_away, sample_goal
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import Sensor

WORLD, EXACT, RIGHT_ANGLE = load_world("benchmark"), Sensor(), np.pi / 2


@pytest.fixture(scope="module")
def pair_and_goal(mesh):
    rng, renderer = np.random.default_rng(4), Renderer(mesh)
    pair = sample_pair(rng, renderer, WORLD, EXACT, RIGHT_ANGLE, RIGHT_ANGLE)
    return pair, sample_goal(rng, renderer, WORLD, EXACT, pair, 4)


def truth_of(pair):
    center, R = pair.placement.center_m, pair.R_goal_current
    return Hypotheses(R[None], (center - R @ center)[None])


def turned(view, angle_deg, axis=(0.0, 1.0, 0.0)):
    """The view with its stated rotation wrong by an angle."""
    return replace(view, R_goal_view=so3.exp(np.radians(angle_deg) * np.array(axis)) @ view.R_goal_view)


def error_deg(goal, k, truth):
    return float(np.degrees(so3.angle_difference(goal.views[k].R_goal_view, truth.views[k].R_goal_view)))


def test_a_goal_of_one_view_is_its_image(pair_and_goal):
    pair, _ = pair_and_goal
    image, goal = (load_estimator("fast").estimate(pair.current, x, pair.pivot_m) for x in (pair.goal, Goal(pair.goal)))
    np.testing.assert_array_equal(image.T_goal_current, goal.T_goal_current)
    np.testing.assert_array_equal(image.covariance_rad2, goal.covariance_rad2)
    assert (image.confidence, image.evidence) == (goal.confidence, goal.evidence)


def test_an_estimator_of_one_view_receives_the_primary(pair_and_goal):
    pair, goal = pair_and_goal
    image, several = (load_estimator("gicp").estimate(pair.current, x) for x in (pair.goal, goal))
    np.testing.assert_array_equal(image.T_goal_current, several.T_goal_current)


@pytest.mark.slow
def test_the_order_of_the_views_does_not_matter(pair_and_goal):
    pair, goal = pair_and_goal
    first, second = (
        load_estimator("fast").estimate(pair.current, Goal(pair.goal, views))
        for views in (goal.views, goal.views[::-1])
    )
    assert np.degrees(so3.angle_difference(first.R_goal_current, pair.R_goal_current)) < 1
    assert np.degrees(so3.angle_difference(first.R_goal_current, second.R_goal_current)) < 0.2


def test_a_rotation_of_the_pose_of_all_views_rotates_the_score_with_it(pair_and_goal, rng):
    """Where another view is the primary one, the same motions have the same score."""
    pair, goal = pair_and_goal
    goal, _ = aligned_goal(goal, pair.placement.center_m)
    Q, t_m = goal.views[0].R_goal_view, goal.views[0].t_goal_view_m
    others = (GoalView(goal.image, np.eye(3), np.zeros(3)), *goal.views[1:])
    from_first = Goal(
        goal.views[0].image,
        tuple(GoalView(x.image, Q.T @ x.R_goal_view, Q.T @ (x.t_goal_view_m - t_m)) for x in others),
    )
    problem, other = (build_problem(pair.current, x, None) for x in (goal, from_first))
    motions = Hypotheses(so3.sample_uniform(rng, 20), truth_of(pair).t_m.repeat(20, axis=0))
    np.testing.assert_allclose(
        problem.image_score(motions, 0.02, 400), other.image_score(motions.onto(Q, t_m), 0.02, 400), atol=5e-3
    )


def test_further_views_never_lower_the_score_of_the_truth(pair_and_goal):
    pair, goal = pair_and_goal
    center = pair.placement.center_m
    views = [replace(x, t_goal_view_m=center - x.R_goal_view @ center) for x in goal.views]
    problems = [build_problem(pair.current, Goal(goal.image, tuple(views[:k])), center) for k in range(4)]
    scores = [problem.score(truth_of(pair), 0.02, 1000)[0] for problem in problems]
    assert np.all(np.diff(scores) > -0.02)
    assert scores[-1] > scores[0] + 0.1


def test_slipped_views_are_aligned(pair_and_goal):
    _, goal = pair_and_goal
    slipped = Goal(goal.image, tuple(turned(x, 2) for x in goal.views))
    aligned, warnings = aligned_goal(slipped)
    assert not warnings
    assert all(x.t_goal_view_m is not None for x in aligned.views)
    assert np.median([error_deg(aligned, k, goal) for k in range(3)]) < 1
    assert aligned_goal(slipped)[0] is aligned  # computed once
    again, _ = aligned_goal(aligned)
    for view, other in zip(again.views, aligned.views, strict=True):
        np.testing.assert_array_equal(view.R_goal_view, other.R_goal_view)
        np.testing.assert_array_equal(view.t_goal_view_m, other.t_goal_view_m)


@pytest.mark.slow
def test_the_pivot_of_views_without_translation_is_found(pair_and_goal):
    pair, goal = pair_and_goal
    center = pair.placement.center_m
    for pivot_m in (None, center + 0.008):
        aligned, _ = aligned_goal(goal, pivot_m)
        moved = [x.R_goal_view @ center + x.t_goal_view_m - center for x in aligned.views]
        assert np.linalg.norm(moved, axis=1).max() < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [40, 170])
def test_a_wrong_rotation_is_named(pair_and_goal, angle_deg):
    _, goal = pair_and_goal
    wrong = Goal(goal.image, (goal.views[0], turned(goal.views[1], angle_deg), goal.views[2]))
    aligned, warnings = aligned_goal(wrong)
    assert len(warnings) == 1
    assert warnings[0].startswith("goal view 2 contradicts the others")
    assert len(aligned.views) == 2


@pytest.mark.slow
def test_an_image_of_another_object_is_named(pair_and_goal, mesh):
    _, goal = pair_and_goal
    mirrored = mesh.copy()
    mirrored.vertices[:, 0] *= -1
    mirrored.invert()
    rng = np.random.default_rng(1)
    other = sample_pair(rng, Renderer(mirrored), WORLD, EXACT, RIGHT_ANGLE, RIGHT_ANGLE).goal
    wrong = Goal(goal.image, (replace(goal.views[0], image=other), *goal.views[1:]))
    _, warnings = aligned_goal(wrong)
    assert [x[:11] for x in warnings] == ["goal view 1"]


@pytest.mark.parametrize("views", [1, 2, 3, 6])
def test_views_are_as_far_apart_as_stated(rng, views):
    R = rotations_away(rng, views)
    assert len(R) == views - 1
    away = np.degrees(so3.angle(R)) if len(R) else []
    np.testing.assert_allclose(away, [90, 90, 90, 90, 180] if views == 6 else [60] * (views - 1), atol=1e-6)
    assert np.all(np.abs([so3.log(x)[2] for x in R]) < 1e-9)  # none about the optical axis
