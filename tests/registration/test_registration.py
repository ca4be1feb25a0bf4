"""The laws of the geometry kernel: planes, evidence, prior, translations, Gauss-Newton, non-maximum suppression."""

from dataclasses import replace

import numpy as np
import pytest

from reorient import so3
from reorient.imaging import Camera, DepthImage
from reorient.registration import (
    DepthView,
    Hypotheses,
    build_problem,
    evenly_spaced,
    fit_planes,
    measure_evidence,
    non_maximum_suppression,
    normal_equations,
    refine,
)
from reorient.registration.evidence import score
from reorient.registration.problem import BOX_POINTS
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Placement, Renderer, load_world
from reorient.world.sensing import Sensor

WORLD = load_world("benchmark")


def pair_of(mesh, seed=0, angle_deg=90.0, sensor=None):
    turn = np.radians(angle_deg)
    return sample_pair(np.random.default_rng(seed), Renderer(mesh), WORLD, sensor or Sensor(), turn, turn)


def errors_deg(R, truth):
    return np.degrees(so3.angle_difference(R, truth))


def motion_of(pair):
    """The true hypothesis."""
    center, R = pair.placement.center_m, pair.R_goal_current
    return Hypotheses(R[None], (center - R @ center)[None])


def test_planes_of_a_plane():
    camera = Camera(60, 50, 80.0, 70.0, 31.0, 24.0)
    normal, offset = np.array([0.3, -0.2, -0.93]) / np.linalg.norm([0.3, -0.2, -0.93]), -0.5
    depth_m = offset / (camera.rays() @ normal)
    depth_m[10:14] = 0
    planes = fit_planes(DepthImage(depth_m, camera))
    np.testing.assert_allclose(planes.normals, np.broadcast_to(normal, planes.normals.shape), atol=2e-4)
    np.testing.assert_allclose(planes.offsets_m, offset, atol=2e-4)


def test_the_pivot_costs_nothing_that_leaves_it_in_place(mesh, rng):
    pair = pair_of(mesh)
    prior = build_problem(pair.current, pair.goal, pair.placement.center_m).prior
    R = so3.sample_uniform(rng, 4)
    t_m = prior.translations(R)
    np.testing.assert_allclose(prior.mahalanobis2(R, t_m), 0, atol=1e-9)
    along = np.stack([so3.log(x) / np.linalg.norm(so3.log(x)) for x in R])
    across = np.cross(along, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    # a wrong pivot explains a shift across the axis, never one along it
    assert np.all(prior.mahalanobis2(R, t_m + 0.01 * along) > prior.mahalanobis2(R, t_m + 0.01 * across))


def test_first_translations(mesh, rng):
    """About a known pivot; else the visible points take the place of the goal's, whatever the rotation."""
    pair, R = pair_of(mesh, 3, 120), so3.sample_uniform(rng, 5)
    known = build_problem(pair.current, pair.goal, pair.pivot_m)
    np.testing.assert_allclose(R @ pair.pivot_m + known.first_translations(R), np.broadcast_to(pair.pivot_m, (5, 3)))
    unknown = build_problem(pair.current, pair.goal, None)
    seen, goal = (x.sample(BOX_POINTS).T for x in (unknown.current, unknown.goal))
    for turn, t_m in zip(R, unknown.first_translations(R), strict=True):
        x = seen @ turn.T + t_m
        low, high = np.stack([x.min(axis=0), goal.min(axis=0)]), np.stack([x.max(axis=0), goal.max(axis=0)])
        np.testing.assert_allclose(*(low + high)[:, :2] / 2, atol=1e-6)
        np.testing.assert_allclose(*low[:, 2], atol=1e-6)


def test_hypotheses_do_not_depend_on_their_company(mesh, rng):
    """Batches are only a matter of speed."""
    pair = pair_of(mesh, 3, 60)
    problem, R = build_problem(pair.current, pair.goal, None), so3.sample_uniform(rng, 700)
    every = problem.start(R)
    alone = every[np.array([0, 350, 699])]
    scores = problem.score(every, 0.03, 100)
    np.testing.assert_allclose(scores[[0, 350, 699]], problem.score(alone, 0.03, 100), atol=1e-6)
    H, g = normal_equations(problem, every, 0.03, 60)
    H_alone, g_alone = normal_equations(problem, alone, 0.03, 60)
    np.testing.assert_allclose(H[[0, 350, 699]], H_alone, rtol=1e-3, atol=1e-2)
    np.testing.assert_allclose(g[[0, 350, 699]], g_alone, rtol=1e-3, atol=1e-2)


def step_rad(H, g):
    """The turn of an undamped Gauss-Newton step."""
    return -np.linalg.solve(H, g[:, :, None])[0, :3, 0]


def test_steps_vanish_at_the_truth_and_lead_there_from_nearby(mesh):
    pair = pair_of(mesh, 5, 30)
    problem, truth = build_problem(pair.current, pair.goal, pair.placement.center_m), motion_of(pair)
    at_truth = step_rad(*normal_equations(problem, truth, 0.01, 2000))
    turn = so3.exp(np.array([[0.0, 0.05, 0.0]]))
    center = problem.prior.goal_m
    near = Hypotheses(turn @ truth.R, (turn @ (truth.t_m - center)[:, :, None])[:, :, 0] + center)
    H, nearby = normal_equations(problem, near, 0.01, 2000)
    assert np.linalg.norm(at_truth) < np.radians(0.3)
    assert step_rad(H, nearby) @ np.array([0.0, -1.0, 0.0]) > 0.02
    np.testing.assert_allclose(H, np.swapaxes(H, 1, 2), rtol=1e-4, atol=1e-2)
    assert np.linalg.eigvalsh(H).min() > 0


def test_descent_ends_at_the_truth(mesh, rng):
    pair = pair_of(mesh, 5, 30)
    problem, truth = build_problem(pair.current, pair.goal, None), motion_of(pair)
    turn = so3.exp(rng.normal(0, 0.08, (8, 3)))
    start = Hypotheses(turn @ truth.R, problem.prior.translations(turn @ truth.R))
    end = refine(problem, start, (0.05, 0.05, 0.04, 0.03, 0.02, 0.015, 0.01, 0.01, 0.005, 0.005), 1000)
    assert np.median(errors_deg(end.R, pair.R_goal_current)) < 0.5


def test_descent_without_turning_keeps_the_rotations(mesh, rng):
    pair = pair_of(mesh, 5, 30)
    problem, truth = build_problem(pair.current, pair.goal, None), motion_of(pair)
    end = refine(problem, Hypotheses(truth.R, truth.t_m + 0.01), (0.04, 0.03, 0.02, 0.01), 500, rotate=False)
    np.testing.assert_allclose(end.R, truth.R, atol=1e-12)
    assert np.linalg.norm(end.t_m - truth.t_m) < 0.002


def test_non_maximum_suppression_keeps_the_best_first_and_none_too_near():
    R = so3.exp(np.radians([[0.0, 0, 0], [4, 0, 0], [20, 0, 0], [24, 0, 0], [60, 0, 0]]))
    score = np.array([0.1, 0.5, 0.4, 0.3, 0.2])
    assert non_maximum_suppression(R, score, np.radians(10)).tolist() == [1, 2, 4]
    assert non_maximum_suppression(R, score, np.radians(10), 2).tolist() == [1, 2]


def test_earlier_observations_are_put_in_place_where_the_pivot_is_wrong(mesh):
    rng = np.random.default_rng(2)
    renderer, center = Renderer(mesh), np.array([0.0, 0.0, 0.6])
    placement, R = Placement(0.1, center), so3.exp(np.array([0.0, 0.6, 0.2]))
    R_then = so3.sample_uniform(rng, 1)[0]
    then, now = (DepthImage(renderer.depth(WORLD.camera, x, placement), WORLD.camera) for x in (R_then, R @ R_then))
    problem = build_problem(now, now, center + 0.008, [(then, R)])
    assert len(problem.views_now) == 2
    np.testing.assert_array_equal(problem.views_now[1].R_first_view, R)
    moved = R @ center + problem.views_now[1].t_first_view_m
    assert np.linalg.norm(moved - center) < 0.003
    assert (
        len(build_problem(now, now, center, [(now, so3.exp(np.array([0.0, 0.05, 0.0])))]).views_now) == 1
    )  # shows nothing new


def test_evidence_of_the_truth_and_of_its_inverse(mesh):
    pair = pair_of(mesh, angle_deg=20)
    R, center = pair.R_goal_current, pair.placement.center_m
    current, goal = DepthView(pair.current), DepthView(pair.goal)
    true = measure_evidence(current, goal, R, center - R @ center, 0.003)
    wrong = measure_evidence(current, goal, R.T, center - R.T @ center, 0.003)
    assert true.inlier_ratio > 0.6
    assert true.covisible_inlier_ratio > 0.95
    assert true.free_space_violation + true.silhouette_violation < 0.05
    assert true.residual_m < 0.0015
    assert wrong.score < true.score - 0.4
    shares = true.inlier_ratio, true.free_space_violation, true.silhouette_violation, true.occluded
    assert sum(shares) == pytest.approx(1)


def test_evidence_of_a_displaced_object(mesh):
    """Sideways: silhouette violations. Along the axis: occluded one way, free-space violations the other way."""
    view, still = DepthView(pair_of(mesh, angle_deg=20).goal), np.eye(3)
    pushed = {axis: measure_evidence(view, view, still, 0.03 * np.eye(3)[axis], 0.003) for axis in (0, 2)}
    assert pushed[0].silhouette_violation > 0.2
    assert pushed[2].occluded == pytest.approx(0.5, abs=0.15)
    assert pushed[2].free_space_violation == pytest.approx(0.5, abs=0.15)
    assert pushed[2].inlier_ratio < 0.1


def test_points_on_unknown_pixels_are_occluded(mesh):
    goal = pair_of(mesh, angle_deg=20).goal
    unknown = np.zeros(goal.depth_m.shape, bool)
    unknown[:, : int(np.median(np.nonzero(goal.valid)[1]))] = True  # half of the object, and all beside it
    whole, half = DepthView(goal), DepthView(replace(goal, unknown=unknown))
    lost = DepthView(replace(goal, depth_m=np.where(unknown, 0, goal.depth_m)))
    still, at = np.eye(3), np.zeros(3)
    known = measure_evidence(whole, lost, still, at, 0.003)
    evidence = measure_evidence(whole, half, still, at, 0.003)
    assert known.silhouette_violation > 0.2
    assert evidence.silhouette_violation == evidence.free_space_violation == 0
    assert evidence.occluded > 0.2
    assert evidence.covisible_inlier_ratio > 0.99


def test_an_unknown_part_does_not_pull(mesh):
    """Gauss-Newton stays at the truth, although half of the object's points fall on unknown pixels."""
    pair = pair_of(mesh, angle_deg=20)
    unknown = np.zeros(pair.goal.depth_m.shape, bool)
    unknown[:, : int(np.median(np.nonzero(pair.goal.valid)[1]))] = True
    steps = [0.02] * 8

    def error_deg(goal):
        refined = refine(build_problem(pair.current, goal, None), motion_of(pair), steps, 400)
        return errors_deg(refined.R[0], pair.R_goal_current)

    assert error_deg(replace(pair.goal, unknown=unknown)) < 1
    assert error_deg(replace(pair.goal, depth_m=np.where(unknown, 0, pair.goal.depth_m))) > 2


def test_points_beyond_the_frame_are_occluded(mesh):
    goal = pair_of(mesh, angle_deg=20).goal
    columns = np.nonzero(goal.valid)[1]
    cut = int(np.median(columns))
    half = DepthView(goal.cropped(cut, 0, goal.camera.width - cut, goal.camera.height))
    evidence = measure_evidence(DepthView(goal), half, np.eye(3), np.zeros(3), 0.003)
    assert evidence.occluded > 0.2
    assert evidence.silhouette_violation == 0


def test_an_unknown_pixel_apart_from_the_object_moves_no_outline(mesh):
    goal = pair_of(mesh, angle_deg=20).goal
    row, column = np.argwhere(goal.valid).min(axis=0) - 3
    unknown = np.zeros(goal.depth_m.shape, bool)
    unknown[row, column] = True
    views = DepthView(goal), DepthView(replace(goal, unknown=unknown))
    pushed = Hypotheses(np.eye(3)[None], np.array([[-0.03, -0.03, 0.0]])).single().move(views[0].sample(500))
    pixels = views[0].warp(pushed).pixel
    np.testing.assert_array_equal(*(view.outside_px(pixels) for view in views))


def test_points_that_miss_everything_have_no_residual(mesh):
    view = DepthView(pair_of(mesh, angle_deg=20).goal)
    evidence = measure_evidence(view, view, np.eye(3), np.array([5.0, 0.0, 0.0]), 0.003)
    assert evidence.silhouette_violation == 1
    assert np.isnan(evidence.residual_m)
    assert evidence.covisible_inlier_ratio == 0


def test_the_score_of_many_is_that_of_each(mesh, rng):
    pair = pair_of(mesh, angle_deg=20)
    current, goal = DepthView(pair.current), DepthView(pair.goal)
    hypotheses = Hypotheses(so3.sample_uniform(rng, 5), rng.normal(0, 0.1, (5, 3)))
    each = [
        measure_evidence(current, goal, R, t_m, 0.01, 200).score
        for R, t_m in zip(hypotheses.R, hypotheses.t_m, strict=True)
    ]
    np.testing.assert_allclose(score(current, goal, hypotheses, 0.01, 200), each, atol=0.02)


def test_hypotheses_compose(mesh, rng):
    R, t_m = so3.sample_uniform(rng, 3), rng.normal(0, 0.1, (3, 3))
    hypotheses, points = Hypotheses(R, t_m), rng.normal(0, 1, (3, 7))
    there = hypotheses.move(points)
    for k in range(3):
        np.testing.assert_allclose(there[k], R[k] @ points + t_m[k][:, None])
        np.testing.assert_allclose(hypotheses.inverse[np.array([k])].move(there[k])[0], points, atol=1e-12)
    R_then, t_then_m = so3.sample_uniform(rng, 1)[0], rng.normal(0, 0.1, 3)
    np.testing.assert_allclose(
        hypotheses.after(R_then, t_then_m).move(points),
        hypotheses.move(R_then @ points + t_then_m[:, None]),
        atol=1e-12,
    )
    about_m, R_left = rng.normal(0, 1, 3), so3.sample_uniform(rng, 3)
    perturbed = hypotheses.perturbed(about_m, R_left, np.zeros((3, 3))).move(points)
    for k in range(3):
        np.testing.assert_allclose(perturbed[k], R_left[k] @ (there[k] - about_m[:, None]) + about_m[:, None])


def test_evenly_spaced_covers_both_ends():
    assert evenly_spaced(10, 4).tolist() == [0, 3, 6, 9]
    assert evenly_spaced(3, 100).tolist() == [0, 1, 2]


def test_a_pivot_is_of_no_use_to_a_small_object(mesh):
    pair = pair_of(mesh)
    for size_px, known in ((128, True), (12, False)):
        small = [image.resized(size_px, size_px) for image in (pair.current, pair.goal)]
        near = [DepthImage(x.depth_m * (size_px / 128), x.camera) for x in small]  # the image of a smaller, nearer one
        pivot_m = pair.placement.center_m * (size_px / 128)
        assert build_problem(*near, pivot_m).prior.known is known
