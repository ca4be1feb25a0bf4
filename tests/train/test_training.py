"""Training learns, resumes exactly, survives a kill, and gives the same with two processes."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
import zarr
from safetensors.torch import load_file, save_file

from reorient.errors import ReorientError
from reorient.learning.batches import prepare
from reorient.learning.export import export
from reorient.learning.network import build
from reorient.learning.pair_reader import PairReader
from reorient.learning.recipes import Training, load_preset, lr_at
from reorient.learning.training import train
from reorient.learning.weights import load_weights
from reorient.world.objects import split

DEBUG = load_preset("debug")


def run(config, pairs, out, **more):
    return list(train(config, pairs, out, **more))


def weights(out):
    return load_file(out / "best.safetensors")


def rows(out):
    with (out / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


def same(a, b):
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


@pytest.fixture(scope="module")
def trained(small_set, tmp_path_factory):
    """A whole run of the debug recipe."""
    out = tmp_path_factory.mktemp("run") / "debug"
    return out, run(DEBUG, small_set, out)


def test_a_run_leaves_config_metrics_log_and_weights(trained):
    out, states = trained
    assert json.loads((out / "config.json").read_text())["training"]["loss"] == "hybrid"
    assert [int(row["epoch"]) for row in rows(out)] == [0, 1]
    assert any((out / "log").iterdir())
    assert build("paper").load_state_dict(weights(out))
    validated = [state.validation_deg for state in states if state.validation_deg is not None]
    assert [float(row["validation_deg"]) for row in rows(out)] == pytest.approx(validated, abs=1e-4)
    assert states[-1].step == states[-1].steps


def test_the_first_epoch_of_hybrid_is_the_mean_loss_and_the_next_is_shape_match(trained, small_set, tmp_path):
    hybrid = [float(row["loss"]) for row in rows(trained[0])]
    for name, same_as in (("mean", 0), ("shapematch", None)):
        run(replace(DEBUG, loss=name), small_set, tmp_path / name)
        alone = [float(row["loss"]) for row in rows(tmp_path / name)]
        assert (alone[0] == hybrid[0]) == (same_as == 0)
        assert alone[1] != hybrid[1]


def test_an_interrupted_run_resumes_exactly(trained, small_set, tmp_path):
    out = tmp_path / "run"
    steps = train(DEBUG, small_set, out, save_every_s=0)
    for state in steps:
        if state.step == 6:  # in the middle of the second epoch, of 4 steps
            steps.close()
            break
    assert len(rows(out)) == 1
    run(DEBUG, small_set, out)
    assert same(weights(out), weights(trained[0]))
    assert [row["loss"] for row in rows(out)] == [row["loss"] for row in rows(trained[0])]


def test_interrupted_before_an_epoch_is_validated_it_resumes_exactly(trained, small_set, tmp_path):
    out = tmp_path / "run"
    steps = train(DEBUG, small_set, out, save_every_s=0)
    assert next(state.step for state in steps if state.validation_deg is not None) == 4
    steps.close()  # all steps of the first epoch are in the checkpoint, its validation is not
    run(DEBUG, small_set, out)
    assert same(weights(out), weights(trained[0]))
    assert [row["loss"] for row in rows(out)] == [row["loss"] for row in rows(trained[0])]


def test_killed_at_any_moment_it_ends_the_same(trained, small_set, tmp_path):
    out = tmp_path / "run"
    script = (
        "import sys, torch; torch.set_num_threads(1); from reorient.learning.recipes import load_preset; "
        "from reorient.learning.training import train; "
        f"[None for _ in train(load_preset('debug'), {str(small_set)!r}, __import__('pathlib').Path({str(out)!r}), "
        "save_every_s=0)]"
    )
    checkpoint, saved = out / "last.ckpt", None
    for _ in range(2):
        process = subprocess.Popen([sys.executable, "-c", script], start_new_session=True, stderr=subprocess.DEVNULL)
        while not checkpoint.exists() or checkpoint.stat().st_mtime_ns == saved:
            assert process.poll() is None, "it ended before it was killed"
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        saved = checkpoint.stat().st_mtime_ns
    run(DEBUG, small_set, out)
    assert same(weights(out), weights(trained[0]))


@pytest.mark.parametrize("empty", [False, True])
def test_killed_between_metrics_and_checkpoint_it_has_each_epoch_once(trained, small_set, tmp_path, empty):
    out = tmp_path / "run"
    shutil.copytree(trained[0], out)
    (out / "last.ckpt").unlink()
    if empty:
        (out / "metrics.csv").write_text("")
    run(DEBUG, small_set, out)
    assert [int(row["epoch"]) for row in rows(out)] == [0, 1]
    assert same(weights(out), weights(trained[0]))


def test_a_finished_run_does_nothing_more(trained, small_set):
    out, _ = trained
    before = (out / "metrics.csv").read_bytes()
    assert run(DEBUG, small_set, out) == []
    assert (out / "metrics.csv").read_bytes() == before


def test_it_stops_when_validation_stays_flat(small_set, tmp_path):
    """At the first epoch whose error is not below all before: nothing changes here but batch norm."""
    run(replace(DEBUG, epochs=8, patience=1, lr=1e-9), small_set, tmp_path / "run")
    errors = [float(row["validation_deg"]) for row in rows(tmp_path / "run")]
    assert 2 <= len(errors) < 8
    assert all(b < a for a, b in pairwise(errors[:-1]))
    assert errors[-1] >= min(errors[:-1])


def test_test_objects_are_never_read_and_validation_objects_are_not_trained_on(trained, small_set, tmp_path):
    """Test objects whose images are empty, which no batch can be made of, and validation objects with other images."""
    pairs = tmp_path / "pairs"
    shutil.copytree(small_set, pairs)
    parts = split(PairReader(small_set).names)
    group = zarr.open_group(pairs, mode="r+")
    for k in parts.test:
        group["current"][6 * k : 6 * k + 6] = 0
    for k in parts.validation:
        group["current"][6 * k : 6 * k + 6] = group["goal"][6 * k : 6 * k + 6]
    run(DEBUG, pairs, tmp_path / "run")
    networks = [torch.load(out / "last.ckpt", weights_only=True)["network"] for out in (tmp_path / "run", trained[0])]
    assert same(*networks)
    measured = [[row["validation_deg"] for row in rows(out)] for out in (tmp_path / "run", trained[0])]
    assert all(a != b for a, b in zip(*measured, strict=True))
    with pytest.raises(ReorientError, match="an image without returns"):
        prepare(PairReader(pairs).read(np.arange(6 * parts.test[0], 6 * parts.test[0] + 6)), PairReader(pairs))


def test_warm_start_does_without_the_first_epoch_of_mean_loss(trained, small_set, tmp_path):
    config = replace(DEBUG, loss="chord", epochs=1, lr=1e-9)
    losses = {}
    for name, warm_start in (("fresh", None), ("warm", trained[0] / "best.safetensors")):
        run(config, small_set, tmp_path / name, warm_start=warm_start)
        with (tmp_path / name / "metrics.csv").open() as file:
            losses[name] = float(next(csv.DictReader(file))["validation_loss"])
    assert losses["fresh"] < 0.02  # 1 - <q, q_hat> goes with the square of the angle,
    assert losses["warm"] > 0.05  # |q - q_hat| with half of it


def test_warm_start_begins_with_those_weights(trained, small_set, tmp_path):
    config = replace(DEBUG, epochs=1, lr=1e-9)
    half = {key: value.half() if value.is_floating_point() else value for key, value in weights(trained[0]).items()}
    save_file(half, tmp_path / "half.safetensors")
    run(config, small_set, tmp_path / "run", warm_start=tmp_path / "half.safetensors")
    export("paper", trained[0] / "best.safetensors", tmp_path / "compact.onnx", compact=True)
    run(config, small_set, tmp_path / "again", warm_start=tmp_path / "compact.onnx")
    for key in ("embed.6.weight", "embed.4.second.1.weight"):
        for name in ("run", "again"):
            assert torch.allclose(weights(tmp_path / name)[key], weights(trained[0])[key], atol=1e-3)


def test_misfits_are_refused(trained, small_set, tmp_path):
    with pytest.raises(ReorientError, match="holds a training of another config: expected a new folder"):
        run(replace(DEBUG, seed=1), small_set, trained[0])
    with pytest.raises(ReorientError, match=r"cannot load weights .* expected the network's own"):
        run(replace(DEBUG, network="swift"), small_set, tmp_path / "a", warm_start=trained[0] / "best.safetensors")
    (tmp_path / "torn.safetensors").write_bytes((trained[0] / "best.safetensors").read_bytes()[:1000])
    with pytest.raises(ReorientError, match=r"cannot load weights .* expected the network's own"):
        run(DEBUG, small_set, tmp_path / "b", warm_start=tmp_path / "torn.safetensors")
    whole = (trained[0] / "last.ckpt").read_bytes()
    for content in (b"", b"no checkpoint", whole[:1000], whole[: len(whole) // 2]):
        (tmp_path / "torn.ckpt").write_bytes(content)
        with pytest.raises(ReorientError, match=r"cannot load weights .* expected the network's own"):
            load_weights(build("paper"), tmp_path / "torn.ckpt")
    with pytest.raises(ReorientError, match="no pairs in .*: expected what `reorient generate` wrote"):
        run(DEBUG, tmp_path / "nothing", tmp_path / "c")
    with pytest.raises(ReorientError, match=r"unknown training preset 'swfit': .* \(did you mean 'swift'\?\)"):
        load_preset("swfit")
    with pytest.raises(ReorientError, match="expected a number above 0 and below 1"):
        Training(lr=-1)


def test_a_run_of_which_a_file_is_torn_or_another_s_is_refused(trained, small_set, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(trained[0], out)
    whole = (out / "last.ckpt").read_bytes()
    torch.save({"state_dict": {}}, tmp_path / "foreign.ckpt")
    state = torch.load(trained[0] / "last.ckpt", weights_only=True)
    torch.save(state | {"optimizer": {"state": {}, "param_groups": []}}, tmp_path / "other.ckpt")
    foreign = [(tmp_path / name).read_bytes() for name in ("foreign.ckpt", "other.ckpt")]
    for content in (b"", b"no checkpoint", whole[: len(whole) // 2], *foreign):
        (out / "last.ckpt").write_bytes(content)
        with pytest.raises(ReorientError, match=r"cannot load weights .* expected what this training saved, or a new"):
            run(DEBUG, small_set, out)
    for content in ('{"training": ', "[1]", "3"):
        (out / "config.json").write_text(content)
        with pytest.raises(ReorientError, match="broken .*config.json.* expected the config of a run"):
            run(DEBUG, small_set, out)
    (out / "config.json").write_text("[]")
    with pytest.raises(ReorientError, match="holds a training of another config"):
        run(DEBUG, small_set, out)


def test_a_second_training_in_the_folder_is_refused(small_set, tmp_path):
    first = train(DEBUG, small_set, tmp_path / "run")
    next(first)
    with pytest.raises(ReorientError, match="another process is writing into .*run'"):
        run(DEBUG, small_set, tmp_path / "run")
    first.close()


def test_schedules():
    paper, swift = load_preset("paper"), load_preset("swift")
    assert [lr_at(paper, epoch, 0.5) for epoch in (0, 4, 5, 10)] == pytest.approx([3e-4, 3e-4, 2.7e-4, 2.43e-4])
    rates = [lr_at(swift, epoch, 0.0) for epoch in range(swift.epochs)]
    assert rates[0] < rates[1] > rates[-1]
    assert all(a > b for a, b in pairwise(rates[1:]))


TWO = """
import sys, torch
from dataclasses import replace
from pathlib import Path
from reorient.learning.pair_reader import PairReader
from reorient.learning.recipes import load_preset
from reorient.learning.training import _launch, _Run
from reorient.world.objects import split

torch.set_num_threads(1)
pairs, out, batch = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
config = replace(load_preset("debug"), batch=batch, epochs=3, lr=3e-4, loss="mean", dropout=0.0)
out.mkdir(exist_ok=True)
fabric, reader = _launch(config, out), PairReader(pairs)
run = _Run(config, reader, split(reader.names), out, fabric, None)

def keep(name):
    torch.save(dict(run.network.module.named_parameters()), out / f"{name}-{fabric.global_rank}.pt")

keep("begun")
for _ in range(3):
    list(run.epoch(1e9))
keep("together")
if fabric.world_size > 1:  # the fault that the comparison must find: each process follows its own gradients
    run.network._forward_module.require_backward_grad_sync = False
    list(run.epoch(1e9))
    keep("apart")
"""


def test_two_processes_average_their_gradients_as_one_with_the_double_batch(small_set, tmp_path):
    """The losses not to the last digit: each process normalises its own part of the batch."""
    (tmp_path / "two.py").write_text(TWO)
    begin = [sys.executable, tmp_path / "two.py", small_set]
    subprocess.run([*begin, tmp_path / "one", "8"], check=True)
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    subprocess.run([*launch, tmp_path / "two.py", small_set, tmp_path / "two", "4"], check=True)
    kept = {
        name: [torch.load(tmp_path / "two" / f"{name}-{rank}.pt") for rank in (0, 1)]
        for name in ("begun", "together", "apart")
    }
    assert same(*kept["begun"])
    assert same(*kept["together"])
    assert not same(*kept["apart"])  # the processes read different pairs
    assert not same(kept["begun"][0], kept["together"][0])
    one, two = ([float(row["loss"]) for row in rows(tmp_path / name)[:3]] for name in ("one", "two"))
    assert len(one) == len(two) == 3
    assert two == pytest.approx(one, rel=0.35)
    assert [row["pairs"] for row in rows(tmp_path / "one")] == [row["pairs"] for row in rows(tmp_path / "two")[:3]]
