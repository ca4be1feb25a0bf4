"""The strategy fusing: few moves, flips found out on arrival, memory, limits, and what faults do to it."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from reorient import Fusing, Limits, Proportional, StationError, load_estimator, orient, so3
from reorient.controller import belief as memory
from reorient.controller.arrival import half_turns, likeness, looseness_rad, misfit, repeats, upright_axes
from reorient.controller.base import Step
from reorient.controller.belief import Candidate, Stand, average, candidates, is_symmetry, stands
from reorient.controller.fusing import LEAST_LIKENESS
from reorient.controller.limits import nearest_reachable
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.registration import Evidence
from reorient.stations.faulty import FaultyStation
from reorient.stations.rendered import RenderedStation
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")
NOW = Limits(wait_s=0.0)
SEEN = Evidence(1, 0, 0, 0, 0.0)


class Oracle:
    """Knows the truth but for ``error_rad``; where ``flip`` is given, it takes that for the goal's orientation as often
    as it is nearer to it."""

    def __init__(self, station, R_goal, error_rad=0.0, flip=None, confidence=0.97, covariance_rad2=None):
        self.station, self.R_goal, self.error_rad, self.confidence = station, R_goal, error_rad, confidence
        self.flip, self.covariance_rad2 = flip, covariance_rad2
        self.rng = np.random.default_rng(0)
        self.histories = []

    def estimate(self, current, goal, pivot_m=None, history=()):
        self.histories.append(len(history))
        if np.count_nonzero(current.depth_m) < 20:
            raise ReorientError("current image has 1 returns")
        R = self.R_goal @ self.station.R_camera_object.T
        if self.flip is not None:
            other = self.flip @ R
            R = min((R, other), key=lambda x: float(so3.angle(x)))
        R = so3.exp(self.rng.normal(0, self.error_rad, 3)) @ R
        center = self.station.placement.center_m
        return RotationEstimate(R, center - R @ center, SEEN, self.confidence, covariance_rad2=self.covariance_rad2)


class Always:
    """Wants the same turn about the optical axis, whatever it sees."""

    def __init__(self, turn_rad, confidence=0.9):
        self.turn_rad, self.confidence = turn_rad, confidence

    def estimate(self, current, goal, pivot_m=None, history=()):
        R = so3.exp(np.array([0, 0, self.turn_rad]))
        return RotationEstimate(R, np.zeros(3), SEEN, confidence=self.confidence)


def cell(mesh, start_deg=100.0, seed=5, noise_m=0.0):
    """A station away from its goal: (station, goal image, goal orientation)."""
    rng = np.random.default_rng(seed)
    station = RenderedStation(mesh, WORLD, randomised(noise_m), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    turn = np.radians(start_deg)
    station.rotate(so3.matrix_from_quat(so3.sample_bounded(rng, 1, turn, turn))[0])
    return station, goal, R_goal


def left_deg(station, R_goal):
    return float(np.degrees(so3.angle_difference(R_goal, station.R_camera_object)))


def test_it_takes_the_whole_move_looks_twice_and_is_done(mesh):
    station, goal, R_goal = cell(mesh)
    result = orient(station, goal, Oracle(station, R_goal), Fusing())
    assert result.converged
    assert (result.moves, left_deg(station, R_goal) < 1e-4) == (1, True)
    assert len(result.steps) == 4  # one before the move, three that agree after it
    assert result.confidence > 0.9
    assert all(step.said for step in result.steps)


def test_averaging_beats_single_estimates(mesh):
    ends = []
    for seed in range(6):
        station, goal, R_goal = cell(mesh, 30, seed)
        result = orient(station, goal, Oracle(station, R_goal, np.radians(0.3)), Fusing())
        assert result.moves <= 5
        ends.append(left_deg(station, R_goal))
    assert np.mean(ends) < 0.75 * np.degrees(np.linalg.norm([np.radians(0.3)] * 3))


def test_a_false_arrival_is_found_out_and_left(mesh):
    """An estimator that cannot tell a half turn; the images can."""
    station, goal, R_goal = cell(mesh, 170.0)
    axis = upright_axes(goal)[0]
    result = orient(station, goal, Oracle(station, R_goal, flip=so3.exp(np.pi * axis)), Fusing(), limits=NOW)
    assert result.converged
    assert left_deg(station, R_goal) < 3
    assert any("half turn" in step.said for step in result.steps)
    assert result.moves <= 8


def test_what_never_matches_is_announced(mesh):
    station, goal, R_goal = cell(mesh)
    wrong = Oracle(station, so3.exp(np.array([1.0, 0.8, 0.3])) @ R_goal)  # sure of another orientation, always
    result = orient(station, goal, wrong, Fusing(), limits=NOW)
    assert not result.converged
    assert result.confidence < 0.5
    assert result.moves <= Fusing().most_moves


def test_likeness_tells_the_pose_from_another(mesh):
    station, goal, R_goal = cell(mesh, noise_m=0.001)
    for R, right in ((R_goal, True), (so3.exp(np.array([np.pi, 0, 0])) @ R_goal, False)):
        station.R_camera_object = R
        captures = [station.capture(), station.capture()]
        still = RotationEstimate(np.eye(3), np.zeros(3), SEEN)
        assert (likeness(captures, goal, [still, still]) > 0) == right


BOX = trimesh.creation.box((1, 0.7, 0.5))


def test_half_turns_are_judged_by_what_the_captures_show(mesh):
    """Of a box one or more lose next to nothing; of another body all do."""
    for body, alike in ((BOX, True), (mesh, False)):
        station, goal, R_goal = cell(body, seed=3, noise_m=0.001)
        before, R_before = station.capture(), station.R_camera_object
        station.R_camera_object = R_goal
        turns = half_turns(station.capture(), goal, [(before, R_goal @ R_before.T)])
        assert len(turns) == 3
        assert (min(loss for _, loss in turns) < 0.1) == alike


def lying_box(knob=0.0):
    """A box as its goal shows it, with two different knobs on the side that faces away, and the half turn that changes
    nothing in that view: (mesh, turn)."""
    R_goal = cell(BOX, 170.0, seed=3)[2]
    facing = int(np.argmax(np.abs(R_goal[2])))
    flip = so3.exp(np.pi * R_goal[:, facing])
    if not knob:
        return BOX, flip
    parts, across = [BOX], [axis for axis in range(3) if axis != facing]
    for side, scale in ((1, (1.0, 1.0)), (-1, (2.5, 0.4))):
        size, place = np.full(3, knob), np.zeros(3)
        size[across] *= scale
        place[across] = side * 0.25 * BOX.extents[across]
        place[facing] = np.sign(R_goal[2, facing]) * (BOX.extents[facing] + knob) / 2
        parts.append(trimesh.creation.box(size, trimesh.transformations.translation_matrix(place)))
    return trimesh.util.concatenate(parts), flip


@pytest.mark.parametrize(("knob", "symmetric"), [(0.0, True), (0.15, False)])
def test_of_orientations_that_match_equally_other_views_tell_whether_they_are_one(knob, symmetric):
    """A symmetric object has arrived; one that only looks so from the goal's side may not have, which is announced."""
    mesh, flip = lying_box(knob)
    station, goal, R_goal = cell(mesh, 170.0, seed=3, noise_m=0.001)
    result = orient(station, goal, Oracle(station, R_goal, flip=flip), Fusing(), limits=NOW)
    assert min(left_deg(station, R_goal), left_deg(station, flip @ R_goal)) < 3
    assert "another orientation matches as well" in result.reason
    assert ("looks symmetric" in result.reason) == symmetric
    assert result.converged == symmetric
    assert (result.confidence > 0.5) == symmetric
    assert result.moves <= 10


def test_a_symmetric_object_that_the_images_hardly_match_is_not_claimed_and_told_why(monkeypatch):
    monkeypatch.setattr(memory, "_likeness", lambda *_: LEAST_LIKENESS - 0.1)
    mesh, flip = lying_box()
    station, goal, R_goal = cell(mesh, 170.0, seed=3, noise_m=0.001)
    result = orient(station, goal, Oracle(station, R_goal, flip=flip), Fusing(), limits=NOW)
    assert "the object looks symmetric" in result.reason
    assert "nothing that was tried surely matches" in result.reason
    assert not result.converged


def test_small_differences_add_up_to_tell_two_poses_apart():
    """A plate of 3 mm on a box, under noise of 1 mm: the share of points that fit hardly tells, the misfit does."""
    plates = [
        trimesh.creation.box((0.4, 0.7, 0.018), trimesh.transformations.translation_matrix((0.3, 0, z)))
        for z in (-0.259, 0.259)
    ]
    mesh = trimesh.util.concatenate([BOX, *plates])
    station, goal, R_goal = cell(mesh, seed=3, noise_m=0.001)
    still = [RotationEstimate(np.eye(3), np.zeros(3), SEEN)] * 3
    off = []
    for about in ([0, 0, 0], R_goal[:, 2]):
        station.R_camera_object = so3.exp(np.pi * np.array(about)) @ R_goal
        off.append(misfit([station.capture() for _ in still], goal, still))
    assert 3 * (off[1] - off[0]) > 2


def test_misfit_is_least_under_the_true_motion(mesh):
    station, goal, R_goal = cell(mesh, seed=3, noise_m=0.001)
    left, center = so3.exp(np.array([0.02, -0.05, 0.04])), station.placement.center_m
    station.R_camera_object = left.T @ R_goal
    captures = [station.capture(), station.capture()]
    true, inverse, none = (
        misfit(captures, goal, [RotationEstimate(R, center - R @ center, SEEN)] * 2) for R in (left, left.T, np.eye(3))
    )
    assert true < none < inverse


def test_of_two_poses_that_match_the_one_with_less_misfit_is_the_likelier(mesh):
    image = cell(mesh)[0].capture()
    flip = so3.exp(np.array([np.pi, 0, 0]))
    still = RotationEstimate(np.eye(3), np.zeros(3), SEEN, 0.9)
    for misfits, nearer in (((3.0, 5.0), flip), ((5.0, 3.0), np.eye(3))):
        seen = [
            Stand((image, image), (still, still), R_now_then, likeness, off)
            for R_now_then, likeness, off in zip((flip, np.eye(3)), (2.0, 3.0), misfits, strict=True)
        ]
        best, other = candidates(seen)
        assert float(so3.angle_difference(best.R_goal_now, nearer)) < 1e-6
        assert best.log_weight == pytest.approx(np.log(9) + 3)  # the most that either arrival had
        assert best.log_weight - other.log_weight == pytest.approx(2 * 2)  # captures of each times the difference


def test_a_view_repeats_where_the_object_is_symmetric():
    for knob, symmetric in ((0.0, True), (0.15, False)):
        mesh, flip = lying_box(knob)
        station, _, R_goal = cell(mesh, seed=3, noise_m=0.001)
        away = so3.exp(np.array([2.5, 0.5, 0]))
        captures = [station.capture(), station.capture()]
        views = []
        for R in (away @ R_goal, away @ flip @ R_goal):
            station.R_camera_object = R
            views.append(station.capture())
        assert repeats(*views, captures) == symmetric


@pytest.mark.parametrize(
    ("body", "symmetric"), [(trimesh.creation.cylinder(radius=0.5, height=0.8, sections=3), True), (BOX, False)]
)
def test_a_third_of_a_turn_is_a_symmetry_of_a_prism_and_not_of_a_box(body, symmetric):
    """No half turn: the order and the direction of the turns count."""
    station, _, R_goal = cell(body, seed=3, noise_m=0.001)
    third = so3.exp(2 * np.pi / 3 * R_goal[:, 2])
    station.R_camera_object = R_goal
    still = RotationEstimate(np.eye(3), np.zeros(3), SEEN)
    seen = [Stand((station.capture(), station.capture()), (still, still), np.eye(3), 1.0)]
    for _ in range(2):
        said, R_elsewhere = is_symmetry(Candidate(np.eye(3)), Candidate(third), seen)
        assert said is None
        station.R_camera_object = R_elsewhere @ R_goal
        seen.insert(0, Stand((station.capture(),), (still,), R_elsewhere.T, None))
    assert is_symmetry(Candidate(np.eye(3)), Candidate(third), seen)[0] == symmetric


THIN = trimesh.creation.box((0.08, 0.08, 1.0))
ROUND = trimesh.creation.cylinder(radius=0.15, height=1.0, sections=64)


@pytest.mark.parametrize(("body", "loose"), [(THIN, True), (ROUND, False), (BOX, False)])
def test_turns_of_a_thin_rod_hardly_show_and_those_of_a_round_one_do_not_matter(body, loose):
    station, goal, R_goal = cell(body, seed=3, noise_m=0.001)
    station.R_camera_object = R_goal
    captures = [station.capture(), station.capture()]
    estimates = [load_estimator("default").estimate(image, goal) for image in captures]
    error_deg = np.degrees([np.sqrt(np.linalg.eigvalsh(x.covariance_rad2)[-1]) for x in estimates])
    assert (error_deg.min() > 1) == (body is not BOX)  # the curvature does not tell rod from cylinder
    looseness_deg = np.degrees(looseness_rad(captures, goal, estimates))
    assert (error_deg.min() <= looseness_deg <= error_deg.max()) if loose else looseness_deg == 0
    assert looseness_rad(captures, goal, [replace(x, covariance_rad2=None) for x in estimates]) == 0


def test_no_claim_where_the_shape_hardly_tells_small_turns(mesh):
    """The same loop, with an estimator that says how well the shape tells them."""
    ends = []
    for error_rad in (0.005, 0.03):
        station, goal, R_goal = cell(mesh, 20.0)
        oracle = Oracle(station, R_goal, covariance_rad2=np.diag([error_rad, 0.001, 0.001]) ** 2)
        result = orient(station, goal, oracle, Fusing(), limits=NOW)
        assert left_deg(station, R_goal) < 0.1
        ends.append((result.converged, "only to 1.7 degrees" in result.reason))
    assert ends == [(True, False), (False, True)]


@pytest.mark.parametrize(("alike", "claims"), [(LEAST_LIKENESS - 0.1, False), (LEAST_LIKENESS + 0.1, True)])
def test_no_claim_where_only_the_estimator_is_sure(mesh, monkeypatch, alike, claims):
    """It says 99%; the images hardly ever match."""
    monkeypatch.setattr(memory, "_likeness", lambda *_: alike)
    station, goal, R_goal = cell(mesh, 20.0)
    result = orient(station, goal, Oracle(station, R_goal, confidence=0.99), Fusing(), limits=NOW)
    assert result.converged == claims
    assert ("nothing that was tried surely matches" in result.reason) != claims
    assert (result.confidence > 0.9) == claims


def test_upright_axes_of_a_box_are_its_own():
    station = RenderedStation(BOX, WORLD, randomised(), np.random.default_rng(2))
    axes = upright_axes(station.capture_goal())
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-6)
    assert np.abs(axes @ station.R_camera_object).max(axis=1).min() > np.cos(np.radians(3))


def test_of_equivalent_orientations_the_nearest_is_taken(mesh):
    station, goal, R_goal = cell(mesh, 20.0)
    R = R_goal @ station.R_camera_object.T
    far = so3.exp(np.array([0, 0, 2.0])) @ R
    step = Step(0, goal, RotationEstimate(far, np.zeros(3), SEEN, 0.5, ((R, 0.45),)), None, None)
    np.testing.assert_allclose(Fusing().decide([step], goal, lambda _: True).R_step, R)
    unreachable = Fusing().decide([step], goal, lambda x: float(so3.angle(x)) > 1)
    np.testing.assert_allclose(unreachable.R_step, far)


def test_claims_are_carried_along_and_add_up(mesh):
    """Two views that each leave two orientations open settle it together; an unknown move ends the chain."""
    station, goal, R_goal = cell(mesh, 100.0)
    R = R_goal @ station.R_camera_object.T
    step_of = so3.exp(np.array([0.7, 0, 0.2]))
    other, third = so3.exp(np.array([0, 2.0, 0])) @ R, so3.exp(np.array([0, 0, 2.5])) @ R @ step_of.T
    first = Step(0, goal, RotationEstimate(other, np.zeros(3), SEEN, 0.5, ((R, 0.4),)), step_of, step_of)
    second = Step(1, goal, RotationEstimate(third, np.zeros(3), SEEN, 0.5, ((R @ step_of.T, 0.4),)), None, None)
    best = candidates(stands([first, second], goal))[0]
    np.testing.assert_allclose(best.R_goal_now, R @ step_of.T, atol=1e-9)
    lost = Step(0, goal, first.estimate, step_of, None, fault="refused")
    decision = Fusing().decide([lost, second], goal, lambda _: True)
    assert "100%" not in decision.said


def test_the_average_is_robust_and_carried_by_moves(mesh):
    goal = cell(mesh, 1.0)[1]
    rng = np.random.default_rng(1)
    R = so3.exp(np.array([0.01, 0.0, 0.0]))
    steps = []
    for k in range(6):
        error = rng.normal(0, 0.003, 3) if k != 3 else np.array([0.1, 0, 0])
        move = so3.exp(np.array([0.004, 0.002, 0.0])) if k == 2 else None
        estimate = RotationEstimate(so3.exp(error) @ R, np.zeros(3), SEEN, 0.9)
        steps.append(Step(k, goal, estimate, move, move))
        R = R if move is None else R @ move.T
    middle, error_rad = average(steps, R)
    assert float(so3.angle_difference(middle, R)) < 0.004
    assert 0 < error_rad < 0.01


def test_the_default_strategy_suits_the_estimator(mesh):
    station, goal, R_goal = cell(mesh)
    assert orient(station, goal, Oracle(station, R_goal)).moves == 1
    station, goal, R_goal = cell(mesh)
    assert orient(station, goal, Oracle(station, R_goal, confidence=None)).moves > 15
    for confidence in (0.9, None):
        oracle = Oracle(station, so3.exp(np.array([2.0, 0, 0])) @ R_goal, np.radians(2), confidence=confidence)
        assert len(orient(station, goal, oracle, max_steps=3, limits=NOW).steps) <= 3
    with pytest.raises(ReorientError, match="max_steps 1: expected at least 2, and no strategy"):
        orient(station, goal, oracle, max_steps=1)


def test_history_is_given_when_asked_for(mesh):
    for recalls, most in ((True, 3), (False, 0)):
        station, goal, R_goal = cell(mesh)
        oracle = Oracle(station, R_goal)
        orient(station, goal, oracle, Fusing(memory=recalls))
        assert max(oracle.histories) == most


def test_default_from_far_in_few_moves(mesh):
    station, goal, R_goal = cell(mesh, 150.0, noise_m=0.001)
    result = orient(station, goal, load_estimator("fast"))
    assert result.converged
    assert left_deg(station, R_goal) < 1
    assert result.moves <= 6


@pytest.mark.parametrize("kind", ["stale", "empty", "gone", "slip", "refused", "partly"])
def test_each_fault_is_survived(mesh, kind):
    for seed in range(2):
        station, goal, R_goal = cell(mesh, 60.0, seed)
        faulty = FaultyStation(station, np.random.default_rng(seed), planned=[kind])
        result = orient(faulty, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
        assert faulty.met == [kind]
        assert result.converged
        assert left_deg(station, R_goal) < 0.5
        assert bool(result.faults) == (kind not in ("slip", "partly"))


@pytest.mark.parametrize("kind", ["gone", "refused"])
def test_what_keeps_failing_ends_the_loop_with_the_record_kept(mesh, kind):
    station, goal, R_goal = cell(mesh, 60.0)
    faulty = FaultyStation(station, np.random.default_rng(0), planned=[kind] * 20)
    result = orient(faulty, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert not result.converged
    assert result.reason == result.faults[-1]
    assert result.steps
    again = kind == "gone"  # seen from where it was before the move, too
    assert len(result.faults) == (Fusing().patience + 1) * (1 + again) + again
    assert left_deg(station, R_goal) == pytest.approx(60)


class Hiding:
    """A station on which the object cannot be seen near one orientation."""

    def __init__(self, station, R_hidden, turns_back=True):
        self.station, self.R_hidden, self.turns_back = station, R_hidden, turns_back
        self.pivot_m = station.pivot_m

    def hides(self):
        return float(so3.angle_difference(self.station.R_camera_object, self.R_hidden)) < np.radians(20)

    def capture(self):
        if self.hides():
            raise StationError("no object in view")
        return self.station.capture()

    def rotate(self, R_step):
        if self.hides() and not self.turns_back:
            raise StationError("refused to move")
        return self.station.rotate(R_step)


class Torn(Oracle):
    """Thinks another orientation, half a turn from the goal's, a little likelier than the goal's."""

    def estimate(self, current, goal, pivot_m=None, history=()):
        estimate = super().estimate(current, goal, pivot_m, history)
        R = estimate.R_goal_current
        flipped = so3.exp(np.array([np.pi, 0, 0])) @ R
        return replace(estimate, R_goal_current=flipped, confidence=0.55, alternatives=((R, 0.4),))


def test_a_move_that_hides_the_object_is_taken_back_and_the_next_candidate_tried(mesh):
    station, goal, R_goal = cell(mesh, 80.0)
    hiding = Hiding(station, so3.exp(np.array([np.pi, 0, 0])) @ R_goal)
    result = orient(hiding, goal, Torn(station, R_goal), Fusing(), limits=NOW)
    assert left_deg(station, R_goal) < 1e-3
    undone = [step for step in result.steps if step.undone]
    assert len(undone) == 1  # never tried again
    assert float(so3.angle(undone[0].R_executed)) < 1e-6
    assert result.moves == sum(step.R_step is not None for step in result.steps) + 1
    assert any("it was taken back" in fault for fault in result.faults)


def test_a_camera_that_was_silent_after_a_move_does_not_rule_out_the_goal(mesh):
    station, goal, R_goal = cell(mesh, 80.0)
    silent = FaultyStation(station, np.random.default_rng(0), planned=["gone"] * 2)  # four failures in a row
    result = orient(silent, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert sum(step.undone for step in result.steps) == 1
    assert result.converged
    assert left_deg(station, R_goal) < 1e-3


def test_what_stays_hidden_is_given_up_after_two_tries(mesh):
    station, goal, R_goal = cell(mesh, 80.0)
    result = orient(Hiding(station, R_goal), goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert sum(step.undone for step in result.steps) == 2
    assert "nothing is left to try" in result.reason
    assert not result.converged


class OneSided(Hiding):
    """A station that shows one side of the object only."""

    def hides(self):
        return float((self.station.R_camera_object @ self.R_hidden.T)[2, 2]) < -0.2


def test_where_other_sides_cannot_be_seen_equal_orientations_are_announced():
    mesh, flip = lying_box()
    station, goal, R_goal = cell(mesh, seed=3, noise_m=0.001)
    station.R_camera_object = so3.exp(np.array([0.5, 0.2, 0.3])) @ flip @ R_goal
    result = orient(OneSided(station, R_goal), goal, Oracle(station, R_goal, flip=flip), Fusing(), limits=NOW)
    assert sum(step.undone for step in result.steps) == 1
    assert not result.converged
    assert "no two other sides were seen" in result.reason


@pytest.mark.parametrize(
    ("strategy", "limits", "turns_back"),
    [
        (Fusing(), NOW, False),
        (Fusing(), Limits(largest_total_rad=np.radians(300), wait_s=0.0), True),
        (Proportional(eta=1.0, patience=3), NOW, True),
    ],
)
def test_a_move_that_cannot_be_taken_back_ends_the_loop(mesh, strategy, limits, turns_back):
    station, goal, R_goal = cell(mesh, 80.0)
    hiding = Hiding(station, so3.exp(np.array([np.pi, 0, 0])) @ R_goal, turns_back)
    result = orient(hiding, goal, Torn(station, R_goal), strategy, limits=limits)
    assert hiding.hides()
    assert not result.converged
    assert "no object in view" in result.reason


def test_an_estimator_that_fails_is_asked_again_with_another_image(mesh):
    station, goal, R_goal = cell(mesh)

    class Moody(Oracle):
        calls = 0

        def estimate(self, *arguments):
            self.calls += 1
            if self.calls % 2:
                raise ZeroDivisionError("singular")
            return super().estimate(*arguments)

    result = orient(station, goal, Moody(station, R_goal), limits=NOW)
    assert result.converged
    assert "the estimator failed: ZeroDivisionError: singular" in result.faults[0]


def test_faults_at_random_never_hang_nor_deceive(mesh):
    for seed in range(12):
        station, goal, R_goal = cell(mesh, 90.0, seed)
        faulty = FaultyStation(station, np.random.default_rng(seed), 0.15, np.radians(2))
        result = orient(faulty, goal, Oracle(station, R_goal, np.radians(0.2)), Fusing(), limits=NOW)
        assert len(result.steps) <= Fusing().max_steps
        assert not result.converged or left_deg(station, R_goal) < 5


def test_slack_in_the_turns_is_made_good(mesh):
    station, goal, R_goal = cell(mesh, 90.0)
    loose = FaultyStation(station, np.random.default_rng(0), slack_rad=np.radians(2))
    result = orient(loose, goal, Oracle(station, R_goal, np.radians(0.2)), Fusing())
    assert result.converged
    assert left_deg(station, R_goal) < 0.6


def test_a_frame_from_before_the_move_is_refused(mesh):
    station, goal, R_goal = cell(mesh)
    captured = [station.capture(), station.capture()]  # both before any move

    class Buffered:
        pivot_m = station.pivot_m
        rotate = staticmethod(station.rotate)
        clock_s = staticmethod(station.clock_s)

        @staticmethod
        def capture():
            return captured.pop(0)

    result = orient(Buffered(), goal, Oracle(station, R_goal), Proportional())
    assert result.moves == 1
    assert "stale frame" in result.reason


def test_limits(mesh):
    def run(**limits):
        station, goal, R_goal = cell(mesh, 100.0)
        parts = []

        class Counting:
            pivot_m = station.pivot_m
            capture = staticmethod(station.capture)

            @staticmethod
            def rotate(R_step):
                parts.append(float(np.degrees(so3.angle(R_step))))
                return station.rotate(R_step)

        return orient(Counting(), goal, Oracle(station, R_goal), Fusing(), limits=Limits(**limits)), parts

    result, parts = run(largest_step_rad=np.radians(30))
    assert result.converged
    np.testing.assert_allclose(parts, [25] * 4, atol=1e-6)
    result, parts = run(largest_total_rad=np.radians(90))
    assert (parts, result.converged) == ([], False)
    assert "would exceed the largest total rotation" in result.reason
    result, parts = run(dry_run=True)
    assert (parts, result.moves) == ([], 0)
    assert "dry run: would turn by 100.0 degrees" in result.reason
    asked = []
    result, parts = run(confirm=lambda R: bool(asked.append(R)))
    assert (parts, len(asked)) == ([], 1)
    assert "was not confirmed" in result.reason
    result, parts = run(confirm=lambda R: asked.append(R) is None)
    assert result.converged
    assert len(asked) == 2  # the first move only
    with pytest.raises(ReorientError, match="expected angles above 0"):
        Limits(largest_step_rad=0)
    with pytest.raises(ReorientError, match="expected at least 2 images"):
        Fusing(max_steps=1)


def test_a_goal_out_of_reach_is_reported_with_the_nearest_reachable(mesh):
    station, goal, R_goal = cell(mesh, 100.0)
    turned = [np.eye(3)]

    class Narrow:
        """Turns by at most 60 degrees from where it began."""

        pivot_m = station.pivot_m
        capture = staticmethod(station.capture)

        @staticmethod
        def reachable(R_step):
            return bool(so3.angle(R_step @ turned[0]) < np.radians(60))

        def rotate(self, R_step):
            if not self.reachable(R_step):
                raise StationError("out of reach")
            turned[0] = R_step @ turned[0]
            return station.rotate(R_step)

    result = orient(Narrow(), goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert not result.converged
    assert "the nearest reachable orientation leaves" in result.reason
    assert left_deg(station, R_goal) < 47  # 40 at best


def test_nearest_reachable():
    R_step = so3.exp(np.array([0, 0, 1.5]))
    near = nearest_reachable(R_step, lambda R: float(so3.angle(R)) < 1.0)
    assert float(so3.angle_difference(near, R_step)) < 0.6
    assert nearest_reachable(R_step, lambda R: False) is None


@pytest.mark.parametrize("clock", [True, False])
def test_frames_are_stale_by_the_last_move_alone(mesh, clock):
    """Two looks at one pose may share a stamp, and a frame may be stamped with the move's end."""
    station, goal, R_goal = cell(mesh)

    class Coarse:
        pivot_m = station.pivot_m
        moves = 0

        def capture(self):
            return replace(station.capture(), stamp_s=float(self.moves))

        def rotate(self, R_step):
            self.moves += 1
            return station.rotate(R_step)

    coarse = Coarse()
    if clock:
        coarse.clock_s = lambda: np.float32(coarse.moves)
    result = orient(coarse, goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert result.converged
    assert not result.faults


@pytest.mark.parametrize("clock", [True, False])
def test_frames_from_before_a_move_that_failed_are_stale_and_it_counts(mesh, clock):
    station, goal, _ = cell(mesh, 60.0)

    class Late:
        """Turns, and then says that it failed; its driver hands out an old frame first."""

        pivot_m = station.pivot_m
        old = None
        turned_deg = 0.0

        def capture(self):
            image, self.old = self.old or station.capture(), None
            return image

        def rotate(self, R_step):
            self.old = station.capture()
            station.rotate(R_step)
            self.turned_deg += float(np.degrees(so3.angle(R_step)))
            raise TimeoutError("no answer")

    late = Late()
    if clock:
        late.clock_s = station.clock_s
    limits = Limits(largest_total_rad=np.radians(100), wait_s=0.0)
    result = orient(late, goal, Always(np.radians(40)), Fusing(patience=9), limits=limits)
    assert late.turned_deg == pytest.approx(80)
    assert "would exceed the largest total" in result.reason
    assert any("stale frame" in fault for fault in result.faults) == clock


def test_the_way_round_keeps_to_the_limits(mesh):
    """A station that cannot make small moves makes larger ones than were asked for."""
    asked, turned = [], []

    def run(**limits):
        station, goal, _ = cell(mesh, 40.0)

        class Clumsy:
            pivot_m = station.pivot_m
            capture = staticmethod(station.capture)

            @staticmethod
            def reachable(R_step):
                return bool(so3.angle(R_step) > np.radians(50))

            @staticmethod
            def rotate(R_step):
                turned.append(R_step)
                return station.rotate(R_step)

        strategy = Proportional(eta=1.0, max_steps=1)
        return orient(Clumsy(), goal, Always(np.radians(40)), strategy, limits=Limits(wait_s=0.0, **limits))

    result = run(largest_total_rad=np.radians(45))
    assert turned == []
    assert "would exceed the largest total rotation" in result.reason
    run(confirm=lambda R: asked.append(R) is None)
    np.testing.assert_allclose(asked, turned, atol=1e-12)
    assert np.degrees(so3.angle(turned[0])) > 50
    assert f"would turn by {np.degrees(so3.angle(turned[0])):.1f} degrees" in run(dry_run=True).reason


def test_a_dry_run_ends_with_the_first_decision(mesh):
    station, goal, R_goal = cell(mesh, 0.5)
    result = orient(station, goal, Oracle(station, R_goal), Fusing(), limits=Limits(dry_run=True))
    assert len(result.steps) == 1
    assert result.reason == "dry run: this may be the goal, but for 0.50 degrees: looks again; nothing moved"


def test_a_strategy_that_fails_ends_the_loop_with_the_record_kept(mesh, unchecked):
    class Failing(Fusing):
        def decide(self, steps, goal, reachable):
            if len(steps) == 2:
                raise IndexError("pop from empty list")
            return super().decide(steps, goal, reachable)

    station, goal, R_goal = cell(mesh)
    result = orient(station, goal, Oracle(station, R_goal), Failing())
    assert (len(result.steps), result.moves, result.converged) == (2, 1, False)
    assert result.reason == "the strategy failed: IndexError: pop from empty list"
    for wrong in ("fusing", Fusing, object()):
        with pytest.raises(
            ReorientError, match="expected an object with max_steps, patience, takes_back, recalled, decide"
        ):
            orient(station, goal, Oracle(station, R_goal), wrong)


def test_no_confidence_at_all_is_survived(mesh):
    station, goal, R_goal = cell(mesh)
    result = orient(station, goal, Oracle(station, R_goal, confidence=0.0), Fusing())
    assert left_deg(station, R_goal) < 1
    assert not result.converged or result.confidence < 0.95


@pytest.mark.parametrize(("left", "sure"), [(2.0, True), (7.0, False)])
def test_what_is_left_when_the_moves_are_out_is_not_called_done(mesh, left, sure):
    """The one move lands beside the goal, and the estimator sees that."""
    station, goal, R_goal = cell(mesh)

    class Beside:
        pivot_m = station.pivot_m
        capture = staticmethod(station.capture)

        @staticmethod
        def rotate(R_step):
            station.rotate(so3.exp(np.array([np.radians(left), 0, 0])) @ R_step)
            return R_step

    result = orient(Beside(), goal, Oracle(station, R_goal), Fusing(most_moves=1))
    assert left_deg(station, R_goal) == pytest.approx(left)
    assert not result.converged
    assert f"{left:.2f} degrees are left" in result.reason
    assert "no more moves are allowed" in result.reason
    assert (result.confidence > 0.9) == sure
