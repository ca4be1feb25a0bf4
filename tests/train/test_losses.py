"""Losses against their definitions, finite differences, and what symmetry makes of them."""

import numpy as np
import pytest
import torch

from reorient import so3
from reorient.learning import losses


@pytest.fixture
def quaternions(rng):
    true = so3.sample_bounded(rng, 6, 0.05, np.pi / 6)
    left = so3.sample_bounded(rng, 6, 0.05, 0.3)
    return torch.from_numpy(so3.canonical(so3.multiply(left, true))), torch.from_numpy(true)


@pytest.fixture
def cloud(rng):
    """Vertices of six objects, of different numbers, padded with zeros."""
    count = np.array([5, 40, 12, 40, 7, 30])
    vertices = rng.normal(0, 0.4, (6, 40, 3))
    vertices[np.arange(40) >= count[:, None]] = 0
    return torch.from_numpy(vertices), torch.from_numpy(count)


def shape_match_by_definition(predicted, true, vertices, count):
    """The paper's formula, word for word."""
    total = 0.0
    for q_hat, q, x, n in zip(predicted.numpy(), true.numpy(), vertices.numpy(), count.tolist(), strict=True):
        a, b = (x[:n] @ so3.matrix_from_quat(r).T for r in (q_hat, q))
        total += np.mean(np.min(np.sum((a[:, None] - b[None]) ** 2, axis=2), axis=1)) / 2
    return total / len(predicted)


def test_shape_match_is_the_papers_formula(quaternions, cloud):
    assert losses.shape_match_loss(*quaternions, *cloud).item() == pytest.approx(
        shape_match_by_definition(*quaternions, *cloud), rel=1e-9
    )


def test_shape_match_forgives_a_symmetry_and_only_that(rng):
    flip = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)
    x = rng.normal(0, 0.4, (1, 20, 3))
    symmetric = torch.from_numpy(np.concatenate([x, x * [-1, -1, 1]], axis=1))  # about z
    q = torch.from_numpy(so3.sample_bounded(rng, 1, 0.2, 0.5))
    flipped = torch.from_numpy(so3.multiply(q.numpy(), flip.numpy()))
    count = torch.tensor([40])
    assert losses.shape_match_loss(flipped, q, symmetric, count).item() == pytest.approx(0, abs=1e-12)
    assert losses.mean_loss(flipped, q).item() > 0.5
    assert losses.shape_match_loss(flipped, q, symmetric[:, :20], torch.tensor([20])).item() > 1e-3


def test_shape_match_cannot_tell_q_from_minus_q_and_the_mean_loss_can(quaternions, cloud):
    predicted, true = quaternions
    assert losses.shape_match_loss(-predicted, true, *cloud) == losses.shape_match_loss(predicted, true, *cloud)
    assert losses.mean_loss(-predicted, true) > losses.mean_loss(predicted, true) + 1


@pytest.mark.parametrize("name", ["mean_loss", "chord_loss", "shape_match_loss"])
def test_gradients_are_finite_differences(name, quaternions, cloud):
    predicted, true = quaternions
    more = cloud if name == "shape_match_loss" else ()
    assert torch.autograd.gradcheck(
        lambda q: getattr(losses, name)(torch.nn.functional.normalize(q, dim=1), true, *more),
        predicted.clone().requires_grad_(),
        eps=1e-6,
        atol=1e-6,
    )


@pytest.mark.parametrize("name", ["mean_loss", "chord_loss", "shape_match_loss"])
def test_every_loss_is_least_at_the_truth(name, quaternions, cloud):
    predicted, true = quaternions
    more = cloud if name == "shape_match_loss" else ()
    loss = getattr(losses, name)
    assert loss(true, true, *more) < 2e-4
    assert loss(losses_inverse(true), true, *more) > loss(predicted, true, *more) > loss(true, true, *more)


def losses_inverse(quat_wxyz):
    return quat_wxyz * torch.tensor([1.0, -1.0, -1.0, -1.0])


def test_angles_and_matrices_agree_with_so3(quaternions):
    predicted, true = quaternions
    expected = np.degrees(so3.angle_between(predicted.numpy(), true.numpy()))
    assert np.allclose(losses.angle_deg(-predicted, true).numpy(), expected)
    assert np.allclose(losses.matrix_from_quat(true).numpy(), so3.matrix_from_quat(true.numpy()))
