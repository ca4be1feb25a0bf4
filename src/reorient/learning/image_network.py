"""The network of the verifier on images, in torch: from the evidence images of a set of hypotheses to log-odds.

Each hypothesis has two evidence images, which go through the same convolutions. After the first of these the mean over
the set is another input, so that the network sees at each pixel where a hypothesis differs from the others. Pooled
features of both images, symmetric in the two, join the features of the boosted trees; two more layers compare them with
those of the set. The result is added to the log-odds of the trees.
"""

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from reorient.estimators.image_evidence import COMPARED, OUTSIDE, PER_PX, UNKNOWN_HERE, UNKNOWN_THERE
from reorient.learning.network import convolution

WIDTHS = (16, 32, 48)  # channels of the convolutions
HIDDEN = 64
_PLANES = 9
_FAR_PX = 10.0  # distance from a silhouette that is input as 1


class Sets:
    """Which rows are of one set."""

    def __init__(self, of: Int[Tensor, " n"] | None = None) -> None:
        """``of``: the set of each row; None: all of one."""
        self._of = of

    def mean(self, x: Float[Tensor, "n ..."]) -> Float[Tensor, "n ..."]:
        """The mean of each row's set."""
        if self._of is None:
            return x.mean(dim=0, keepdim=True).expand_as(x)
        count = torch.bincount(self._of).to(x.dtype).reshape(-1, *[1] * (x.dim() - 1))
        total = torch.zeros(len(count), *x.shape[1:], dtype=x.dtype).index_add(0, self._of, x)
        return (total / count)[self._of]

    def largest(self, x: Float[Tensor, "n c"]) -> Float[Tensor, "n c"]:
        """The largest value in each row's set."""
        if self._of is None:
            return x.amax(dim=0, keepdim=True).expand_as(x)
        count = int(self._of.max()) + 1
        return torch.full((count, x.shape[1]), -torch.inf, dtype=x.dtype).index_reduce(0, self._of, x, "amax")[self._of]


class ImageNetwork(nn.Module):
    """Log-odds that hypotheses are right, from evidence images, features of the trees and their log-odds."""

    mean: Tensor
    deviation: Tensor
    """Of the features of the training sets."""

    def __init__(self, features: int, dropout: float = 0.0) -> None:
        super().__init__()
        a, b, c = WIDTHS
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("deviation", torch.ones(features))
        self.own, self.others = nn.Conv2d(_PLANES, a, 3, 2, 1), nn.Conv2d(_PLANES, a, 3, 2, 1)
        self.body = nn.Sequential(
            nn.BatchNorm2d(a),
            nn.ReLU(),
            convolution(a, b, 3, 2),
            nn.ReLU(),
            convolution(b, b, 3),
            nn.ReLU(),
            convolution(b, c, 3, 2),
            nn.ReLU(),
            convolution(c, c, 3),
            nn.ReLU(),
        )
        self.scalars = nn.Linear(features + 1, 32)
        self.alone = nn.Linear(4 * c + 32, HIDDEN)
        self.in_set = nn.Linear(3 * HIDDEN, HIDDEN)
        self.last = nn.Linear(HIDDEN, 1)
        self.dropout = nn.Dropout(dropout)
        nn.init.zeros_(self.last.weight)  # begins with the answer of the trees
        nn.init.zeros_(self.last.bias)

    def forward(
        self,
        images: UInt8[Tensor, "n 2 c s s"],
        features: Float[Tensor, "n f"],
        log_odds: Float[Tensor, " n"],
        of: Int[Tensor, " n"] | None = None,
    ) -> Float[Tensor, " n"]:
        """Log-odds of hypotheses of the set ``of`` each; None: all of one set. ``log_odds``: those of the trees."""
        sets, n = Sets(of), images.shape[0]
        x = planes(images.flatten(0, 1)).contiguous(memory_format=torch.channels_last)
        others = self.others(x).unflatten(0, (n, 2))
        x = self.body(self.own(x) + sets.mean(others).flatten(0, 1))
        pooled = torch.cat([x.mean(dim=(2, 3)), x.amax(dim=(2, 3))], dim=1).float().unflatten(0, (n, 2))
        both = torch.cat([pooled.mean(dim=1), pooled.amax(dim=1)], dim=1)
        scaled = ((features - self.mean) / self.deviation).clamp(-5, 5)
        scalars = F.relu(self.scalars(torch.cat([scaled, log_odds[:, None] / 5], dim=1)))
        alone = F.relu(self.alone(self.dropout(torch.cat([both, scalars], dim=1))))
        in_set = torch.cat([alone, alone - sets.mean(alone), sets.largest(alone)], dim=1)
        added: Tensor = self.last(F.relu(self.in_set(self.dropout(in_set))))
        return log_odds + added[:, 0]


def planes(images: UInt8[Tensor, "n c s s"]) -> Float[Tensor, "n p s s"]:
    """Evidence images as the input of the first convolution: masks of the states, and values in [-1, 1]."""
    difference, state, normals, there, here = (x[:, 0].float() for x in images.split(1, dim=1))
    compared, outside, shown = state == COMPARED, state >= OUTSIDE, state >= COMPARED
    values = [
        *(x.float() for x in (compared, state == UNKNOWN_HERE, state == UNKNOWN_THERE, outside)),
        (difference / 127 - 128 / 127) * compared,
        ((state - OUTSIDE) / (_FAR_PX * PER_PX)).clamp(0, 1) * outside,
        (normals / 127.5 - 1) * compared,
        (there / 127.5 - 1) * shown,
        (here / 127.5 - 1) * shown,
    ]
    return torch.stack(values, dim=1)


def loss(
    log_odds: Float[Tensor, " n"], right: Bool[Tensor, " n"], of: Int[Tensor, " n"], sets: int
) -> Float[Tensor, ""]:
    """Mean over the hypotheses of the binary cross-entropy, plus mean over the sets with a right hypothesis of the
    negative log-likelihood that a right one is chosen (softmax)."""
    single = F.binary_cross_entropy_with_logits(log_odds, right.float())
    weight = torch.exp(log_odds - log_odds.detach().max())
    total = torch.zeros(sets).index_add(0, of, weight)
    chosen = torch.zeros(sets).index_add(0, of, weight * right)
    possible = torch.zeros(sets).index_add(0, of, right.float()) > 0
    return single - torch.log(chosen[possible] / total[possible]).sum() / max(sets, 1)
