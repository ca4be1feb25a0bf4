"""The verifier that is written is the one that was trained."""

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.estimators.verifier import FEATURES, load_verifier
from reorient.estimators.views_verifier import VIEWS_FEATURES
from reorient.learning.trees import fit_platt, fit_trees
from reorient.learning.verifier import Shards, Training, held_out, train

FEW = Training(trees=20)


def test_the_written_trees_are_the_trained_ones(tmp_path, rng):
    features = rng.normal(size=(3000, len(FEATURES))).astype(np.float32)
    right = features[:, 3] + 0.5 * features[:, 7] * features[:, 1] > 0.3
    data = Shards(FEATURES, features, np.where(right, 1.0, 90.0), np.arange(3000) // 6, np.arange(3000) // 60)
    train(data, tmp_path / "verifier.npz", training=FEW)
    verifier = load_verifier(tmp_path / "verifier.npz")
    apart = held_out(data, FEW)
    assert 0.1 < apart.mean() < 0.3
    model = fit_trees(features[~apart], right[~apart], FEW.trees)
    log_odds = model.decision_function(features)
    np.testing.assert_allclose(verifier.log_odds(features.astype(float)), log_odds, atol=1e-6)
    assert np.mean((log_odds[apart] > 0) == right[apart]) > 0.8


def test_every_effort_is_calibrated_on_its_own(tmp_path, rng):
    """Where the same features tell less, the log-odds are drawn in."""
    features = rng.normal(size=(4000, len(FEATURES))).astype(np.float32)
    certain = features[:, 3] > 0
    pair, thing = np.arange(4000) // 2, np.arange(4000) // 40
    clear = Shards(FEATURES, features, np.where(certain, 1.0, 90.0), pair, thing)
    vague = Shards(FEATURES, features, np.where(certain ^ (rng.random(4000) < 0.3), 1.0, 90.0), pair, thing)
    train(clear, tmp_path / "verifier.npz", {"fast": vague}, FEW)
    calibration = load_verifier(tmp_path / "verifier.npz").calibration
    assert calibration["fast"][0] < 0.5 * calibration["normal"][0]
    assert set(calibration) == {"fast", "normal"}


def test_several_views_are_calibrated_by_their_number(tmp_path, rng):
    features = rng.normal(size=(4000, len(VIEWS_FEATURES))).astype(np.float32)
    count = np.repeat([2, 3], 2000)
    features[:, VIEWS_FEATURES.index("goal views")] = count
    certain = features[:, 3] > 0
    right = np.where(count == 2, certain ^ (rng.random(4000) < 0.3), certain)
    order = rng.permutation(4000)
    pair = np.arange(4000) // 2
    data = Shards(VIEWS_FEATURES, features, np.where(right, 1.0, 90.0), pair, pair // 20).only(order)
    train(data, tmp_path / "views.npz", training=FEW)
    verifier = load_verifier(tmp_path / "views.npz", VIEWS_FEATURES)
    assert set(verifier.calibration) == {"2 goal views", "3 goal views"}
    assert verifier.calibration["2 goal views"][0] < 0.7 * verifier.calibration["3 goal views"][0]
    with pytest.raises(ReorientError, match="features of another version"):
        load_verifier(tmp_path / "views.npz")


def test_data_of_two_folders_keep_their_pairs_and_objects_apart(rng):
    features = rng.normal(size=(6, len(FEATURES))).astype(np.float32)
    one = Shards(FEATURES, features, np.ones(6), np.arange(6) // 2, np.arange(6) // 3)
    both = one.and_also(one)
    assert both.pair.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert both.object.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    views = Shards(VIEWS_FEATURES, features, np.ones(6), one.pair, one.object)
    with pytest.raises(ReorientError, match="folders of the same kind"):
        one.and_also(views)


def test_platt_scaling_finds_scale_and_shift(rng):
    log_odds = rng.normal(0, 3, 40_000)
    right = rng.random(40_000) < 1 / (1 + np.exp(-(0.6 * log_odds - 0.4)))
    assert fit_platt(log_odds, right) == pytest.approx((0.6, -0.4), abs=0.04)
