"""Stations that report another rotation than they make end after two moves; slips, slack and symmetry do not."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracles import NOW, WORLD, Always, Oracle, Wrapped, answer
from oracles import cell as away_cell

from reorient import Algorithm1, Fusing, orient, so3
from reorient.controller.base import Step
from reorient.controller.motion import MotionRecord, MotionTest
from reorient.imaging import DepthImage
from reorient.stations.faulty import FaultyStation
from reorient.stations.rendered import RenderedStation
from reorient.world.sensing import Sensor, randomised

QUARTER = np.pi / 2
ONCE = Algorithm1(eta=1.0)
AXES = {
    "axes x": so3.exp(np.array([QUARTER, 0, 0])),
    "axes y": so3.exp(np.array([0, QUARTER, 0])),
    "axes z": so3.exp(np.array([0, 0, QUARTER])),
    "axes upside down": so3.exp(np.array([np.pi, 0, 0])),
}
STILL = ("frozen camera", "frozen robot", "background", "radians as degrees")
MOVED = (*AXES, "inverse", "degrees as radians", "half the angle", "object axes")


class Lying(Wrapped):
    """Reports every move as it was commanded, and makes another one."""

    def __init__(self, station, kind):
        super().__init__(station)
        self.kind, self.first = kind, None

    def capture(self):
        image = replace(self.station.capture(), stamp_s=None)
        if self.kind == "frozen camera":
            self.first = image = self.first or image
        if self.kind == "background":  # two posts that stay
            posts = np.zeros_like(image.depth_m)
            posts[5:123, 3:35], posts[80:123, 100:125] = 0.55, 0.65
            image = DepthImage(np.where(image.valid, image.depth_m, posts), image.camera)
        return image

    def rotate(self, R_step):
        self.station.rotate(self.made(R_step))
        return R_step

    def made(self, R):
        if self.kind in AXES:
            return AXES[self.kind] @ R @ AXES[self.kind].T
        share = {
            "frozen robot": 0.0,
            "inverse": -1.0,
            "half the angle": 0.5,
            "degrees as radians": np.degrees(1),
            "radians as degrees": np.radians(1),
        }
        if self.kind == "object axes":
            return so3.exp(self.station.R_camera_object @ so3.log(R))
        return so3.exp(share.get(self.kind, 1.0) * so3.log(R))


@pytest.mark.parametrize("start_deg", [40.0, 100.0])
@pytest.mark.parametrize("kind", [*STILL, *MOVED])
def test_a_wrong_report_ends_the_loop_after_two_moves(mesh, kind, start_deg):
    station, goal, R_goal = away_cell(mesh, start_deg, noise_m=0.001)
    estimator = Always(np.radians(start_deg)) if kind in STILL else Oracle(station, R_goal)
    result = orient(Lying(station, kind), goal, estimator, ONCE, limits=NOW)
    assert (result.status, result.moves) == ("inconsistent_motion", 2)
    assert result.reason == result.steps[-1].message
    assert "reported" in result.reason
    assert ("the images show no rotation: is the background in the image" in result.reason) == (kind in STILL)
    assert ("is R_step converted to the robot's axes" in result.reason) == (kind in MOVED)


def test_both_rotations_are_in_the_message(mesh):
    station, goal, _ = away_cell(mesh, 100.0)
    result = orient(Lying(station, "axes x"), goal, Always(np.radians(40)), ONCE, limits=NOW)
    assert "reported 40.0 deg about [0.00 0.00 1.00] (camera axes), the images show " in result.reason
    assert " deg about [0.0" in result.reason.split("show ")[1] or " deg about [-0.0" in result.reason.split("show ")[1]


def test_small_wrong_moves_add_up(mesh):
    station, goal, _ = away_cell(mesh, 60.0)
    strategy = Algorithm1(eta=1.0, delta_rad=0.01, max_images=30)
    result = orient(Lying(station, "frozen robot"), goal, Always(np.radians(2)), strategy, limits=NOW)
    assert result.status == "inconsistent_motion"
    assert result.moves <= 8


@pytest.mark.parametrize(("start_deg", "noise_m", "slack_deg"), [(150, 0.0, 0.0), (70, 0.003, 0.0), (100, 0.001, 8.0)])
def test_true_reports_and_slack_end_no_loop(mesh, start_deg, noise_m, slack_deg):
    station, goal, R_goal = away_cell(mesh, start_deg, noise_m=noise_m)
    loose = FaultyStation(station, np.random.default_rng(0), slack_rad=np.radians(slack_deg))
    result = orient(loose, goal, Oracle(station, R_goal), ONCE, limits=NOW)
    assert result.status == "converged"


def test_slips_end_no_loop(mesh):
    for seed in range(2):
        station, goal, R_goal = away_cell(mesh, 90.0, seed=seed, noise_m=0.001)
        faulty = FaultyStation(station, np.random.default_rng(seed), planned=["slip", "slip"])
        result = orient(faulty, goal, Oracle(station, R_goal), ONCE, limits=NOW)
        assert faulty.met == ["slip", "slip"]
        assert result.status == "converged"


def seen(shape, R_camera_object, seed=0):
    """One image of a body."""
    rng = np.random.default_rng(seed)
    return RenderedStation(shape, WORLD, randomised(0.001), rng, R_camera_object).capture()


def test_a_symmetric_object_contradicts_nothing():
    """Rotated about its axis a cylinder looks as if it had not moved."""
    cylinder, z = trimesh.creation.cylinder(0.3, 1.0), np.array([0, 0, 1.0])
    for seed in range(2):
        R = so3.sample_uniform(np.random.default_rng(seed), 1)[0]
        image, other = seen(cylinder, R, seed), seen(cylinder, R, seed + 10)
        for angle_rad in (0.5, 1.0, 3.0):
            measured = MotionTest()(image, other, so3.exp(angle_rad * R @ z))
            assert measured.verdict in ("confirmed", "undecided")
    across = so3.exp(R @ np.array([1.0, 0, 0]))
    assert MotionTest()(image, other, across).verdict in ("contradicted", "beyond slip")


@pytest.mark.parametrize(("angle_deg", "verdict"), [(0, "confirmed"), (25, "slip"), (70, "beyond slip")])
def test_a_slip_is_told_from_what_no_slip_explains(mesh, angle_deg, verdict):
    reported = so3.exp(np.array([0, 0, np.radians(50)]))
    made = so3.exp(np.array([np.radians(angle_deg), 0, 0])) @ reported
    measured = MotionTest()(seen(mesh, np.eye(3)), seen(mesh, made), reported)
    assert measured.verdict == verdict
    if angle_deg < 45:
        assert float(np.degrees(so3.angle_difference(measured.R_measured, made))) < 4


def test_too_few_returns_show_nothing(mesh):
    image = seen(mesh, np.eye(3))
    few = DepthImage(
        np.where(np.cumsum(image.valid).reshape(image.depth_m.shape) <= 20, image.depth_m, 0), image.camera
    )
    assert MotionTest()(image, few, so3.exp(np.array([1.0, 0, 0]))).verdict == "undecided"


def test_an_unknown_motion_begins_anew(mesh):
    station, goal, R_goal = away_cell(mesh)
    estimate = Oracle(station, R_goal).estimate(goal, goal)
    R, image, other = so3.exp(np.array([1.0, 0, 0])), seen(mesh, np.eye(3)), seen(mesh, R_goal)

    def after(image):
        return Step(2, image, estimate)

    unknown = Step(0, image, estimate, R_step=R, error="no answer")
    assert unknown.motion_unknown
    record = MotionRecord.start(image).updated(unknown, after(other))
    assert record.before is other
    assert not record.unconfirmed
    still = Step(1, other, estimate, R_step=R, R_executed=R)
    once = record.updated(still, after(other))
    assert [x.verdict for x in once.unconfirmed] == ["beyond slip"]
    assert not once.contradiction
    assert once.updated(still, after(other)).contradiction
    moved = once.updated(still, after(seen(mesh, R @ R_goal)))
    assert not moved.unconfirmed  # confirmed: forgotten


def test_the_strategy_of_few_moves_is_checked_too(mesh):
    station, goal, R_goal = away_cell(mesh, 100.0, noise_m=0.001)
    result = orient(Lying(station, "inverse"), goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert (result.status, result.moves) == ("inconsistent_motion", 2)


def test_an_object_that_is_mostly_hidden_contradicts_no_right_report(mesh):
    """An arm occludes most of it: the visible rest matches many rotations."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        station = RenderedStation(mesh, WORLD, Sensor(), rng)
        before = station.capture_goal()
        R = so3.exp(so3.sample_axes(rng, 1)[0] * rng.uniform(1.0, 2.0))
        station.rotate(R)
        after = station.capture_goal()
        seen = np.cumsum(after.valid.sum(axis=1)) <= 0.45 * np.count_nonzero(before.valid)
        hidden = DepthImage(np.where(seen[:, None], after.depth_m, 0), after.camera)
        assert MotionTest()(before, hidden, R).verdict in ("undecided", "confirmed")


def test_estimates_that_agree_with_a_report_outweigh_a_resemblance(mesh):
    """The images show no motion where a near symmetry was rotated: the estimates to the goal know better."""
    R, R_goal_before = so3.exp(np.array([1.0, 0, 0])), so3.exp(np.array([0.3, 1.0, 0]))
    image = seen(mesh, np.eye(3))
    last = Step(0, image, answer(R_goal_before, 0.9), R_step=R, R_executed=R)

    def unconfirmed(R_goal_now, confidence=0.9):
        now = Step(1, seen(mesh, np.eye(3), 1), answer(R_goal_now, confidence))
        return [x.verdict for x in MotionRecord.start(image).updated(last, now).unconfirmed]

    assert unconfirmed(R_goal_before @ R.T) == []
    assert unconfirmed(R_goal_before @ R.T, confidence=0.3) == ["beyond slip"]
    assert unconfirmed(R_goal_before) == ["beyond slip"]
