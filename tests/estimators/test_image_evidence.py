"""Evidence images: their laws, and the choice of the hypotheses that a network sees."""

from dataclasses import replace

import numpy as np
import pytest

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators import image_verifier
from reorient.estimators.image_evidence import (
    CHANNELS,
    COMPARED,
    NOTHING,
    OUTSIDE,
    SIZE,
    UNKNOWN_HERE,
    UNKNOWN_THERE,
    evidence_images,
)
from reorient.estimators.image_verifier import MOST, SURE, ImageVerifier, load_image_verifier, shown_rows, with_images
from reorient.estimators.verifier import FEATURES, features
from reorient.registration import Hypotheses, Problem, build_problem
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import Sensor

DIFFERENCE, STATE, NORMALS = (CHANNELS.index(name) for name in ("difference", "state", "normals"))


@pytest.fixture(scope="module")
def pair(mesh):
    turn = np.radians(70)
    return sample_pair(np.random.default_rng(4), Renderer(mesh), load_world("benchmark"), Sensor(), turn, turn)


def still(*shifts_m):
    """No rotation, with translations."""
    return Hypotheses(np.tile(np.eye(3), (len(shifts_m), 1, 1)), np.array(shifts_m, float))


def test_an_image_agrees_with_itself(pair):
    images = evidence_images(build_problem(pair.goal, pair.goal, None), still([0, 0, 0]))
    assert images.shape == (1, 2, len(CHANNELS), SIZE, SIZE)
    shown = images[:, :, STATE] != NOTHING
    assert shown.mean() > 0.2
    assert np.all(images[:, :, STATE][shown] == COMPARED)
    assert np.all(images[:, :, DIFFERENCE][shown] == 128)
    assert np.all(images[:, :, NORMALS][shown] == 255)
    np.testing.assert_array_equal(images[:, 0], images[:, 1])


def test_the_object_fills_its_images(pair):
    state = evidence_images(build_problem(pair.current, pair.goal, None), still([0, 0, 0]))[0, :, STATE]
    for way in state != NOTHING:
        rows, columns = (np.nonzero(way.any(axis=axis))[0] for axis in (1, 0))
        assert max(np.ptp(rows), np.ptp(columns)) >= SIZE - 3
        assert abs(rows[0] + rows[-1] - (SIZE - 1)) <= 2
        assert abs(columns[0] + columns[-1] - (SIZE - 1)) <= 2


def test_nearer_points_violate_free_space_and_farther_ones_are_occluded(pair):
    problem = build_problem(pair.goal, pair.goal, None)
    nearer, farther, sideways = evidence_images(problem, still([0, 0, -0.01], [0, 0, 0.01], [0.5, 0, 0]))[:, 0]
    assert np.all(nearer[DIFFERENCE][nearer[STATE] == COMPARED] < 128)
    assert np.mean(farther[DIFFERENCE][farther[STATE] == COMPARED] > 128) > 0.99
    assert set(np.unique(sideways[STATE])) <= {NOTHING, *range(OUTSIDE + 1, 256)}
    assert not sideways[DIFFERENCE].any()


def test_exchanged_images_and_inverse_motions_exchange_the_two_ways(pair, rng):
    motions = Hypotheses(so3.exp(rng.normal(size=(5, 3))), rng.normal(size=(5, 3)) * 0.01)
    here = evidence_images(build_problem(pair.current, pair.goal, None), motions)
    there = evidence_images(build_problem(pair.goal, pair.current, None), motions.inverse)
    np.testing.assert_array_equal(here, there[:, ::-1])


def test_unknown_pixels_never_violate(pair):
    problem = build_problem(pair.current, replace(pair.goal, unknown=~pair.goal.valid), None)
    motions = problem.start(so3.grid(50)[:20])
    images = evidence_images(problem, motions)
    assert not np.any(images[:, 0, STATE] >= OUTSIDE)
    assert np.any(images[:, 0, STATE] == UNKNOWN_THERE)
    assert np.all(images[:, 1, STATE][images[:, 1, STATE] < COMPARED] == UNKNOWN_HERE)
    known = evidence_images(build_problem(pair.current, pair.goal, None), motions)
    assert np.any(known[:, 0, STATE] >= OUTSIDE)  # or the law above would say nothing


def test_the_true_motion_explains_more_than_others(pair):
    centre_m, R = pair.placement.center_m, pair.R_goal_current
    others = so3.exp(np.array([[0.4, 0, 0], [0, 0.4, 0], [0, 0, -0.4]])) @ R
    motions = np.concatenate([R[None], others])
    problem: Problem = build_problem(pair.current, pair.goal, None)
    images = evidence_images(problem, Hypotheses(motions, centre_m - motions @ centre_m))
    violated = (images[:, :, STATE] >= OUTSIDE) | (
        (images[:, :, STATE] == COMPARED) & (images[:, :, DIFFERENCE] < 128 - 50)
    )
    share = violated.sum(axis=(1, 2, 3)) / (images[:, :, STATE] >= COMPARED).sum(axis=(1, 2, 3))
    assert share[0] < 0.5 * share[1:].min()


def test_only_likely_hypotheses_of_unsure_sets_are_shown():
    log_odds = np.array([-3.0, 1.0, -9.0, 0.5])
    assert shown_rows(log_odds, np.full(4, 0.5)).tolist() == [1, 3, 0]
    assert len(shown_rows(log_odds, np.array([0, SURE, 0, 0]))) == 0
    assert len(shown_rows(np.zeros(3 * MOST), np.full(3 * MOST, 0.5))) == MOST


class Reversed:
    """A network whose answers are the log-odds of the trees with the other sign."""

    def run(self, outputs, inputs):
        assert inputs["images"].shape == (len(inputs["log_odds"]), 2, len(CHANNELS), SIZE, SIZE)
        return [-inputs["log_odds"]]


def test_the_network_decides_where_the_trees_are_unsure(pair, monkeypatch):
    problem = build_problem(pair.current, pair.goal, None)
    hypotheses = problem.start(so3.grid(50)[:5])
    values, log_odds = np.zeros((5, len(FEATURES))), np.array([2.0, -9.0, 1.0, -5.5, 0.0])
    unsure, sure = np.array([0.9, 0, 0.7, 0, 0.5]), np.full(5, 0.99)
    monkeypatch.setattr(image_verifier, "load_image_verifier", lambda: ImageVerifier(Reversed(), {"normal": (0.5, 1)}))
    answer, probability = with_images(problem, hypotheses, values, log_odds, unsure, "normal")
    assert answer.tolist() == [-2, -9, -1, -5.5, 0]  # the second and the fourth were not shown
    np.testing.assert_allclose(np.log(probability / (1 - probability)), 0.5 * answer + 1)
    log_odds[1] = 6.0
    answer, _ = with_images(problem, hypotheses, values, log_odds, unsure, "normal")
    assert answer.tolist() == [-2, -6, -1, -6, -6]  # what was not shown is no better than the worst that was
    for by_trees, effort in ((sure, "normal"), (unsure, "fast")):
        kept = with_images(problem, hypotheses, values, log_odds, by_trees, effort)
        assert kept[0] is log_odds
        assert kept[1] is by_trees


def test_the_shipped_network_prefers_the_true_motion_to_its_flips(mesh):
    """Of pairs that the trees are told not to know; for most, as some flips fit."""
    right = []
    for seed in range(8):
        turn = np.radians(50)
        pair = sample_pair(np.random.default_rng(seed), Renderer(mesh), load_world("benchmark"), Sensor(), turn, turn)
        centre_m, R = pair.placement.center_m, pair.R_goal_current
        motions = np.concatenate([R[None], so3.exp(np.pi * np.eye(3)) @ R])
        hypotheses = Hypotheses(motions, centre_m - motions @ centre_m)
        problem = build_problem(pair.current, pair.goal, None)
        answer, _ = with_images(
            problem, hypotheses, features(problem, hypotheses), np.zeros(4), np.full(4, 0.5), "normal"
        )
        right.append(np.argmax(answer) == 0)
    assert np.mean(right) >= 0.75


def test_a_broken_file_is_named(tmp_path):
    (tmp_path / "broken.onnx").write_bytes(b"nothing")
    with pytest.raises(ReorientError, match="cannot read the verifier .*broken.onnx"):
        load_image_verifier(tmp_path / "broken.onnx")
