"""Estimators that know the true orientation, stations and bodies for tests of the loop."""

import numpy as np
import trimesh

from reorient import Limits, StationError, so3
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.registration import Evidence
from reorient.stations.rendered import RenderedStation
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")
NOW = Limits(wait_s=0.0)
EVIDENCE = Evidence(1, 0, 0, 0, 0.0)
BOX = trimesh.creation.box((1, 0.7, 0.5))


class Oracle:
    """Knows the true rotation but for ``error_rad``; where ``flip`` is given, it takes that for the goal's orientation
    whenever it is the nearer one."""

    def __init__(self, station, R_goal, error_rad=0.0, flip=None, confidence=0.97, covariance_rad2=None):
        self.station, self.R_goal, self.error_rad, self.confidence = station, R_goal, error_rad, confidence
        self.flip, self.covariance_rad2 = flip, covariance_rad2
        self.rng = np.random.default_rng(0)
        self.histories = []

    def estimate(self, current, goal, pivot_m=None, history=()):
        self.histories.append((self.station.R_camera_object, list(history)))
        if np.count_nonzero(current.depth_m) < 20:
            raise ReorientError("current image has 1 returns")
        R = self.R_goal @ self.station.R_camera_object.T
        if self.flip is not None:
            R = min((R, self.flip @ R), key=lambda x: float(so3.angle(x)))
        R = so3.exp(self.rng.normal(0, self.error_rad, 3)) @ R
        center = self.station.placement.center_m
        return RotationEstimate(R, center - R @ center, EVIDENCE, self.confidence, covariance_rad2=self.covariance_rad2)


class Always:
    """Answers the same rotation about the optical axis to every image."""

    def __init__(self, angle_rad, confidence=0.9):
        self.angle_rad, self.confidence = angle_rad, confidence

    def estimate(self, current, goal, pivot_m=None, history=()):
        return answer(so3.exp(np.array([0, 0, self.angle_rad])), self.confidence)


class Wrapped:
    """Another station; subclasses change one thing."""

    def __init__(self, station):
        self.station, self.pivot_m = station, station.pivot_m

    def capture(self):
        return self.station.capture()

    def rotate(self, R_step):
        return self.station.rotate(R_step)


class Hiding(Wrapped):
    """A station at which the object is not visible near one orientation."""

    def __init__(self, station, R_hidden, rotates_back=True):
        super().__init__(station)
        self.R_hidden, self.rotates_back = R_hidden, rotates_back

    def hides(self):
        return float(so3.angle_difference(self.station.R_camera_object, self.R_hidden)) < np.radians(20)

    def capture(self):
        if self.hides():
            raise StationError("no object in view")
        return self.station.capture()

    def rotate(self, R_step):
        if self.hides() and not self.rotates_back:
            raise StationError("refused to move")
        return self.station.rotate(R_step)


def answer(R, confidence=None, *alternatives):
    """An estimate with no translation."""
    return RotationEstimate(R, np.zeros(3), EVIDENCE, confidence, alternatives)


def cell(mesh, start_deg=100.0, seed=5, noise_m=0.0):
    """A station away from its goal: (station, goal image, goal orientation)."""
    rng = np.random.default_rng(seed)
    station = RenderedStation(mesh, WORLD, randomised(noise_m), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    start_rad = np.radians(start_deg)
    station.rotate(so3.matrix_from_quat(so3.sample_bounded(rng, 1, start_rad, start_rad))[0])
    return station, goal, R_goal


def left_deg(station, R_goal):
    return float(np.degrees(so3.angle_difference(R_goal, station.R_camera_object)))


def lying_box(knob=0.0):
    """A box in the pose of its goal, with two different knobs on the far side, and the flip that changes nothing in
    that view: (mesh, flip)."""
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
