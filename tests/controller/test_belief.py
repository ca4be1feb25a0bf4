"""The belief: a fold over the steps."""

import gc
import weakref

import numpy as np
import pytest
from oracles import NOW, Oracle, answer, cell, lying_box

from reorient import Fusing, orient, so3
from reorient.controller.arrival import Arrival, Observation, PreparedGoal
from reorient.controller.base import Step, history_of
from reorient.controller.belief import Belief
from reorient.controller.hypotheses import BeliefSettings, Hypothesis, Viewpoint, hypotheses_of
from reorient.imaging import Goal

A, B, C = (so3.exp(np.array(x)) for x in ([0.7, 0, 0.2], [0, 2.0, 0], [0, 0, 2.5]))


@pytest.fixture
def image(mesh):
    return cell(mesh)[0].capture()


def folded(goal, steps, **settings):
    belief = Belief(PreparedGoal(goal, Goal(goal)), BeliefSettings(**settings))
    for step in steps:
        belief = belief.updated(step)
    return belief


def two_steps(image, R, **move):
    """Two views that each leave two rotations open; only R is common to both."""
    first = answer(B @ R, 0.5, (R, 0.4))
    second = answer(C @ R @ A.T, 0.5, (R @ A.T, 0.4))
    return [Step(0, image, first, A, **move), Step(1, image, second)]


def test_views_add_up_along_known_motions(image):
    R = so3.exp(np.array([0.3, -1.0, 0.5]))
    belief = folded(image, two_steps(image, R, R_executed=A))
    np.testing.assert_allclose(belief.R_goal_now(belief.hypotheses[0]), R @ A.T, atol=1e-9)
    assert len(belief.hypotheses) == 3
    assert set(belief.hypotheses[0].probabilities) == {0, 1}


def test_motions_compose_on_the_left(image):
    """Three views of one goal after motions that do not commute are one hypothesis."""
    R, steps = C, []
    for k, move in enumerate((A, B, None)):
        steps.append(Step(k, image, answer(R, 0.5), move, move))
        R = R if move is None else R @ move.T
    belief = folded(image, steps)
    assert len(belief.hypotheses) == 1
    np.testing.assert_allclose(belief.viewpoint_now.R_then_start, B @ A, atol=1e-12)
    np.testing.assert_allclose(belief.R_goal_now(belief.hypotheses[0]), R, atol=1e-9)
    assert belief.viewpoint_now.path_rad == pytest.approx(float(so3.angle(A) + so3.angle(B)))


def test_an_unknown_motion_begins_a_new_chain(image):
    R = so3.exp(np.array([0.3, -1.0, 0.5]))
    belief = folded(image, two_steps(image, R, R_executed=None, error="refused"))
    np.testing.assert_allclose(belief.R_goal_now(belief.hypotheses[0]), C @ R @ A.T, atol=1e-9)
    assert len(belief.hypotheses) == 2
    assert (len(belief.viewpoints), belief.images, belief.commanded_moves) == (1, 2, 1)


def test_a_step_that_is_given_again_replaces_itself(image):
    """As observed, after its move, and undone: the last one counts, as if it had come alone."""
    R = so3.exp(np.array([0.3, -1.0, 0.5]))
    before, after = two_steps(image, R, R_executed=A)
    observed = Step(0, image, before.estimate)
    undone = Step(0, image, before.estimate, A, np.eye(3), undone=True)
    for last in (before, undone):
        often = folded(image, [observed, before, before, last, after])
        once = folded(image, [last, after])
        assert (often.images, often.commanded_moves) == (once.images, once.commanded_moves) == (2, 1 + last.undone)
        assert [len(x.observations) for x in often.viewpoints] == [1, 1]
        for one, other in zip(often.hypotheses, once.hypotheses, strict=True):
            np.testing.assert_array_equal(one.R_goal_start, other.R_goal_start)
            assert one.log_odds == other.log_odds


def test_a_belief_is_not_changed_by_its_successors(image):
    R = so3.exp(np.array([0.3, -1.0, 0.5]))
    first, second = two_steps(image, R, R_executed=A)
    belief = folded(image, [first])
    known = belief.hypotheses
    belief.updated(second)
    assert (belief.images, len(belief.viewpoints), belief.hypotheses) == (1, 1, known)
    with pytest.raises(AttributeError):
        belief.images = 2


def test_an_undone_move_marks_its_orientation_as_hidden(image):
    near, elsewhere = so3.exp(np.array([0.05, 0, 0])), so3.exp(np.array([0, 0, -1.0]))
    undone = Step(0, image, answer(A), A, np.eye(3), undone=True)
    belief = folded(image, [undone, Step(1, image, answer(A))])
    assert [belief.times_hidden(x) for x in (A, near @ A, elsewhere @ A)] == [1, 1, 0]
    again = belief.updated(Step(1, image, answer(A), elsewhere, elsewhere)).updated(Step(2, image, answer(A)))
    assert again.times_hidden(A @ elsewhere.T) == 1
    assert again.times_hidden(A) == 0


def test_the_fused_estimate_is_robust_and_carried_by_motions(image):
    rng = np.random.default_rng(1)
    R = so3.exp(np.array([0.01, 0.0, 0.0]))
    steps = []
    for k in range(6):
        error = rng.normal(0, 0.003, 3) if k != 3 else np.array([0.1, 0, 0])
        move = so3.exp(np.array([0.004, 0.002, 0.0])) if k == 2 else None
        steps.append(Step(k, image, answer(so3.exp(error) @ R, 0.9), move, move))
        R = R if move is None else R @ move.T
    belief = folded(image, steps, arrival_test=lambda *_: Arrival(0.0))
    median, error_rad = belief.fused(Hypothesis(R @ belief.viewpoint_now.R_then_start))
    assert float(so3.angle_difference(median, R)) < 0.004
    assert 0 < error_rad < 0.01


def test_of_two_tested_poses_the_likelier_one_wins(image):
    flip = so3.exp(np.array([np.pi, 0, 0]))
    observations = (Observation(image, answer(np.eye(3), 0.9)),) * 2
    for nll, nearer in (((3.0, 5.0), flip), ((5.0, 3.0), np.eye(3))):
        viewpoints = [
            Viewpoint(observations, R, arrival=Arrival(log_odds, depth_nll))
            for R, log_odds, depth_nll in zip((flip, np.eye(3)), (2.0, 3.0), nll, strict=True)
        ]
        best, other = hypotheses_of(viewpoints, BeliefSettings())
        assert float(so3.angle_difference(best.R_goal_start, nearer)) < 1e-6
        assert best.log_odds == pytest.approx(np.log(9) + 3)  # the largest of both
        assert best.log_odds - other.log_odds == pytest.approx(2 * 2)  # observations of each times the difference


def test_history_takes_earlier_images_to_now(mesh):
    station, goal, R_goal = cell(mesh)
    steps, orientations = [], []
    for k in range(4):  # rotations that do not commute
        orientations.append(station.R_camera_object)
        done = station.rotate(so3.exp(np.array([0.3, -0.2 * k, 0.2])))
        steps.append(Step(k, station.capture(), answer(R_goal), done, done))
    for (image, R_now_then), step, R_then in zip(history_of(steps), steps, orientations, strict=True):
        assert image is step.image
        np.testing.assert_allclose(R_now_then @ R_then, station.R_camera_object, atol=1e-12)
    lost = Step(4, goal, answer(R_goal), A, None, error="refused")
    assert history_of([*steps, lost]) == []
    assert [image for image, _ in history_of([*steps, lost, steps[0]])] == [steps[0].image]


@pytest.mark.slow
def test_tests_of_a_loop_are_linear_in_its_images():
    """One arrival test an image at most, and one set of flips a viewpoint."""
    mesh, flip = lying_box()
    station, goal, R_goal = cell(mesh, 170.0, seed=3, noise_m=0.001)
    settings = BeliefSettings()
    calls = []

    def counted(observations, goal):
        calls.append(observations[-1].image)
        return settings.arrival_test(observations, goal)

    strategy = Fusing(belief_settings=BeliefSettings(arrival_test=counted))
    result = orient(station, goal, Oracle(station, R_goal, flip=flip), strategy, limits=NOW)
    assert len(calls) > 8
    assert len({id(image) for image in calls}) == len(calls)
    assert {id(image) for image in calls} <= {id(step.image) for step in result.steps}


@pytest.mark.slow
def test_nothing_of_a_finished_loop_stays_alive():
    mesh, flip = lying_box()
    station, goal, R_goal = cell(mesh, 170.0, seed=3, noise_m=0.001)
    strategy, oracle = Fusing(), Oracle(station, R_goal, flip=flip)
    result = orient(station, goal, oracle, strategy, limits=NOW)
    assert len(result.steps) > 8
    alive = [weakref.ref(goal), *(weakref.ref(step.image) for step in result.steps)]
    oracle.histories.clear()
    del result, goal
    gc.collect()
    assert [ref() for ref in alive] == [None] * len(alive)
