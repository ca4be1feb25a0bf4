"""The bound of the error that a loop leaves, and the error to expect."""

import numpy as np
import pytest

from reorient import so3
from reorient.controller.remaining import COMMON, bound_rad, expected_error_rad, fused_covariance
from reorient.estimators import load_estimator
from reorient.imaging import Goal
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised


@pytest.mark.parametrize("deviations_deg", [(0.1, 0.1, 0.1), (0.02, 0.1, 0.5), (0.3, 0.3, 0.01)])
@pytest.mark.parametrize("mean_deg", [0.0, 0.4])
def test_the_bound_holds_as_often_as_it_states(deviations_deg, mean_deg, rng):
    axes, deviations = so3.sample_uniform(rng, 1)[0], np.radians(deviations_deg)
    covariance, mean = axes @ np.diag(deviations**2) @ axes.T, np.radians(mean_deg) * axes[:, 0]
    drawn = mean + rng.standard_normal((20_000, 3)) * deviations @ axes.T
    inside = np.linalg.norm(drawn, axis=1) <= bound_rad(covariance, mean)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_more_observations_leave_what_they_have_in_common():
    one = np.diag([1.0, 2.0, 3.0])
    np.testing.assert_allclose(fused_covariance(one, 1), one)
    assert np.all(np.diag(fused_covariance(one, 4)) < np.diag(fused_covariance(one, 2)))
    np.testing.assert_allclose(fused_covariance(one, 10**9), COMMON * one, rtol=1e-6)


def test_more_noise_makes_a_larger_error_expected(mesh):
    renderer, world = Renderer(mesh), load_world("benchmark")
    pairs = [sample_pair(np.random.default_rng(2), renderer, world, randomised(x), 1, 1) for x in (0.0005, 0.003)]
    expected = [expected_error_rad(load_estimator(), x.current, Goal(x.goal)) for x in pairs]
    assert 0 < expected[0] < 0.5 * expected[1] < np.radians(5)


def test_an_estimator_without_a_forecast_or_with_a_broken_one_has_none(mesh):
    pair = sample_pair(np.random.default_rng(2), Renderer(mesh), load_world("benchmark"), randomised(), 1, 1)

    class Broken:
        def final_covariance(self, *_):
            raise RuntimeError("no")

    for estimator in (load_estimator("gicp"), Broken()):
        assert expected_error_rad(estimator, pair.current, Goal(pair.goal)) is None
