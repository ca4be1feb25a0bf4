"""Images for a guide: cameras, recordings, the simulated hand."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from reorient import so3
from reorient.controller.guiding import GuideState
from reorient.errors import ReorientError, StationError
from reorient.estimators.base import RotationEstimate
from reorient.imaging import Camera, DepthImage
from reorient.imaging.files import write_depth
from reorient.registration import Evidence
from reorient.stations.rendered_hand import Hand, RenderedHand
from reorient.stations.replay import RecordingStation
from reorient.stations.watching import FAILURES, replay, watch
from reorient.world.rendering import load_world
from reorient.world.sensing import Sensor

CAMERA = Camera(8, 6, 10.0, 10.0, 4.0, 3.0)
EVIDENCE = Evidence(0.9, 0.0, 0.0, 0.1, 0.001)


def image(depth_m=0.5, stamp_s=None):
    return DepthImage(np.full((6, 8), depth_m), CAMERA, stamp_s)


class Scripted:
    """A camera that gives images or raises errors, one after another."""

    pivot_m = None

    def __init__(self, *acts):
        self.acts = list(acts)

    def capture(self):
        act = self.acts.pop(0)
        if isinstance(act, BaseException):
            raise act
        return act

    def rotate(self, R_step):
        return R_step


def test_failed_captures_are_tried_again_and_an_empty_view_is_none():
    camera = Scripted(StationError("no frame"), image(), ReorientError("no object"), OSError("unplugged"), image())
    times, images = zip(*islice(watch(camera), 3), strict=True)
    assert [x is None for x in images] == [False, True, False]
    assert list(times) == sorted(times)


@pytest.mark.parametrize("error", [StationError("no frame"), OSError("unplugged")])
def test_a_camera_that_fails_again_and_again_ends(error):
    frames = watch(Scripted(*[error] * FAILURES))
    with pytest.raises(StationError, match="the camera failed: .*(no frame|unplugged)"):
        next(frames)


@pytest.mark.usefixtures("unchecked")
def test_a_camera_without_depth_images_ends_at_once():
    with pytest.raises(StationError, match="returned a ndarray"):
        next(watch(Scripted(np.zeros((6, 8)))))


def test_an_isolation_that_finds_nothing_is_none():
    def isolate(frame):
        if frame.depth_m.max() > 1:
            raise ReorientError("nothing is left")
        return frame

    found = [each for _, each in islice(watch(Scripted(image(), image(2.0)), isolate), 2)]
    assert [x is None for x in found] == [False, True]


def test_a_folder_of_images(tmp_path):
    for name, depth_m in (("b", 0.6), ("a", 0.5)):
        write_depth(tmp_path / f"{name}.npz", image(depth_m))
    (tmp_path / "notes.txt").write_text("")
    (first_s, first), (second_s, second) = replay(tmp_path)
    assert (first.depth_m.max(), second.depth_m.max()) == (pytest.approx(0.5), pytest.approx(0.6))
    assert second_s - first_s == pytest.approx(1 / 30)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ReorientError, match="no images"):
        replay(empty)


def test_a_record(tmp_path):
    station = RecordingStation(Scripted(image(0.5, 3.0), image(0.6, 3.5)), tmp_path / "record", image(), {})
    station.capture()
    station.rotate(np.eye(3))
    station.capture()
    assert [(time_s, round(float(x.depth_m.max()), 3)) for time_s, x in replay(tmp_path / "record")] == [
        (3.0, 0.5),
        (3.5, 0.6),
    ]


# --- the simulated hand ---------------------------------------------------------------------------------------------


def hand_of(mesh, seed=0, start_deg=40.0, **settings):
    world = load_world("benchmark")
    small = replace(world, camera=world.camera.resized(32, 32))
    return RenderedHand(
        mesh, small, Sensor(), np.random.default_rng(seed), float(np.radians(start_deg)), Hand(**settings)
    )


def guided(hand, seconds, answer):
    """Let a hand follow a guide for some time; ``answer``: the state of each image, given the remaining rotation."""
    for index, (time_s, picture) in enumerate(islice(hand.frames(), int(seconds * 30))):
        R = hand.R_goal @ hand.R_camera_object.T
        hand(answer(index, time_s, picture, RotationEstimate(R, np.zeros(3), EVIDENCE, 1.0)))


def rotate(index, time_s, picture, estimate):
    return GuideState(index, time_s, "rotate", "rotate on", picture, estimate)


def hold(index, time_s, picture, estimate):
    return GuideState(index, time_s, "hold", "hold the object still", picture, estimate)


def test_the_hand_follows_after_its_delay(mesh):
    hand = hand_of(mesh, tremor_rad=0.0, wrong_every_s=1e9)
    guided(hand, 0.3, rotate)
    assert np.degrees(hand.error_rad) == pytest.approx(40)
    guided(hand, 4.0, rotate)
    assert np.degrees(hand.error_rad) < 2


def test_the_hand_holds_still_but_trembles(mesh):
    hand = hand_of(mesh)
    guided(hand, 2.0, hold)
    assert np.degrees(hand.error_rad) == pytest.approx(40, abs=1.5)
    assert np.degrees(hand.error_rad) != pytest.approx(40, abs=1e-3)


def test_the_hand_moves_the_wrong_way_now_and_then(mesh):
    hand, away = hand_of(mesh, tremor_rad=0.0, wrong_every_s=1.0, misjudged=0.0), []
    for index, (time_s, picture) in enumerate(islice(hand.frames(), 150)):
        R = hand.R_goal @ hand.R_camera_object.T
        away.append(hand.error_rad)
        hand(rotate(index, time_s, picture, RotationEstimate(R, np.zeros(3), EVIDENCE, 1.0)))
    assert np.max(np.diff(away)) > np.radians(0.3)
    assert min(away) < np.radians(15)


def test_the_same_seed_is_the_same_trial(mesh):
    def run(seed):
        hand = hand_of(mesh, seed)
        guided(hand, 1.0, rotate)
        return hand.R_camera_object, next(hand.frames())[1].depth_m

    (first, picture), (second, same), (other, _) = run(1), run(1), run(2)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(picture, same)
    assert so3.angle_difference(first, other) > 0.1
