"""The mean of captures has less noise and fewer holes; what few captures show is unknown."""

from dataclasses import replace

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.imaging.averaging import mean_image

CAMERA = Camera(40, 30, 50.0, 50.0, 20.0, 15.0)


@pytest.fixture
def captures(rng):
    truth_m = np.zeros((30, 40))
    truth_m[5:25, 8:32] = 0.6
    noisy = [np.where(truth_m > 0, truth_m + rng.normal(0, 0.002, truth_m.shape), 0) for _ in range(5)]
    return [DepthImage(depth_m, CAMERA, float(i)) for i, depth_m in enumerate(noisy)]


def deviation(image):
    return float(np.std(image.depth_m[image.valid]))


def test_noise_falls_as_of_a_mean(captures):
    mean = mean_image(captures)
    assert 0.35 < deviation(mean) / deviation(captures[0]) < 0.6  # 1 / sqrt(5) is 0.447
    assert np.array_equal(mean.valid, captures[0].valid)
    assert not mean.unknown.any()
    assert mean.stamp_s == 4.0


def test_lost_and_wrong_returns_of_few_captures_do_not_count(captures):
    for i, (row, column) in enumerate([(10, 10), (11, 15)]):
        depth_m = captures[i].depth_m.copy()
        depth_m[row, column] = [0.0, 0.9][i]
        captures[i] = replace(captures[i], depth_m=depth_m)
    mean = mean_image(captures)
    assert mean.valid[10, 10]
    assert abs(mean.depth_m[11, 15] - 0.6) < 0.005


def test_what_few_captures_show_is_unknown_and_what_none_shows_is_not_the_object(captures):
    depth_m = captures[0].depth_m.copy()
    depth_m[2, 2] = 0.6
    captures[0] = replace(captures[0], depth_m=depth_m)
    lost = np.zeros(CAMERA_SHAPE, bool)
    lost[20, 20] = True
    captures = [replace(image, unknown=lost) if i else image for i, image in enumerate(captures)]
    mean = mean_image(captures)
    assert set(map(tuple, np.argwhere(mean.unknown))) == {(2, 2), (20, 20)}
    assert not mean.valid[0, 0]
    assert not mean.unknown[0, 0]


CAMERA_SHAPE = (30, 40)


def test_images_of_other_cameras_and_none_are_refused(captures):
    other = replace(captures[0], camera=Camera(40, 30, 51.0, 50.0, 20.0, 15.0))
    for images in ((), (captures[0], other)):
        with pytest.raises(ReorientError, match="expected at least one, all of the same camera"):
            mean_image(images)
