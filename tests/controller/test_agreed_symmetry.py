"""What the estimates of a loop agree on, and the smallest of the rotations that are the same."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import answer

from reorient import so3
from reorient.controller.agreed_symmetry import AgreedSymmetry

Z = np.array([0, 0, 1.0])
FLIP = so3.exp(np.pi * np.array([1.0, 0, 0]))
ABOUT = so3.exp(np.radians(np.arange(20, 360, 20))[:, None] * Z)


def stating(*symmetries, free_axis=None):
    return replace(answer(np.eye(3), 0.9), symmetries=symmetries, free_axis=free_axis)


@pytest.mark.parametrize(("times", "agreed"), [(1, 1), (2, 2), (3, 2)])
def test_half_of_the_estimates_suffice_and_fewer_do_not(times, agreed):
    estimates = [stating(FLIP)] * times + [stating()] * (4 - times)
    assert len(AgreedSymmetry.of(estimates).rotations) == agreed


@pytest.mark.parametrize(("third", "agreed"), [(True, 4), (False, 2)])
def test_symmetries_are_a_group(third, agreed):
    """Two half rotations in turn are a third; without it the less stated one of the two was imagined."""
    other, both = so3.exp(np.pi * np.eye(3)[1]), so3.exp(np.pi * Z)
    estimates = [stating(FLIP, other, *[both] * third), stating(FLIP, other, *[both] * third), stating(FLIP)]
    symmetry = AgreedSymmetry.of(estimates)
    assert len(symmetry.rotations) == agreed
    assert so3.angle_difference(symmetry.rotations, FLIP).min() == pytest.approx(0)


def test_nearest_is_modulo_the_symmetry(rng):
    symmetry = AgreedSymmetry.of([stating(FLIP)])
    R, target = so3.sample_uniform(rng, 2)
    found, away_rad = symmetry.nearest(R[None], target)
    assert away_rad == pytest.approx(min(so3.angle_difference(x @ R, target) for x in (np.eye(3), FLIP)))
    assert so3.angle_difference(found, target) == pytest.approx(away_rad)


def test_rotations_about_an_axis_of_revolution_are_exact(rng):
    """The estimates list them in steps of 20 degrees."""
    symmetry = AgreedSymmetry.of([stating(*ABOUT, free_axis=Z)])
    np.testing.assert_array_equal(symmetry.axis, Z)
    target = so3.sample_uniform(rng, 1)[0]
    found, away_rad = symmetry.nearest((so3.exp(np.radians(131.0) * Z) @ target)[None], target)
    assert away_rad == pytest.approx(0, abs=1e-7)
    np.testing.assert_allclose(found, target, atol=1e-9)


def test_an_axis_that_one_view_leaves_free_is_no_symmetry():
    """It may be a mug whose handle is out of view: only a goal from all sides states symmetries."""
    assert AgreedSymmetry.of([stating(free_axis=Z)]).axis is None
    assert AgreedSymmetry.of([stating(FLIP, free_axis=Z)]).axis is None
