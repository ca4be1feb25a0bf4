"""The judge's data and training, on a few objects."""

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.estimators.judge import FEATURES, load_judge
from reorient.judging import JudgeData, make, read
from reorient.objects import ObjectSource

CONFIG = JudgeData(ObjectSource(count=2), pairs=2, per_shard=1, effort="fast")


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shards")
    states = list(make(CONFIG, folder))
    return folder, states


def test_every_hypothesis_is_a_row(shards):
    folder, states = shards
    data = read(folder)
    assert states == [(0, 2), (1, 2), (2, 2)]
    assert data.figures.shape == (len(data.pair), len(FEATURES))
    assert set(data.pair.tolist()) == {0, 1, 2, 3}
    assert set(data.object.tolist()) == {0, 1}
    assert data.right.any()
    assert not data.right.all()


def test_goes_on_and_repeats_itself(shards, tmp_path):
    folder, _ = shards
    assert list(make(CONFIG, folder)) == [(2, 2)]
    again = read(folder)
    (folder / "shard-000001.npz").unlink()
    assert list(make(CONFIG, folder)) == [(1, 2), (2, 2)]
    np.testing.assert_array_equal(read(folder).figures, again.figures)


def test_nothing_to_read(tmp_path):
    with pytest.raises(ReorientError, match="no shards in"):
        read(tmp_path)


def test_the_written_trees_are_the_trained_ones(tmp_path):
    pytest.importorskip("sklearn")
    from reorient.judging import Shards, _fit, train

    rng = np.random.default_rng(0)
    figures = rng.normal(size=(3000, len(FEATURES))).astype(np.float32)
    right = figures[:, 3] + 0.5 * figures[:, 7] * figures[:, 1] > 0.3
    data = Shards(figures, np.where(right, 1.0, 90.0), np.arange(3000) // 6, np.arange(3000) // 60)
    train(data, tmp_path / "judge.npz", trees=20)
    judge = load_judge(tmp_path / "judge.npz")
    objects = np.unique(data.object)
    apart = np.isin(data.object, np.random.default_rng(0).permutation(objects)[: int(0.25 * len(objects))])
    model = _fit(data.of(~apart), 20)
    np.testing.assert_allclose(judge.log_odds(figures.astype(float)), model.decision_function(figures), atol=1e-6)
