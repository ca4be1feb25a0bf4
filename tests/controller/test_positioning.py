"""A loop that also brings the object to the goal's place, at the simulator and with a robot."""

from dataclasses import replace

import numpy as np
import pytest

from reorient import Limits, StationError, load_estimator, orient, se3, so3
from reorient.errors import ReorientError
from reorient.stations.rendered import RenderedStation
from reorient.stations.replay import RecordingStation, ReplayedStation
from reorient.world.rendering import load_world
from reorient.world.sensing import Sensor

NOW = Limits(wait_s=0.0)
AWAY_M = np.array([0.02, -0.015, 0.04])


@pytest.fixture
def station(mesh):
    return RenderedStation(mesh, load_world("benchmark"), Sensor(noise_m=0.0005), np.random.default_rng(3))


@pytest.fixture
def goal(station):
    image = station.capture_goal()
    station.rotate(so3.exp(np.array([0.3, -0.2, 0.1])))
    station.move(se3.transform(np.eye(3), AWAY_M))
    return image


@pytest.mark.slow
def test_both_rotation_and_position_reach_the_goal(station, goal, tmp_path):
    place_m, R_goal = station.placement.center_m - AWAY_M, so3.exp(-np.array([0.3, -0.2, 0.1]))
    R_goal = so3.exp(np.array([0.3, -0.2, 0.1])).T @ station.R_camera_object
    recording = RecordingStation(station, tmp_path / "record", goal, {})
    result = orient(recording, goal, load_estimator("gicp"), limits=NOW, translation=True)
    assert result.converged, result.reason
    assert np.linalg.norm(station.placement.center_m - place_m) < 0.0015
    assert so3.angle_difference(station.R_camera_object, R_goal) < np.radians(0.6)
    assert result.distance_m < 0.001
    assert "from the goal's place" in result.reason
    again = orient(ReplayedStation(tmp_path / "record"), goal, load_estimator("gicp"), limits=NOW, translation=True)
    assert (again.status, again.reason) == (result.status, result.reason)


def test_without_it_the_position_stays(station, goal):
    center_m = station.placement.center_m
    result = orient(station, goal, load_estimator("gicp"), limits=NOW)
    assert np.array_equal(station.placement.center_m, center_m)
    assert result.distance_m is None


def test_a_station_that_cannot_move_is_refused_before_anything_moves(station, goal):
    class Rotating:
        pivot_m = station.pivot_m
        capture = station.capture

        def rotate(self, R_step):
            pytest.fail("rotated")

    with pytest.raises(ReorientError, match="move"):
        orient(Rotating(), goal, load_estimator("gicp"), translation=True)


def test_limits_and_confirmation_come_before_the_first_move(station, goal, monkeypatch):
    monkeypatch.setattr(station, "rotate", lambda R: pytest.fail("rotated"))
    center_m = station.placement.center_m
    asked = []
    limits = replace(NOW, confirm=lambda T: bool(asked.append(T)))
    result = orient(station, goal, load_estimator("gicp"), limits=limits, translation=True)
    assert result.status == "declined"
    (T,) = asked
    assert T.shape == (4, 4)
    assert np.linalg.norm(T[:3, 3] + AWAY_M) < 0.03
    result = orient(
        station, goal, load_estimator("gicp"), limits=replace(NOW, max_translation_m=0.02), translation=True
    )
    assert result.status == "unreachable"
    assert "expected at most 0.02 m" in result.reason
    assert np.array_equal(station.placement.center_m, center_m)
    with pytest.raises(ReorientError, match="translation"):
        Limits(max_translation_m=0.0)


def test_failed_and_interrupted_moves_end_the_loop_with_a_record(station, goal, monkeypatch):
    def fails(T_step):
        raise StationError("the drive is off")

    monkeypatch.setattr(station, "move", fails)
    result = orient(station, goal, load_estimator("gicp"), limits=NOW, translation=True)
    assert (result.status, "the drive is off" in result.reason) == ("station_failed", True)

    def interrupted(T_step):
        raise KeyboardInterrupt

    monkeypatch.setattr(station, "move", interrupted)
    assert orient(station, goal, load_estimator("gicp"), limits=NOW, translation=True).status == "interrupted"
