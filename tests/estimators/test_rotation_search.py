"""Rotation search: any rotation, alternatives, history, confidence; its search, verifier and polish."""

import numpy as np
import pytest
import trimesh

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators import load_estimator
from reorient.estimators import polish as polish_module
from reorient.estimators import search as search_module
from reorient.estimators.polish import Polished, polish, uncertainty
from reorient.estimators.rotation_search import RotationSearch
from reorient.estimators.search import EFFORTS, INCOMPLETE, Stage, from_no_rotation, perturb_and_select, search
from reorient.estimators.verifier import FEATURES, Verifier, features, load_verifier
from reorient.imaging import Camera, DepthImage
from reorient.registration import Hypotheses, build_problem
from reorient.registration.depth_view import LARGEST_PX, DepthView
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Placement, Renderer, load_world
from reorient.world.sensing import Sensor, randomised

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


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [45, 90, 150])
@pytest.mark.parametrize("given", [True, False])
def test_far_rotations(mesh, angle_deg, given):
    pairs = [pair_of(mesh, seed, angle_deg, randomised(0.001)) for seed in range(6)]
    estimator = load_estimator("default")
    estimates = [estimator.estimate(p.current, p.goal, p.pivot_m if given else None) for p in pairs]
    errors = [errors_deg(e.R_goal_current, p.R_goal_current) for e, p in zip(estimates, pairs, strict=True)]
    assert np.mean(np.array(errors) < 5) >= (0.8 if angle_deg < 120 else 0.5)
    assert all(0 <= e.confidence <= 1 for e in estimates)


def test_mirror_inverse_and_conjugate_are_distinguished(mesh):
    pair = pair_of(mesh, 3, 100)
    R, R_start = pair.R_goal_current, pair.R_camera_object
    estimate = load_estimator().estimate(pair.current, pair.goal, pair.pivot_m)
    assert errors_deg(estimate.R_goal_current, R) < 3
    assert np.linalg.det(estimate.R_goal_current) == pytest.approx(1)
    for wrong in (R.T, R_start.T @ R @ R_start):
        assert errors_deg(estimate.R_goal_current, wrong) > 10
    mirrored = DepthImage(pair.goal.depth_m[:, ::-1], pair.goal.camera)  # what no rotation makes
    unlike = load_estimator().estimate(pair.current, mirrored, pair.pivot_m)
    assert unlike.confidence < estimate.confidence


def test_deterministic(mesh):
    pair = pair_of(mesh, 1, 80, randomised(0.001))
    first, second = (load_estimator().estimate(pair.current, pair.goal) for _ in range(2))
    np.testing.assert_array_equal(first.R_goal_current, second.R_goal_current)
    assert first.confidence == second.confidence


@pytest.mark.slow
def test_many_are_the_same_as_one_by_one(mesh):
    pairs = [pair_of(mesh, seed, 40) for seed in range(2)]
    estimator = RotationSearch("fast")
    many = estimator.estimate_many([(p.current, p.goal) for p in pairs], [p.pivot_m for p in pairs], workers=2)
    for estimate, pair in zip(many, pairs, strict=True):
        alone = estimator.estimate(pair.current, pair.goal, pair.pivot_m)
        np.testing.assert_array_equal(estimate.R_goal_current, alone.R_goal_current)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_pivot_each_or_none(mesh, workers):
    pair = pair_of(mesh, 0, 40)
    with pytest.raises(ReorientError, match="1 pivots for 3 pairs: expected one each"):
        RotationSearch("fast").estimate_many([(pair.current, pair.goal)] * 3, [None], workers)


@pytest.mark.parametrize("effort", [None, "fast", "normal"])
def test_every_effort_answers_and_has_its_calibration(mesh, effort):
    pair = pair_of(mesh, 2, 50, randomised(0.001))
    estimate = RotationSearch(effort).estimate(pair.current, pair.goal, pair.pivot_m)
    assert errors_deg(estimate.R_goal_current, pair.R_goal_current) < 5
    assert 0.5 < estimate.confidence <= 1
    assert set(load_verifier().calibration) == set(EFFORTS)


def test_unknown_effort():
    with pytest.raises(ReorientError, match="unknown effort 'norml': expected one of .*did you mean 'normal'"):
        load_estimator("default", effort="norml")
    with pytest.raises(ReorientError, match="'gicp' with effort='fast': expected an effort with 'default' alone"):
        load_estimator("gicp", effort="fast")


@pytest.mark.slow
def test_a_symmetric_object_has_alternatives_with_the_truth_among_them():
    """A box of three different sides: rotations by 180 degrees about its axes look alike."""
    found = []
    for seed in range(6):
        pair = pair_of(trimesh.creation.box((1.0, 0.7, 0.45)), seed, 60)
        estimate = load_estimator().estimate(pair.current, pair.goal, pair.pivot_m)
        rotations = [estimate.R_goal_current, *(R for R, _ in estimate.alternatives)]
        found.append((len(rotations), errors_deg(np.stack(rotations), pair.R_goal_current).min()))
        assert sum(p for _, p in estimate.alternatives) <= 1
    counts, errors = np.array(found).T
    assert np.median(counts) >= 2
    assert np.mean(errors < 5) >= 0.8


def test_a_distinctive_object_has_none(mesh):
    pairs = [pair_of(mesh, seed, 40) for seed in range(6)]
    estimates = [load_estimator().estimate(p.current, p.goal, p.pivot_m) for p in pairs]
    assert sum(not e.alternatives for e in estimates) >= 4


@pytest.mark.slow
def test_history_enlarges_the_evidence(mesh):
    """Earlier views between start and goal decide what two views that share little leave open."""
    rng = np.random.default_rng(4)
    renderer, center = Renderer(mesh), np.array([0.0, 0.0, 0.6])
    placement = Placement(0.1, center)
    alone, helped = [], []
    for _ in range(6):
        R_goal = so3.sample_uniform(rng, 1)[0]
        axis = so3.sample_axes(rng, 1)[0]
        steps = [so3.exp(axis * np.radians(a)) for a in (40.0, 80.0, 150.0)]

        def image(R, R_goal=R_goal):
            return DepthImage(renderer.depth(WORLD.camera, R @ R_goal, placement), WORLD.camera)

        now = steps[2]
        history = [(image(R), now @ R.T) for R in steps[:2]]
        for errors, past in ((alone, ()), (helped, history)):
            estimate = load_estimator("fast").estimate(image(now), image(np.eye(3)), center, past)
            errors.append(errors_deg(estimate.R_goal_current, now.T))
    assert np.sum(np.array(helped) < 5) >= np.sum(np.array(alone) < 5)
    assert np.mean(np.array(helped) < 5) >= 0.8


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "R_now_then", [np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.full((3, 3), np.nan), np.eye(4), None]
)
def test_a_history_of_other_things_than_rotations_is_refused(mesh, R_now_then):
    pair = pair_of(mesh)
    for history in ([(pair.current, R_now_then)], [(pair.current.depth_m, np.eye(3))], [pair.current], None):
        with pytest.raises(ReorientError, match=r"history: expected pairs \(DepthImage, R_now_then\)"):
            load_estimator("fast").estimate(pair.current, pair.goal, None, history)


def test_degenerate_images_are_answered_or_refused():
    camera = Camera(64, 64, 60.0, 60.0, 32.0, 32.0)
    line, dot = np.zeros((64, 64)), np.zeros((64, 64))
    line[30, 5:60], dot[20:25, 20:25] = 0.5, 0.5
    for current in (line, dot):
        estimate = load_estimator("fast").estimate(DepthImage(current, camera), DepthImage(line, camera))
        assert so3.is_rotation(estimate.R_goal_current)
        assert np.isfinite(estimate.confidence)


@pytest.mark.parametrize("f", [535.0, 1122.0])
def test_other_cameras(mesh, f):
    """Another focal length and image size, off the centre; large pictures are shrunk."""
    rng = np.random.default_rng(1)
    renderer, R_start = Renderer(mesh), so3.sample_uniform(rng, 1)[0]
    R = so3.exp(np.radians([40.0, -50.0, 20.0]))
    camera = Camera(500, 400, f, f, 180.0, 230.0)
    placement = Placement(0.1, np.array([0.03, -0.02, 0.7]))
    images = [DepthImage(renderer.depth(camera, x, placement), camera) for x in (R_start, R @ R_start)]
    assert max(DepthView(images[0]).image.depth_m.shape) <= LARGEST_PX + 1
    estimate = load_estimator().estimate(*images)
    assert errors_deg(estimate.R_goal_current, R) < 1.5


def test_perturb_and_select_never_lowers_the_score(mesh, rng):
    pair = pair_of(mesh, 2, 60)
    problem = build_problem(pair.current, pair.goal, pair.pivot_m)
    start = problem.start(so3.sample_uniform(rng, 6))
    stage = Stage(
        tolerances=(), points=0, scored_tolerance=0.03, scored_points=300, keep=6, radius_deg=0.0,
        copies=16, rotation_rad=0.2, shift=0.03,
    )  # fmt: skip
    before, after = (problem.score(x, 0.03, 300) for x in (start, perturb_and_select(problem, start, rng, stage)))
    assert np.all(after >= before - 1e-6)
    assert np.any(after > before + 0.01)


def test_the_most_probable_hypothesis_is_the_truth(mesh):
    pair = pair_of(mesh, 2, 60)
    problem = build_problem(pair.current, pair.goal, pair.pivot_m)
    hypotheses = search(problem, EFFORTS["fast"]).hypotheses
    values = features(problem, hypotheses)
    assert values.shape == (len(hypotheses), len(FEATURES))
    assert np.all(np.isfinite(values))
    best = np.argmax(load_verifier().log_odds(values))
    assert errors_deg(hypotheses.R[best], pair.R_goal_current) < 5


def test_trees_by_hand():
    """One tree: below 0.5 in feature 1 adds -2; above it, feature 0 decides between 1 and 3."""
    verifier = Verifier(
        feature=np.array([[1, 0, 0, 0, 0]]),
        threshold=np.array([[0.5, np.inf, 2.0, np.inf, np.inf]]),
        left=np.array([[1, 1, 3, 3, 4]]),
        right=np.array([[2, 1, 4, 3, 4]]),
        value=np.array([[0.0, -2.0, 0.0, 1.0, 3.0]]),
        depth=2,
        baseline=0.5,
        calibration={"normal": (2.0, -1.0), "fast": (1.0, 0.0)},
    )
    values = np.array([[9.0, 0.5], [2.0, 0.6], [2.1, 0.6]])
    np.testing.assert_allclose(verifier.log_odds(values), [-1.5, 1.5, 3.5])
    np.testing.assert_allclose(verifier.probability(np.array([0.5]), "normal"), [0.5])
    np.testing.assert_allclose(verifier.probability(np.array([0.0]), "fast"), [0.5])


def test_a_file_that_is_no_verifier_is_refused(tmp_path):
    path = tmp_path / "verifier.npz"
    path.write_bytes(b"no weights")
    with pytest.raises(ReorientError, match="cannot read the verifier .* expected the package's verifier.npz"):
        load_verifier(path)


def test_the_polish_improves_an_answer_and_leaves_one_that_its_steps_worsen(mesh, monkeypatch):
    pair = pair_of(mesh, 5, 60, randomised(0.001))
    problem, truth = build_problem(pair.current, pair.goal, pair.pivot_m), motion_of(pair)
    slid = Hypotheses(so3.exp(np.array([[0.0, 0.2, 0.0]])) @ truth.R, truth.t_m)
    polished = polish(problem, Hypotheses(so3.exp(np.array([[0.0, 0.03, 0.0]])) @ truth.R, truth.t_m))
    assert errors_deg(polished.hypothesis.R[0], pair.R_goal_current) < 1
    assert uncertainty(problem, polished)[1]
    assert not uncertainty(problem, Polished(slid, 0))[1]
    monkeypatch.setattr(polish_module, "refine", lambda *_: slid)
    monkeypatch.setattr(polish_module, "register", lambda *_: Polished(slid, 5))
    assert polish(problem, truth).hypothesis is truth


@pytest.mark.parametrize(("cut", "incomplete"), [(True, True), (False, False)])
def test_icp_from_no_rotation_joins_where_a_part_is_beyond_the_frame(mesh, cut, incomplete, monkeypatch):
    pair = pair_of(mesh, 2, 12, Sensor(rectangle=False, dropout=0))
    goal = pair.goal
    if cut:  # at the column that leaves two thirds of the returns
        left = int(np.quantile(np.nonzero(goal.valid)[1], 1 / 3))
        goal = goal.cropped(left, 0, goal.camera.width - left, goal.camera.height)
    problem = build_problem(pair.current, goal, None)
    assert (max(x.unknown_outline for x in (problem.current, problem.goal)) >= INCOMPLETE) == incomplete
    assert errors_deg(from_no_rotation(problem).R[0], pair.R_goal_current) < 1
    marked = problem.start(so3.exp(np.array([[0.1, -0.2, 0.3]])))  # what no search finds
    monkeypatch.setattr(search_module, "from_no_rotation", lambda _: marked)
    found = search(problem, EFFORTS["fast"])
    joined = errors_deg(found.hypotheses.R, marked.R[0]) < 1e-6
    assert joined.any() == incomplete
    assert not found.silhouettes[joined].any()
    assert not np.any(errors_deg(search(problem, EFFORTS["fast"], robust=False).hypotheses.R, marked.R[0]) < 1e-6)
