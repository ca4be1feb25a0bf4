"""The verifier's data, on a few objects."""

from dataclasses import replace

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.estimators.verifier import FEATURES
from reorient.estimators.views_verifier import VIEWS_FEATURES
from reorient.learning.verifier import read
from reorient.learning.verifier_data import VerifierData, make
from reorient.world.objects import ObjectSource

CONFIG = VerifierData(ObjectSource(count=2), pairs=2, per_shard=1, effort="fast")


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shards")
    states = list(make(CONFIG, folder))
    return folder, states


def test_every_hypothesis_is_a_row(shards):
    folder, states = shards
    data = read(folder)
    assert states == [(0, 2), (1, 2), (2, 2)]
    assert data.features.shape == (len(data.pair), len(FEATURES))
    assert set(data.pair.tolist()) == {0, 1, 2, 3}
    assert set(data.object.tolist()) == {0, 1}
    assert data.right.any()
    assert not data.right.all()


@pytest.mark.slow
def test_several_views_have_features_of_their_own(tmp_path):
    config = replace(CONFIG, goal_views=(2, 3), views_now=(1, 2), objects=ObjectSource(count=1))
    list(make(config, tmp_path))
    data = read(tmp_path)
    assert data.names == VIEWS_FEATURES
    assert data.features.shape == (len(data.pair), len(VIEWS_FEATURES))
    assert np.isfinite(data.features).all()
    assert set(data.features[:, VIEWS_FEATURES.index("goal views")].tolist()) <= {1.0, 2.0, 3.0}


def test_goes_on_and_repeats_itself(shards, tmp_path):
    folder, _ = shards
    assert list(make(CONFIG, folder)) == [(2, 2)]
    again = read(folder)
    (folder / "shard-000001.npz").unlink()
    assert list(make(CONFIG, folder)) == [(1, 2), (2, 2)]
    np.testing.assert_array_equal(read(folder).features, again.features)


def test_shards_of_another_config_are_not_mixed(shards):
    folder, _ = shards
    with pytest.raises(ReorientError, match="holds a run of another config: expected the same config, or a new folder"):
        list(make(replace(CONFIG, seed=1), folder))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"effort": "foo"}, "unknown effort 'foo'"),
        ({"world": "foo"}, "unknown world 'foo'"),
        *(({name: 0}, f"{name}=0: expected a number from 1") for name in ("pairs", "per_shard")),
        ({"goal_views": (7,)}, "goal_views=.*: expected numbers from 1 to 6"),
        ({"views_now": (4,)}, "views_now=.*: expected numbers from 1 to 3"),
        ({"seed": -1}, "seed=-1: expected a number from 0"),
        ({"least_deg": 120.0}, "least_deg=120.0: expected a number from 0 to 90"),
        ({"images": True, "goal_views": (2,)}, "images and several views: expected evidence images of one view"),
        ({"in_hand": 1.5}, "in_hand=1.5: expected a number from 0 to 1"),
        *(({"most_noise_mm": value}, "most_noise_mm=.*: expected a number from 0") for value in (-1.0, np.nan, np.inf)),
        *(({"most_wrong_focal": value}, "expected a number from 0 and below 1") for value in (-0.1, 1.0, np.nan)),
    ],
)
def test_what_cannot_be_made_is_refused(bad, message):
    with pytest.raises(ReorientError, match=message):
        VerifierData(**bad)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_broken_shard_is_named(share, shards, tmp_path):
    whole = (shards[0] / "shard-000000.npz").read_bytes()
    (tmp_path / "shard-000000.npz").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ReorientError, match="cannot read .*shard-000000.npz.*expected a file of `verifier make`"):
        read(tmp_path)


def test_nothing_to_read(tmp_path):
    with pytest.raises(ReorientError, match="no shards in"):
        read(tmp_path)


def test_every_hypothesis_of_a_mirrored_goal_is_wrong(tmp_path):
    list(make(replace(CONFIG, mirrored=1.0), tmp_path))
    data = read(tmp_path)
    assert not data.right.any()
