"""Confidence sets: conformal coverage, nesting, no guarantee; the adaptive effort and its one thread."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from threadpoolctl import threadpool_info

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators import confidence_sets, load_estimator, rotation_search
from reorient.estimators.calibration import Calibration, load_calibration
from reorient.estimators.confidence_sets import candidate_sets
from reorient.estimators.threads import threads
from reorient.estimators.views_verifier import fingerprint
from reorient.registration import build_problem
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")


def pair_of(mesh, seed=0, angle_deg=40.0):
    turn = np.radians(angle_deg)
    return sample_pair(np.random.default_rng(seed), Renderer(mesh), WORLD, randomised(0.001), turn, turn)


@pytest.fixture(scope="module")
def easy(mesh):
    """An estimate and its problem."""
    pair = pair_of(mesh)
    return load_estimator().estimate(pair.current, pair.goal), build_problem(pair.current, pair.goal, None)


def probabilities(rng):
    """Of the candidates of one estimate; the truth is one of them, or none, with just these probabilities."""
    share = np.sort(rng.dirichlet([2.0, 0.6, 0.3, 0.2]))[::-1]
    return share[:3], int(rng.choice(4, p=share))


def test_sets_cover_the_truth_as_often_as_stated_whatever_the_probabilities_are_worth(easy, rng, monkeypatch):
    estimate, problem = easy
    drawn = [probabilities(rng) for _ in range(1200)]
    distorted = [(share**0.4, truth) for share, truth in drawn]  # a verifier that is far from calibrated
    scores = [p[k] if k < 3 else 0.0 for p, k in distorted]
    rotations = so3.exp(np.array([[0.0, 0, 0], [0, 1.0, 0], [2.0, 0, 0]]))
    groups = [f"one pair of views, noise {n}, found {f}" for n in range(2) for f in range(3)]
    known = Calibration((fingerprint(), ""), dict.fromkeys(groups, np.sort(scores[:600])), 1.0, 0.0)
    monkeypatch.setattr(confidence_sets, "load_calibration", lambda: known)
    for level in (0.5, 0.8, 0.9):
        covered, sizes = [], []
        for p, truth in distorted[600:]:
            candidates, guaranteed = candidate_sets(list(zip(rotations, p, strict=True)), problem, estimate.evidence)
            found = replace(estimate, candidates=candidates, guaranteed=guaranteed).confidence_set(level)
            sizes.append(len(found))
            covered.append(truth < 3 and any(np.array_equal(R, rotations[truth]) for R, _ in found))
        assert np.mean(covered) >= level - 0.05
        assert min(sizes) >= 1
    assert replace(estimate, candidates=candidates, guaranteed=guaranteed).confidence_set(0.999) is None


def test_a_set_of_a_higher_level_holds_those_of_lower_ones_and_the_answer(mesh):
    pair = pair_of(mesh, 4, 150)
    estimate = load_estimator().estimate(pair.current, pair.goal)
    sets = [estimate.confidence_set(level) for level in (0.05, 0.5, 0.8, 0.9, 0.95, 0.999)]
    given = [x for x in sets if x is not None]
    assert given
    assert sets[: len(given)] == given  # beyond the largest guaranteed level there is none
    for low, high in pairwise(given):
        assert [id(R) for R, _ in low] == [id(R) for R, _ in high][: len(low)]
    assert all(np.array_equal(x[0][0], estimate.R_goal_current) for x in given)


def test_the_candidates_are_distinct_and_ordered(mesh):
    estimate = load_estimator().estimate(*(getattr(pair_of(mesh, 4, 150), x) for x in ("current", "goal")))
    R = np.stack([x.R_goal_current for x in estimate.candidates])
    others = [x.probability for x in estimate.candidates[1:]]
    assert others == sorted(others, reverse=True)
    assert sum(x.probability for x in estimate.candidates) <= 1 + 1e-9
    between = so3.angle_difference(R[:, None], R[None])[~np.eye(len(R), dtype=bool)]
    assert np.all(between > np.radians(8))  # 12 degrees before the polish of the answer


def test_no_guarantee_without_calibration(mesh, easy, monkeypatch):
    pair = pair_of(mesh)
    assert load_estimator("gicp").estimate(pair.current, pair.goal).confidence_set() is None
    estimate, problem = easy
    other = replace(load_calibration(), verifiers=("of another verifier", ""))
    monkeypatch.setattr(confidence_sets, "load_calibration", lambda: other)
    _, guaranteed = candidate_sets([(estimate.R_goal_current, 0.99)], problem, estimate.evidence)
    assert guaranteed == 0
    for level in (0, 1, 1.5, -0.1, float("nan")):
        with pytest.raises(ReorientError, match="expected a probability between 0 and 1"):
            estimate.confidence_set(level)


def test_the_calibration_of_the_package_is_of_its_verifier():
    """Fails after a training of the verifier: run `reorient verifier calibrate` then."""
    assert load_calibration().verifiers[0] == fingerprint()


def test_a_file_that_is_no_calibration_is_refused(tmp_path):
    path = tmp_path / "calibration.json"
    for text in ("", "[]", json.dumps({"verifiers": ["x", "y"]})):
        path.write_text(text)
        with pytest.raises(ReorientError, match="cannot read the calibration .* expected what `reorient verifier cal"):
            load_calibration(path)


def count_searches(monkeypatch):
    done = []
    search = rotation_search.search
    monkeypatch.setattr(rotation_search, "search", lambda *a, **more: done.append(a[1]) or search(*a, **more))
    return done


def test_an_easy_pair_is_searched_once(mesh, monkeypatch):
    done = count_searches(monkeypatch)
    pair = pair_of(mesh)
    estimate = load_estimator().estimate(pair.current, pair.goal)
    assert estimate.confidence >= rotation_search.ENOUGH
    assert len(done) == 1


def test_in_doubt_the_answer_is_that_of_the_normal_effort(monkeypatch):
    """A box: flips match as well."""
    pair = pair_of(trimesh.creation.box((1.0, 0.7, 0.45)), 1, 60)
    normal = load_estimator("default", effort="normal").estimate(pair.current, pair.goal)
    done = count_searches(monkeypatch)
    adaptive = load_estimator("default").estimate(pair.current, pair.goal)
    assert len(done) == 2
    np.testing.assert_array_equal(adaptive.R_goal_current, normal.R_goal_current)
    assert adaptive.confidence == normal.confidence


def blas_threads():
    return {x["num_threads"] for x in threadpool_info() if x["user_api"] == "blas"}


def test_one_thread_while_an_estimate_runs():
    with threads(2):
        before = blas_threads()
        assert before == {2}
        with threads(None):
            assert blas_threads() == {2}
    outside = blas_threads()
    with threads(1):
        assert blas_threads() == {1}
        with threads(1):
            pass
        assert blas_threads() == {1}
    assert blas_threads() == outside
