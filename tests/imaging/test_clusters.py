"""Stray returns are removed; the object, cut or not, stays whole."""

import numpy as np
import pytest

from reorient.imaging import Camera, DepthImage, without_strays

CAMERA = Camera(60, 60, 100.0, 100.0, 30.0, 30.0)


def square() -> np.ndarray:
    depth_m = np.zeros((60, 60))
    depth_m[20:40, 20:40] = 0.5
    return depth_m


@pytest.mark.parametrize("depth_of_stray_m", [0.05, 0.5, 65.0])
def test_a_stray_return_becomes_unknown(depth_of_stray_m):
    depth_m = square()
    depth_m[2, 55] = depth_of_stray_m
    image = without_strays(DepthImage(depth_m, CAMERA))
    assert np.array_equal(image.depth_m, square().astype(np.float32))
    assert np.argwhere(image.unknown).tolist() == [[2, 55]]


def test_a_stray_return_in_front_of_the_object_becomes_unknown():
    depth_m = square()
    depth_m[30, 30] = 0.1
    assert np.argwhere(without_strays(DepthImage(depth_m, CAMERA)).unknown).tolist() == [[30, 30]]


def test_an_object_that_a_finger_cuts_stays_whole():
    depth_m = square()
    depth_m[:, 34:37] = 0
    image = DepthImage(depth_m, CAMERA)
    assert without_strays(image) is image


def test_two_parts_of_similar_size_both_stay():
    depth_m = square()
    depth_m[20:40, 24:34] = 0
    depth_m[:, 50:58] = 0.9
    image = DepthImage(depth_m, CAMERA)
    assert np.array_equal(without_strays(image).depth_m, image.depth_m)
