"""The few-moves strategy: few moves, flips detected on arrival, and no false success."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import NOW, Hiding, Oracle, Wrapped, answer, cell, left_deg, lying_box

from reorient import Fusing, load_estimator, orient, so3
from reorient.controller.arrival import Arrival, PreparedImage
from reorient.controller.base import Step
from reorient.controller.hypotheses import BeliefSettings
from reorient.controller.symmetry import dominant_axes
from reorient.stations.faulty import FaultyStation


def arriving(log_odds, **settings):
    """The strategy with an arrival test that always has one result."""
    return Fusing(belief_settings=BeliefSettings(arrival_test=lambda *_: Arrival(log_odds)), **settings)


def phases(result):
    return [step.phase for step in result.steps]


def test_one_full_move_three_observations_and_done(mesh):
    station, goal, R_goal = cell(mesh)
    result = orient(station, goal, Oracle(station, R_goal), Fusing())
    assert result.status == "converged"
    assert (result.moves, left_deg(station, R_goal) < 1e-4) == (1, True)
    assert phases(result) == ["approach", "verify", "settle", "done"]  # one before the move, three that agree after it
    assert result.confidence > 0.9
    assert all(step.message for step in result.steps)


@pytest.mark.slow
def test_averaging_beats_single_estimates(mesh):
    ends = []
    for seed in range(6):
        station, goal, R_goal = cell(mesh, 30, seed)
        result = orient(station, goal, Oracle(station, R_goal, np.radians(0.3)), Fusing())
        assert result.moves <= 5
        ends.append(left_deg(station, R_goal))
    assert np.mean(ends) < 0.75 * np.degrees(np.linalg.norm([np.radians(0.3)] * 3))


def test_a_false_arrival_is_detected_and_left(mesh):
    """An estimator that confuses flips; the images do not."""
    station, goal, R_goal = cell(mesh, 170.0)
    flip = so3.exp(np.pi * dominant_axes(PreparedImage(goal))[0])
    result = orient(station, goal, Oracle(station, R_goal, flip=flip), Fusing(), limits=NOW)
    assert result.converged
    assert left_deg(station, R_goal) < 3
    flips = [step for step in result.steps if step.R_step is not None and float(so3.angle(step.R_step)) > 2.9]
    assert flips
    assert {step.phase for step in flips} <= {"compare", "approach"}
    assert result.moves <= 8


def test_what_never_matches_ends_unsure(mesh):
    station, goal, R_goal = cell(mesh)
    wrong = Oracle(station, so3.exp(np.array([1.0, 0.8, 0.3])) @ R_goal)  # always sure of another orientation
    result = orient(station, goal, wrong, Fusing(), limits=NOW)
    assert result.status in ("unsure", "max_moves")
    assert result.confidence < 0.5
    assert result.moves <= Fusing().max_moves


@pytest.mark.slow
@pytest.mark.parametrize(("knob", "status"), [(0.0, "converged"), (0.15, "unsure")])
def test_other_views_decide_whether_equal_orientations_are_one(knob, status):
    """A symmetric object has arrived; one that only appears so from the goal's side may not have."""
    mesh, flip = lying_box(knob)
    station, goal, R_goal = cell(mesh, 170.0, seed=3, noise_m=0.001)
    result = orient(station, goal, Oracle(station, R_goal, flip=flip), Fusing(), limits=NOW)
    assert min(left_deg(station, R_goal), left_deg(station, flip @ R_goal)) < 3
    assert result.status == status
    assert (result.confidence > 0.5) == (status == "converged")
    assert result.moves <= 10


@pytest.mark.slow
def test_where_other_sides_are_not_visible_equal_orientations_end_unsure():
    class OneSided(Hiding):
        """Shows one side of the object only."""

        def hides(self):
            return float((self.station.R_camera_object @ self.R_hidden.T)[2, 2]) < -0.2

    mesh, flip = lying_box()
    station, goal, R_goal = cell(mesh, seed=3, noise_m=0.001)
    station.R_camera_object = so3.exp(np.array([0.5, 0.2, 0.3])) @ flip @ R_goal
    result = orient(OneSided(station, R_goal), goal, Oracle(station, R_goal, flip=flip), Fusing(), limits=NOW)
    undone = [step for step in result.steps if step.undone]
    assert [step.phase for step in undone] == ["probe_symmetry"]
    assert result.status == "unsure"
    assert result.confidence <= 0.5


@pytest.mark.parametrize(("above", "status"), [(-0.1, "unsure"), (0.1, "converged")])
def test_a_confident_estimator_does_not_suffice(mesh, above, status):
    """Its confidence is 99%; the arrival test hardly passes."""
    station, goal, R_goal = cell(mesh, 20.0)
    oracle = Oracle(station, R_goal, confidence=0.99)
    result = orient(station, goal, oracle, arriving(Fusing().min_arrival_log_odds + above), limits=NOW)
    assert result.status == status
    assert (result.confidence > 0.9) == (status == "converged")


@pytest.mark.parametrize(("error_rad", "status"), [(0.005, "converged"), (0.03, "unsure")])
def test_a_shape_that_hardly_constrains_one_axis_ends_unsure(mesh, error_rad, status):
    station, goal, R_goal = cell(mesh, 20.0)
    oracle = Oracle(station, R_goal, covariance_rad2=np.diag([error_rad, 0.001, 0.001]) ** 2)
    result = orient(station, goal, oracle, Fusing(), limits=NOW)
    assert left_deg(station, R_goal) < 0.1
    assert result.status == status


def test_of_equivalent_hypotheses_the_nearest_is_approached(mesh):
    station, goal, R_goal = cell(mesh, 20.0)
    R = R_goal @ station.R_camera_object.T
    far = so3.exp(np.array([0, 0, 2.0])) @ R
    strategy = Fusing()
    belief = strategy.start(goal).updated(Step(0, goal, answer(far, 0.5, (R, 0.45))))
    np.testing.assert_allclose(strategy.decide(belief, lambda _: True).R_step, R)
    np.testing.assert_allclose(strategy.decide(belief, lambda x: float(so3.angle(x)) > 1).R_step, far)


def test_a_decision_depends_on_the_belief_alone(mesh):
    station, goal, R_goal = cell(mesh, 20.0)
    belief = Fusing().start(goal).updated(Step(0, goal, answer(R_goal @ station.R_camera_object.T, 0.9)))
    first, again = Fusing().decide(belief, lambda _: True), Fusing().decide(belief, lambda _: True)
    np.testing.assert_array_equal(first.R_step, again.R_step)
    assert first.message == again.message


def test_default_from_far_in_few_moves(mesh):
    station, goal, R_goal = cell(mesh, 150.0, noise_m=0.001)
    result = orient(station, goal, load_estimator("fast"))
    assert result.converged
    assert left_deg(station, R_goal) < 1
    assert result.moves <= 6


class Torn(Oracle):
    """Gives another orientation, 180 degrees from the goal's, a little more probability than the goal's."""

    def estimate(self, current, goal, pivot_m=None, history=()):
        estimate = super().estimate(current, goal, pivot_m, history)
        R = estimate.R_goal_current
        flipped = so3.exp(np.array([np.pi, 0, 0])) @ R
        return replace(estimate, R_goal_current=flipped, confidence=0.55, alternatives=((R, 0.4),))


def test_a_move_that_hides_the_object_is_undone_and_the_next_hypothesis_tried(mesh):
    station, goal, R_goal = cell(mesh, 80.0)
    hiding = Hiding(station, so3.exp(np.array([np.pi, 0, 0])) @ R_goal)
    result = orient(hiding, goal, Torn(station, R_goal), Fusing(), limits=NOW)
    assert left_deg(station, R_goal) < 1e-3
    undone = [step for step in result.steps if step.undone]
    assert len(undone) == 1  # never tried again
    assert float(so3.angle(undone[0].R_executed)) < 1e-6
    assert result.moves == sum(step.R_step is not None for step in result.steps) + 1


def test_a_camera_that_failed_after_a_move_does_not_rule_out_the_goal(mesh):
    station, goal, R_goal = cell(mesh, 80.0)
    silent = FaultyStation(station, np.random.default_rng(0), planned=["gone"] * 2)  # four errors in a row
    result = orient(silent, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert sum(step.undone for step in result.steps) == 1
    assert result.converged
    assert left_deg(station, R_goal) < 1e-3


def test_what_stays_hidden_is_given_up_after_two_tries(mesh):
    station, goal, R_goal = cell(mesh, 80.0)
    result = orient(Hiding(station, R_goal), goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert sum(step.undone for step in result.steps) == 2
    assert (result.status, result.confidence) == ("unsure", 0.0)


@pytest.mark.parametrize("kind", ["stale", "empty", "gone", "slip", "refused", "partly"])
def test_each_fault_is_survived(mesh, kind):
    for seed in range(2):
        station, goal, R_goal = cell(mesh, 60.0, seed)
        faulty = FaultyStation(station, np.random.default_rng(seed), planned=[kind])
        result = orient(faulty, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
        assert faulty.met == [kind]
        assert result.converged
        assert left_deg(station, R_goal) < 0.5
        assert bool(result.errors) == (kind not in ("slip", "partly"))


@pytest.mark.slow
def test_random_faults_never_hang_and_never_deceive(mesh):
    converged = 0
    for seed in range(12):
        station, goal, R_goal = cell(mesh, 90.0, seed)
        faulty = FaultyStation(station, np.random.default_rng(seed), 0.15, np.radians(2))
        result = orient(faulty, goal, Oracle(station, R_goal, np.radians(0.2)), Fusing(), limits=NOW)
        assert len(result.steps) <= Fusing().max_images
        assert not result.converged or left_deg(station, R_goal) < 5
        converged += result.converged
    assert converged >= 10


def test_slack_of_the_moves_is_corrected(mesh):
    station, goal, R_goal = cell(mesh, 90.0)
    loose = FaultyStation(station, np.random.default_rng(0), slack_rad=np.radians(2))
    result = orient(loose, goal, Oracle(station, R_goal, np.radians(0.2)), Fusing())
    assert result.converged
    assert left_deg(station, R_goal) < 0.6


def test_an_estimator_without_confidence_in_anything_never_converges(mesh):
    station, goal, R_goal = cell(mesh)
    result = orient(station, goal, Oracle(station, R_goal, confidence=0.0), arriving(0.6), limits=NOW)
    assert left_deg(station, R_goal) < 1
    assert (result.status, result.confidence < 0.5) == ("unsure", True)


@pytest.mark.parametrize(("left", "confident"), [(2.0, True), (7.0, False)])
def test_what_is_left_after_the_last_move_does_not_converge(mesh, left, confident):
    """The one move ends beside the goal, and the estimator sees that."""
    station, goal, R_goal = cell(mesh)

    class Beside(Wrapped):
        def rotate(self, R_step):
            self.station.rotate(so3.exp(np.array([np.radians(left), 0, 0])) @ R_step)
            return R_step

    result = orient(Beside(station), goal, Oracle(station, R_goal), Fusing(max_moves=1))
    assert left_deg(station, R_goal) == pytest.approx(left)
    assert result.status == "max_moves"
    assert (result.confidence > 0.9) == confident


def test_the_last_image_decides_too(mesh):
    station, goal, R_goal = cell(mesh)
    result = orient(station, goal, Oracle(station, R_goal, np.radians(3)), Fusing(max_images=3), limits=NOW)
    assert len(result.steps) <= 3
    assert result.status in ("unsure", "max_images")


def test_a_last_estimate_that_leads_away_ends_unsure(mesh):
    station, goal, R_goal = cell(mesh)

    class Doubting(Oracle):
        def estimate(self, *given, **more):
            found = super().estimate(*given, **more)
            if len(self.histories) < 4:
                return found
            return replace(found, R_goal_current=so3.exp(np.array([0, 0, np.radians(40)])), confidence=0.3)

    result = orient(station, goal, Doubting(station, R_goal), Fusing(max_images=4), limits=NOW)
    assert left_deg(station, R_goal) < 1
    assert result.status == "unsure"
    assert "the last estimate leads away" in result.reason
