"""The networks have the shape the paper gives, and answer unit quaternions."""

import numpy as np
import pytest
import torch
from torch import nn

from reorient.learning import losses
from reorient.learning.batches import prepare
from reorient.learning.network import build
from reorient.learning.pair_reader import PairReader


@pytest.mark.parametrize("name", ["paper", "swift"])
def test_answers_are_unit_quaternions(name):
    network = build(name).eval()
    answer = network(torch.rand(3, 2, 128, 128))
    assert answer.shape == (3, 4)
    assert torch.allclose(answer.norm(dim=1), torch.ones(3))


def test_the_paper_network_is_as_the_text_says():
    network = build("paper", dropout=0.4)
    kinds = [type(module) for module in network.modules()]
    assert kinds.count(nn.Conv2d) == kinds.count(nn.BatchNorm2d) == 5
    linear = [(m.in_features, m.out_features) for m in network.modules() if isinstance(m, nn.Linear)]
    assert linear == [(4096, 1024), (2048, 1000), (1000, 1000), (1000, 4)]
    assert {m.negative_slope for m in network.modules() if isinstance(m, nn.LeakyReLU)} == {0.02}
    assert [m.p for m in network.modules() if isinstance(m, nn.Dropout)] == [0.4, 0.4]


def test_the_paper_network_is_siamese():
    network = build("paper").eval()
    images = torch.rand(2, 2, 128, 128)
    seen = []
    network.head.register_forward_hook(lambda module, inputs, output: seen.append(inputs[0]))
    network(images)
    network(images.flip(1))
    assert torch.allclose(seen[0][:, :1024], seen[1][:, 1024:], atol=1e-5)


def test_swift_begins_with_no_rotation():
    answer = build("swift").eval()(torch.rand(4, 2, 128, 128))
    assert (answer[:, 0] > 0.7).all()


@pytest.mark.parametrize("name", ["paper", "swift"])
def test_it_learns_some_pairs_by_heart(name, small_set):
    """And their inverses, which it was not shown, it gets wrong: the start is not taken for the goal."""
    reader = PairReader(small_set)
    images, quat_wxyz, _ = prepare(reader.read(np.arange(32)), reader)
    images, true = torch.from_numpy(images), torch.from_numpy(quat_wxyz).float()
    torch.manual_seed(0)
    network = build(name)
    optimizer = torch.optim.Adam(network.parameters(), 3e-4)
    for _ in range(25):
        optimizer.zero_grad()
        losses.mean_loss(network(images), true).backward()
        optimizer.step()
    with torch.inference_mode():
        answer = network(images)
    nothing = losses.angle_deg(torch.tensor([[1.0, 0, 0, 0]]).expand(32, 4), true).mean()
    assert losses.angle_deg(answer, true).mean() < 0.4 * nothing
    assert losses.angle_deg(answer * torch.tensor([1, -1, -1, -1]), true).mean() > nothing
