"""A tiny pair set that all tests of training read."""

import pytest
import torch

from reorient.learning.pair_store import generate
from reorient.world.objects import ObjectSource
from reorient.world.pairs import PairSet

SMALL = PairSet(ObjectSource(count=8, object_seed=7), pairs_per_object=6)


@pytest.fixture(scope="session", autouse=True)
def _one_thread():
    torch.set_num_threads(1)  # of each test process, and the same sums in the same order every time


@pytest.fixture(scope="session")
def small_set(tmp_path_factory):
    """8 objects of 6 pairs."""
    path = tmp_path_factory.mktemp("pairs") / "small"
    assert list(generate(SMALL, path))[-1].done == 48
    return path
