"""Splatting: the nearest point of each pixel, and nothing of what lies outside."""

import numpy as np
import pytest

from reorient.imaging import Camera, DepthImage
from reorient.imaging.splatting import splat

SHAPE = (6, 8)


def slowly(uv_px, depth_m, shape):
    """The same by a loop over pixels."""
    image = np.zeros(shape)
    for row, column in np.ndindex(*shape):
        here = np.all(np.floor(uv_px) == (column, row), axis=1) & (depth_m > 0)
        image[row, column] = depth_m[here].min() if here.any() else 0
    return image


@pytest.mark.parametrize("n", [0, 1, 300])
def test_every_pixel_shows_its_nearest_point(n, rng):
    uv_px, depth_m = rng.uniform(-3, 12, (n, 2)), rng.uniform(-0.2, 1, n)
    image = splat(uv_px, depth_m, SHAPE)
    assert np.array_equal(image, slowly(uv_px, depth_m, SHAPE))
    assert np.count_nonzero(image) >= (n == 300) * 30


def test_a_depth_image_splatted_into_its_own_camera_is_itself(rng):
    camera = Camera(8, 6, 9.0, 8.0, 4.2, 2.9)
    image = DepthImage(np.where(rng.random((6, 8)) < 0.5, rng.uniform(0.3, 2, (6, 8)), 0), camera)
    points_m = image.points()
    assert np.allclose(splat(camera.project(points_m), points_m[:, 2], SHAPE), image.depth_m)


def test_points_of_several_images_stay_apart():
    uv_px, depth_m = np.full((3, 2), 2.5), np.array([0.5, 0.4, 0.6], np.float32)
    images = splat(uv_px, depth_m, (2, *SHAPE), np.array([0, 1, 1]))
    assert images.dtype == np.float32
    assert np.argwhere(images).tolist() == [[0, 2, 2], [1, 2, 2]]
    assert images[:, 2, 2].tolist() == [np.float32(0.5), np.float32(0.4)]


@pytest.mark.parametrize("uv_px", [(-0.01, 2.0), (8.0, 2.0), (2.0, -0.01), (2.0, 6.0), (np.nan, np.nan)])
def test_points_outside_the_image_are_ignored(uv_px):
    assert not splat(np.array([uv_px]), np.ones(1), SHAPE).any()
