"""Teaching a goal: which views, that the object comes back whatever happens, and what is said about it."""

from dataclasses import replace

import numpy as np
import pytest

from reorient import Limits, StationError, so3
from reorient.errors import ReorientError
from reorient.stations.rendered import RenderedStation
from reorient.stations.teaching import teach
from reorient.world.rendering import load_world
from reorient.world.sensing import Sensor

NOW = Limits(wait_s=0.0)


class Watched:
    """The simulator, with planned faults by the number of the capture or rotation."""

    def __init__(self, mesh, noise_m=0.0, reach_deg=180.0):
        self.inner = RenderedStation(mesh, load_world("benchmark"), Sensor(noise_m=noise_m), np.random.default_rng(3))
        self.pivot_m = self.inner.pivot_m
        self.rotated_deg, self.captures, self.faults = [], 0, {}
        self.reach_deg, self.R_goal = reach_deg, self.inner.R_camera_object

    @property
    def away_deg(self):
        return float(np.degrees(so3.angle_difference(self.inner.R_camera_object, self.R_goal)))

    def capture(self):
        self.captures += 1
        self._fail("capture", self.captures)
        return self.inner.capture_goal()

    def rotate(self, R_step):
        self.rotated_deg.append(float(np.degrees(so3.angle(R_step))))
        self._fail("rotate", len(self.rotated_deg))
        return self.inner.rotate(R_step)

    def reachable(self, R_step):
        R = R_step @ self.inner.R_camera_object @ self.R_goal.T
        return float(np.degrees(so3.angle(R))) <= self.reach_deg

    def _fail(self, act, number):
        if (error := self.faults.get((act, number))) is not None:
            raise error


@pytest.fixture
def station(mesh):
    return Watched(mesh)


def test_views_have_their_motions_and_the_object_comes_back(mesh):
    station = Watched(mesh, noise_m=0.001)
    lines = []
    taught = teach(station, views=2, captures=3, limits=NOW, report=lines.append)
    assert station.away_deg < 1e-6
    assert taught.warnings == ()
    assert len(taught.goal.views) == 2
    assert "returned: 0." in lines[-1]
    center_m = station.inner.placement.center_m
    for view, made in zip(taught.goal.views, taught.provenance["further_views"], strict=True):
        stated = np.array(made["R_goal_view_stated"])
        assert so3.angle_difference(view.R_goal_view, stated) < np.radians(1.0)
        assert np.linalg.norm(view.R_goal_view @ center_m + view.t_goal_view_m - center_m) < 0.002
        station.inner.R_camera_object = stated.T @ station.R_goal
        seen = station.inner.capture_goal()
        assert np.mean(seen.valid == view.image.valid) > 0.98  # the inverse rotation shows another outline
        station.inner.R_camera_object = stated @ station.R_goal
        assert np.mean(station.inner.capture_goal().valid == view.image.valid) < 0.98


def test_one_view_moves_nothing(station):
    taught = teach(station, views=0, captures=2, limits=NOW)
    assert taught.goal.views == ()
    assert station.captures == 2
    assert station.rotated_deg == []


@pytest.mark.slow
def test_only_what_can_be_reached_is_visited(mesh):
    station = Watched(mesh, reach_deg=70.0)
    taught = teach(station, views=3, captures=1, limits=NOW)
    assert len(taught.goal.views) == 3
    assert all(np.degrees(so3.angle(view.R_goal_view)) < 72 for view in taught.goal.views)
    station = Watched(mesh, reach_deg=10.0)
    taught = teach(station, views=2, captures=1, limits=NOW)
    assert taught.goal.views == ()
    assert "0 of 2 further views are reachable" in taught.warnings[0]
    assert station.rotated_deg == []


def test_limits_hold_before_anything_moves(station):
    asked = []
    declines = replace(NOW, confirm=lambda R: bool(asked.append(R)))
    with pytest.raises(ReorientError, match="not confirmed"):
        teach(station, views=2, captures=1, limits=declines)
    assert asked[0].shape == (3, 3)
    with pytest.raises(ReorientError, match="360 deg of rotation, the limit is 100"):
        teach(station, views=2, captures=1, limits=replace(NOW, max_rotation_rad=np.radians(100)))
    lines = []
    assert teach(station, 2, 1, replace(NOW, dry_run=True), lines.append).goal.views == ()
    assert "would rotate to 90, 90 deg" in lines[0]
    assert station.rotated_deg == []
    teach(station, views=1, captures=1, limits=replace(NOW, max_step_rad=np.radians(50)))
    assert max(station.rotated_deg) <= 50


def test_a_view_that_cannot_be_captured_is_left_out(station):
    station.faults = {("capture", 2): ReorientError("the isolation leaves nothing")}
    taught = teach(station, views=2, captures=1, limits=NOW)
    assert len(taught.goal.views) == 1
    assert "view 1 is left out: the isolation leaves nothing" in taught.warnings[0]
    assert station.away_deg < 1e-6


def test_the_object_comes_back_after_a_failed_move(station):
    station.faults = {("rotate", 2): StationError("the drive is off")}
    with pytest.raises(StationError, match="the drive is off"):
        teach(station, views=2, captures=1, limits=NOW)
    assert len(station.rotated_deg) == 3
    assert station.away_deg < 1e-6


def test_a_station_that_does_not_return_says_where_the_object_is(station):
    station.faults = {("rotate", n): StationError("the drive is off") for n in (2, 3)}
    with pytest.raises(StationError, match="not returned, it is about 90 deg from the goal pose: the drive"):
        teach(station, views=2, captures=1, limits=NOW)


def test_ctrl_c_between_moves_returns_the_object_and_in_a_move_stops(station):
    station.faults = {("capture", 3): KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        teach(station, views=2, captures=1, limits=NOW)
    assert station.away_deg < 1e-6
    station.faults = {("rotate", len(station.rotated_deg) + 2): KeyboardInterrupt()}
    before, lines = len(station.rotated_deg), []
    with pytest.raises(KeyboardInterrupt):
        teach(station, views=2, captures=1, limits=NOW, report=lines.append)
    assert len(station.rotated_deg) == before + 2  # nothing is commanded after it
    assert "was not returned: it is about 90 deg" in lines[-1]


def test_an_object_that_slipped_is_reported(mesh):
    station = Watched(mesh, noise_m=0.0005)
    rotate = station.inner.rotate
    station.inner.rotate = lambda R: (rotate(so3.exp(np.array([0.03, 0.05, 0.0])) @ R), R)[1]
    taught = teach(station, views=1, captures=1, limits=NOW)
    assert any("from the goal pose after it was returned: it slipped" in warning for warning in taught.warnings)
