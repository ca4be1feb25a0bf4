"""Stored pairs: the same bytes however they are made, nothing lost to a kill, and what a reader gets back."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import SMALL
from reorient import so3
from reorient.errors import ReorientError
from reorient.learning.pair_reader import PairReader
from reorient.learning.pair_store import estimate_cost, generate
from reorient.runs.pool import Pool
from reorient.world.objects import ObjectSource
from reorient.world.pairs import PairSet
from reorient.world.rendering import Placement, Renderer, load_world


def digest(path):
    """Of every file of a set."""
    files = sorted(file for file in Path(path).rglob("*") if file.is_file())
    return {str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def run(config, path, **more):
    return list(generate(config, path, **more))[-1]


@pytest.fixture(scope="module")
def sharded(tmp_path_factory):
    """More pairs than a shard holds."""
    path = tmp_path_factory.mktemp("sharded") / "set"
    config = PairSet(ObjectSource(count=3, object_seed=7), pairs_per_object=200, seed=5)
    run(config, path)
    return config, path


def test_two_workers_make_the_same_bytes(sharded, tmp_path):
    config, path = sharded
    assert run(config, tmp_path / "two", pool=Pool(2)).done == 600
    assert digest(tmp_path / "two") == digest(path)


def test_a_second_process_in_the_folder_is_refused(tmp_path):
    first = generate(SMALL, tmp_path / "set")
    next(first)
    with pytest.raises(ReorientError, match="another process is writing into"):
        next(generate(SMALL, tmp_path / "set"))
    first.close()
    assert run(SMALL, tmp_path / "set").done == 48


def test_a_missing_shard_is_made_again_and_nothing_else(sharded, tmp_path):
    config, path = sharded
    copy = tmp_path / "copy"
    subprocess.run(["cp", "-r", path, copy], check=True)
    (copy / "quat_wxyz/c/0/0").unlink()
    with pytest.raises(ReorientError, match="1 shards of .* are missing: expected `reorient generate` to have ended"):
        PairReader(copy)
    states = list(generate(config, copy))
    assert (states[0].done, states[-1].done) == (0, 600)
    assert digest(copy) == digest(path)


def test_killed_at_any_moment_it_finishes_to_the_same_bytes(tmp_path):
    config = PairSet(ObjectSource(count=24, object_seed=7), pairs_per_object=64)  # 1,536 pairs, 2 shards
    command = [
        sys.executable,
        "-m",
        "reorient",
        "generate",
        str(tmp_path / "set"),
        "--count",
        "24",
        "--object-seed",
        "7",
    ]
    command += ["--pairs-per-object", "64", "--workers", "1"]
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    first = tmp_path / "set" / "quat_wxyz" / "c"
    while not first.exists():  # one of the two shards is there, the other is being made
        assert process.poll() is None, "it ended before it was killed"
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    with pytest.raises(ReorientError, match="1 shards of .* are missing"):
        PairReader(tmp_path / "set")
    assert run(config, tmp_path / "set").done == 1536
    run(config, tmp_path / "whole", pool=Pool(2))
    whole = digest(tmp_path / "whole")
    left = digest(tmp_path / "set")
    assert {name: left[name] for name in whole} == whole
    assert all(".partial" in name for name in set(left) - set(whole))


def test_a_reader_gives_back_what_was_drawn(small_set):
    reader = PairReader(small_set)
    batch = reader.read(np.array([47, 0, 13]))
    assert batch.object_index.tolist() == [7, 0, 2]
    world = load_world("paper")
    name = reader.names[0]
    renderer = Renderer(SMALL.objects.open().load(name))
    scale_m, *center_m = np.asarray(reader._group["placement"])[0]
    R_start, R = so3.matrix_from_quat(batch.quat_start_wxyz[1]), so3.matrix_from_quat(batch.quat_wxyz[1])
    goal_m = renderer.depth(world.camera, R @ R_start, Placement(scale_m, np.array(center_m)))
    stored_m = batch.images[1, 1] * reader.quantum_m
    kept = stored_m > 0
    assert 0.97 < kept.sum() / (goal_m > 0).sum() < 1  # one in a hundred is dropped
    assert np.abs(stored_m - goal_m)[kept].max() < 0.51 * reader.quantum_m
    right = renderer.depth(world.camera, R_start @ R, Placement(scale_m, np.array(center_m)))
    assert np.mean(np.abs(stored_m - right)[kept] < reader.quantum_m) < 0.5


def test_the_drawn_rotations_have_the_papers_four_properties(sharded):
    labels = PairReader(sharded[1])._labels["quat_wxyz"]
    assert np.allclose(np.linalg.norm(labels, axis=1), 1)
    assert (labels[:, 0] >= np.cos(np.pi / 12)).all()
    assert (labels[:, :1] > np.abs(labels[:, 1:])).all()
    angles = np.degrees(so3.quat_angle(labels))
    assert np.histogram(angles, 3, (0, 30))[0].min() > 150  # of 600, uniform


def test_a_share_of_the_pairs_is_in_hand(small_set, tmp_path):
    """They show less of their objects, at other distances."""
    config = replace(SMALL, in_hand=0.5)
    run(config, tmp_path / "half")
    half, none = (PairReader(path) for path in (tmp_path / "half", small_set))
    assert half.config.in_hand == 0.5
    images, whole = (reader.read(np.arange(48)).images for reader in (half, none))
    assert images.max() * half.quantum_m < 1  # no stray returns, which reach metres
    distance_m = np.asarray(half._group["placement"])[:, 3]
    in_hand = (distance_m < 0.57) | (distance_m > 0.62)  # the distances of the world paper
    assert 8 < in_hand.sum() < 40
    assert np.mean(images[in_hand] > 0) < 0.7 * np.mean(whole > 0)


def test_an_order_has_every_pair_of_its_objects_once(small_set, rng):
    order = PairReader(small_set).order([1, 5], rng)
    assert sorted(order) == [*range(6, 12), *range(30, 36)]
    assert list(order) != sorted(order)


def test_vertices_are_over_the_bounding_radius(small_set):
    reader = PairReader(small_set)
    radii = np.linalg.norm(reader.vertices, axis=2).max(axis=1)
    assert (reader.vertex_count <= 500).all()
    assert np.all((radii > 0.8) & (radii <= 1 + 1e-6))


def test_the_store_is_six_times_smaller_than_raw(sharded):
    _, path = sharded
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    assert size < 600 * 2 * 128 * 128 * 2 / 6


def test_the_estimate_is_near(sharded, tmp_path):
    config, path = sharded
    cost = estimate_cost(config, tmp_path / "new")
    size = sum(
        file.stat().st_size for name in ("current", "goal") for file in (path / name).rglob("*") if file.is_file()
    )
    assert cost.pairs == 600
    assert 0.5 < cost.bytes / size < 2
    assert not (tmp_path / "new").exists()


def test_bad_places_are_refused(small_set, tmp_path):
    with pytest.raises(ReorientError, match="holds other pairs: expected an empty place"):
        run(PairSet(ObjectSource(count=2)), small_set)
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(ReorientError, match="holds something else: expected an empty or a new place"):
        run(SMALL, tmp_path)
    with pytest.raises(ReorientError, match="no pairs in .*: expected what `reorient generate` wrote"):
        PairReader(tmp_path / "nothing")
    with pytest.raises(ReorientError, match="high_deg=10.*: expected a number from 30 to 180"):
        PairSet(low_deg=30, high_deg=10)
