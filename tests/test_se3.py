"""Rigid transforms are a group that acts on points."""

import numpy as np
import pytest

from reorient import se3, so3


@pytest.fixture
def transforms(rng):
    """Three transforms, each with its rotation and translation."""
    R, t_m = so3.sample_uniform(rng, 3), rng.normal(0, 1, (3, 3))
    return [se3.transform(*parts) for parts in zip(R, t_m, strict=True)]


def test_products_and_inverses_are_rigid(transforms):
    a, b, _ = transforms
    for T in (a @ b, se3.inverse(a)):
        assert so3.is_rotation(T[:3, :3], 1e-12)
        assert np.array_equal(T[3], [0, 0, 0, 1])


def test_the_product_with_the_inverse_is_the_identity_on_either_side(transforms):
    for T in transforms:
        assert np.allclose(T @ se3.inverse(T), np.eye(4), atol=1e-12)
        assert np.allclose(se3.inverse(T) @ T, np.eye(4), atol=1e-12)


def test_the_inverse_of_a_product_is_the_product_of_the_inverses_in_reverse(transforms):
    a, b, _ = transforms
    assert np.allclose(se3.inverse(a @ b), se3.inverse(b) @ se3.inverse(a), atol=1e-12)
    assert not np.allclose(se3.inverse(a @ b), se3.inverse(a) @ se3.inverse(b), atol=0.01)


def test_products_are_associative(transforms):
    a, b, c = transforms
    assert np.allclose((a @ b) @ c, a @ (b @ c), atol=1e-12)


def test_a_product_acts_as_its_factors_one_after_the_other(transforms, rng):
    a, b, _ = transforms
    points_m = rng.normal(0, 1, (5, 4, 3))
    assert se3.apply(a, points_m).shape == points_m.shape
    assert np.allclose(se3.apply(a @ b, points_m), se3.apply(a, se3.apply(b, points_m)), atol=1e-12)
    assert np.allclose(se3.apply(se3.inverse(a), se3.apply(a, points_m)), points_m, atol=1e-12)
    assert np.allclose(se3.apply(np.eye(4), points_m), points_m)


def test_points_are_rotated_first_and_moved_then():
    """A quarter turn about z takes x to y; the translation is in the axes of the result."""
    T = se3.transform(so3.exp(np.array([0.0, 0.0, np.pi / 2])), np.array([0.0, 0.0, 2.0]))
    assert np.allclose(se3.apply(T, np.array([1.0, 0.0, 0.0])), [0.0, 1.0, 2.0])


def test_distances_between_points_are_kept(transforms, rng):
    points_m = rng.normal(0, 1, (6, 3))
    for T in transforms:
        moved_m = se3.apply(T, points_m)
        before, after = (np.linalg.norm(x[:, None] - x, axis=-1) for x in (points_m, moved_m))
        assert np.allclose(before, after, atol=1e-12)
