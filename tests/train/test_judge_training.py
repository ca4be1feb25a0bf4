"""The judge that is written is the judge that was trained."""

import numpy as np

from reorient.estimators.verifier import FEATURES, load_judge
from reorient.learning.verifier import Shards, _fit, train


def test_the_written_trees_are_the_trained_ones(tmp_path):
    rng = np.random.default_rng(0)
    figures = rng.normal(size=(3000, len(FEATURES))).astype(np.float32)
    right = figures[:, 3] + 0.5 * figures[:, 7] * figures[:, 1] > 0.3
    data = Shards(figures, np.where(right, 1.0, 90.0), np.arange(3000) // 6, np.arange(3000) // 60)
    train(data, tmp_path / "judge.npz", trees=20)
    judge = load_judge(tmp_path / "judge.npz")
    objects = np.unique(data.object)
    apart = np.isin(data.object, np.random.default_rng(0).permutation(objects)[: int(0.2 * len(objects))])
    model = _fit(data.of(~apart), 20)
    np.testing.assert_allclose(judge.log_odds(figures.astype(float)), model.decision_function(figures), atol=1e-6)


def test_every_effort_is_calibrated_on_its_own(tmp_path):
    """Where the same figures say less, the odds are drawn in."""
    rng = np.random.default_rng(1)
    figures = rng.normal(size=(4000, len(FEATURES))).astype(np.float32)
    certain = figures[:, 3] > 0
    pair, thing = np.arange(4000) // 2, np.arange(4000) // 40
    clear = Shards(figures, np.where(certain, 1.0, 90.0), pair, thing)
    vague = Shards(figures, np.where(certain ^ (rng.random(4000) < 0.3), 1.0, 90.0), pair, thing)
    train(clear, tmp_path / "judge.npz", {"fast": vague}, trees=20)
    calibration = load_judge(tmp_path / "judge.npz").calibration
    assert calibration["fast"][0] < 0.5 * calibration["normal"][0]
    assert calibration["thorough"] == calibration["normal"]
