"""Losses between predicted and true unit quaternions (n, 4), each the mean over the batch (paper, "Learning to Estimate
3D Rotations")."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

Quaternions = Float[Tensor, "n 4"]

AT_ONCE = 4  # objects whose vertices are matched together; more products do not fit the cache


def mean_loss(predicted_wxyz: Quaternions, true_wxyz: Quaternions) -> Float[Tensor, ""]:
    """1 - <q, q_hat>, the paper's substitute for the angle.

    For one pair its minimiser is that of arccos <q, q_hat>. Over a data set it is another loss, because it grows with
    the square of small angles. It distinguishes q from -q, so predictions tend to q_r > 0.
    """
    return (1 - (predicted_wxyz * true_wxyz).sum(dim=1)).mean()


def chord_loss(predicted_wxyz: Quaternions, true_wxyz: Quaternions) -> Float[Tensor, ""]:
    """|q - q_hat|: half the angle for small angles, so that large errors have less weight than in ``mean_loss``.

    With untrained weights it keeps predictions at "no rotation", the median of the true rotations.
    """
    return (predicted_wxyz - true_wxyz).square().sum(dim=1).add(1e-8).sqrt().mean()


def shape_match_loss(
    predicted_wxyz: Quaternions,
    true_wxyz: Quaternions,
    vertices: Float[Tensor, "n v 3"],
    count: Int[Tensor, " n"],
) -> Float[Tensor, ""]:
    """ShapeMatch: half the mean squared distance from vertices rotated by q_hat to the nearest ones rotated by q.

    ``vertices``: over the bounding radius (the paper gives no unit); the first ``count`` of each row are valid. The
    nearest vertex is found without gradient; the distance to it has a gradient.
    """
    # |a x1 - b x2| = |b^-1 a x1 - x2|: rotate one cloud by the difference instead of both
    difference = matrix_from_quat(true_wxyz).transpose(1, 2) @ matrix_from_quat(predicted_wxyz)
    moved = vertices @ difference.transpose(1, 2)
    present = torch.arange(vertices.shape[1], device=count.device) < count[:, None]
    with torch.no_grad():
        # the nearest x2 maximises <x1, x2> - |x2|^2 / 2: one product, no square roots
        half_square = torch.where(present, vertices.square().sum(dim=2) / 2, torch.inf)[..., None]
        left, right = torch.cat([moved, torch.ones_like(half_square)], 2), torch.cat([vertices, -half_square], 2)
        few = zip(left.split(AT_ONCE), right.split(AT_ONCE), strict=True)
        nearest = torch.cat([torch.bmm(a, b.transpose(1, 2)).argmax(dim=2) for a, b in few])
    matched = torch.gather(vertices, 1, nearest[..., None].expand(-1, -1, 3))
    square = (moved - matched).square().sum(dim=2) * present
    return (square.sum(dim=1) / (2 * count)).mean()


def matrix_from_quat(quat_wxyz: Quaternions) -> Float[Tensor, "n 3 3"]:
    """Rotation matrices of unit quaternions, differentiable."""
    w, x, y, z = quat_wxyz.unbind(dim=1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
    ]
    return torch.stack(rows, dim=1)


def angle_deg(predicted_wxyz: Quaternions, true_wxyz: Quaternions) -> Float[Tensor, " n"]:
    """Angle between the rotations in degrees, for any sign of the quaternions."""
    minus = (predicted_wxyz - true_wxyz).norm(dim=1)
    plus = (predicted_wxyz + true_wxyz).norm(dim=1)
    return torch.rad2deg(4 * torch.atan2(torch.minimum(minus, plus), torch.maximum(minus, plus)))
