"""Pairs in an S3 bucket: the same as in a folder, for generation, a rerun and training."""

import os

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.learning.pair_reader import PairReader
from reorient.learning.pair_store import generate
from reorient.learning.recipes import load_preset
from reorient.learning.training import train
from reorient.world.objects import ObjectSource
from reorient.world.pairs import PairSet

boto3 = pytest.importorskip("boto3")
pytest.importorskip("s3fs")
server = pytest.importorskip("moto.server")
SMALL = PairSet(ObjectSource(count=8, object_seed=7), pairs_per_object=6)
TWO_SHARDS = PairSet(ObjectSource(count=22, object_seed=7), pairs_per_object=1)


@pytest.fixture(scope="module")
def bucket():
    """The URL of an empty bucket of a server on this machine."""
    s3 = server.ThreadedMotoServer("127.0.0.1", 0)
    s3.start()
    host, port = s3.get_host_and_port()
    own = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    before = {name: os.environ.get(name) for name in own}
    os.environ.update(own)
    boto3.client("s3").create_bucket(Bucket="pairs")
    yield "s3://pairs"
    for name, value in before.items():
        os.environ.pop(name) if value is None else os.environ.update({name: value})
    s3.stop()


def values(path, count):
    batch = PairReader(path).read(np.arange(count))
    return [getattr(batch, name) for name in ("images", "quat_wxyz", "quat_start_wxyz", "pivot_m")]


def test_an_interrupted_generation_into_a_bucket_continues(bucket, tmp_path):
    url = f"{bucket}/two"
    first = generate(TWO_SHARDS, url)
    assert [next(first).done for _ in range(2)] == [0, 20]
    first.close()
    with pytest.raises(ReorientError, match="1 shards of .* are missing"):
        PairReader(url)
    assert [state.done for state in generate(TWO_SHARDS, url)] == [20, 22]
    list(generate(TWO_SHARDS, tmp_path / "here"))
    for there, here in zip(values(url, 22), values(tmp_path / "here", 22), strict=True):
        np.testing.assert_array_equal(there, here)
    with pytest.raises(ReorientError, match="holds other pairs"):
        next(generate(SMALL, url))


def test_a_training_reads_from_a_bucket_as_from_a_folder(bucket, small_set, tmp_path):
    list(generate(SMALL, f"{bucket}/small"))
    losses = [
        [state.loss for state in train(load_preset("debug"), pairs, tmp_path / name)]
        for name, pairs in (("there", f"{bucket}/small"), ("here", small_set))
    ]
    assert losses[0] == losses[1]
