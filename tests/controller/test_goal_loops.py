"""Loops towards a goal of several views."""

import numpy as np
import pytest
import trimesh

from reorient import load_estimator, orient, so3
from reorient.controller import Limits
from reorient.imaging import Goal, GoalView
from reorient.stations.rendered import RenderedStation
from reorient.world.goals import rotations_away
from reorient.world.rendering import load_world
from reorient.world.sensing import Sensor


def taught(mesh, rng):
    """A station, its goal of six views and the goal orientation."""
    station = RenderedStation(mesh, load_world("benchmark"), Sensor(noise_m=0.0005), rng)
    image, R_goal, views = station.capture_goal(), station.R_camera_object, []
    for R in rotations_away(rng, 6):
        station.rotate(R)
        views.append(GoalView(station.capture_goal(), R.T))
        station.rotate(R.T)
    return station, Goal(image, tuple(views)), R_goal


@pytest.mark.slow
def test_a_symmetric_object_is_brought_to_the_nearest_equivalent_without_doubt(rng):
    station, goal, R_goal = taught(trimesh.creation.box((1.0, 0.7, 0.4)), rng)
    station.rotate(so3.exp(np.radians(150) * np.array([0.6, 0.8, 0.0])))
    result = orient(station, goal, load_estimator("fast"), limits=Limits(wait_s=0.0))
    assert result.converged
    assert not any("flip" in step.message or "equally" in step.message for step in result.steps)
    half = np.stack([np.eye(3), *(np.diag(x) for x in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1]))])
    assert np.degrees(so3.angle_difference(R_goal @ half, station.R_camera_object)).min() < 1
    assert result.moves <= 4
