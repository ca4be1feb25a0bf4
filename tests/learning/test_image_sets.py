"""Reading of the data of the verifier on images."""

from dataclasses import replace

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.estimators.image_evidence import CHANNELS, SIZE
from reorient.estimators.image_verifier import SURE
from reorient.estimators.verifier import FEATURES, load_verifier
from reorient.learning.image_sets import batch_of, read_sets


def write_shard(folder, number, rng, pairs=4, **more):
    """Pairs of three hypotheses of two objects, whose features mean nothing."""
    folder.mkdir(exist_ok=True)
    n = 3 * pairs
    arrays = {
        "features": np.array(FEATURES),
        "figures": rng.normal(size=(n, len(FEATURES))).astype(np.float32),
        "error_deg": rng.uniform(0, 10, n).astype(np.float32),
        "pair": np.repeat(np.arange(pairs), 3) + number * pairs,
        "object": np.repeat(np.arange(pairs), 3) // 2 + number * 2,
        "angle_deg": np.full(n, 60, np.float32),
        "images": rng.integers(0, 256, (n, 2, len(CHANNELS), SIZE, SIZE), np.uint8),
    }
    np.savez_compressed(folder / f"shard-{number:06d}.npz", **arrays | more)
    return arrays


def test_rows_keep_their_sets_and_objects(tmp_path, rng):
    arrays = [write_shard(tmp_path / name, number, rng) for name in ("one", "two") for number in range(2)]
    data = read_sets([tmp_path / "one", tmp_path / "two"])
    every = np.concatenate([x["figures"] for x in arrays])
    images = np.concatenate([x["images"] for x in arrays])
    verifier = load_verifier()
    probability = verifier.probability(verifier.log_odds(every.astype(float)), "normal").reshape(-1, 3)
    assert len(data) == int((probability.max(axis=1) < SURE).sum()) > 8
    for row in range(len(data.log_odds)):
        (origin,) = np.nonzero((every == data.features[row]).all(axis=1))[0]
        np.testing.assert_array_equal(data.images[row], images[origin])
    assert np.all(np.diff(data.log_odds)[np.diff(data.of) == 0] <= 0)  # most likely first
    assert len(np.unique(data.object)) <= 8
    assert len(np.unique(data.object)) > 4  # those of the two folders are different
    assert not set(data.object[data.of == 0]) & set(data.object[data.of == len(data) - 1])


def test_whether_an_object_is_held_out_does_not_depend_on_others(tmp_path, rng):
    for number in range(6):
        write_shard(tmp_path / "one", number, rng)
    data = read_sets([tmp_path / "one"])
    apart = data.held_out(0.5)
    assert 0 < apart.sum() < len(data)
    half = replace(data, **{
        name: getattr(data, name)[: data.first[len(data) // 2]]
        for name in ("images", "features", "log_odds", "error_deg", "object", "angle_deg")
    }, first=data.first[: len(data) // 2])  # fmt: skip
    np.testing.assert_array_equal(half.held_out(0.5), apart[: len(data) // 2])
    assert not set(data.object[np.isin(data.of, np.nonzero(apart)[0])]) & set(
        data.object[np.isin(data.of, np.nonzero(~apart)[0])]
    )


def test_rotated_images_stay_together(tmp_path, rng):
    same = rng.integers(0, 256, (1, 2, len(CHANNELS), SIZE, SIZE), np.uint8)
    write_shard(tmp_path / "one", 0, rng, images=np.repeat(same, 12, axis=0))
    data = read_sets([tmp_path / "one"])
    turned = [batch_of(data, np.arange(len(data)), np.random.default_rng(seed)) for seed in range(5)]
    for images, *_, of in turned:
        for number in np.unique(of):
            assert (images[of == number] == images[of == number][:1]).all()
        np.testing.assert_array_equal(np.sort(images.ravel()), np.sort(data.images.ravel()))
    assert any((images != data.images).any() for images, *_ in turned)


def test_other_data_is_refused(tmp_path, rng):
    write_shard(tmp_path / "other", 0, rng, features=np.array(["another"]))
    with pytest.raises(ReorientError, match="features of another version"):
        read_sets([tmp_path / "other"])
    arrays = write_shard(tmp_path / "without", 0, rng)
    del arrays["images"]
    np.savez_compressed(tmp_path / "without" / "shard-000000.npz", **arrays)
    with pytest.raises(ReorientError, match="expected a file of `verifier make --images`"):
        read_sets([tmp_path / "without"])
    with pytest.raises(ReorientError, match="no shards in"):
        read_sets([tmp_path / "nothing"])
