"""Training of the networks on a pair set (paper, "Training Details"), with lightning-fabric.

A run folder holds config.json (config, commit), metrics.csv and a TensorBoard log, ``last.ckpt`` (everything that an
exact resume needs) and ``best.safetensors``: the weights with the least error on validation objects, which are taken
out of the training objects; test objects are never looked at.
"""

import csv
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, cast

import onnx
import torch
from google.protobuf.message import DecodeError
from lightning_fabric import Fabric
from lightning_fabric.loggers import TensorBoardLogger
from onnx import numpy_helper
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.utils.data import DataLoader

from reorient.errors import ReorientError
from reorient.learning import losses
from reorient.learning.batches import Augmentation, Batches
from reorient.learning.network import build
from reorient.learning.pair_store import PairReader
from reorient.learning.recipes import LossName, Training, lr_at
from reorient.runs.files import make_folder, replacing
from reorient.runs.provenance import commit, read_record
from reorient.world.objects import split

HALF = "_half"  # marks weights that an export stores as float16
COLUMNS = [
    "epoch",
    "step",
    "pairs",
    "seconds",
    "lr",
    "loss",
    "validation_deg",
    "validation_median_deg",
    "validation_loss",
]


@dataclass(frozen=True)
class Progress:
    """Where a training is; a validation figure is there after an epoch's last step."""

    epoch: int
    step: int
    steps: int
    """Of the whole run, should it not stop early."""
    loss: float
    pairs_per_second: float
    validation_deg: float | None = None
    best: bool = False


def train(
    config: Training, pairs: str | Path, out: Path, warm_start: Path | None = None, save_every_s: float = 120.0
) -> Iterator[Progress]:
    """Train into the folder ``out``; goes on exactly where an earlier run of the same config stopped.

    ``warm_start``: weights to begin with, of a run (.safetensors) or an export (.onnx); hybrid and chord then do
    without the mean loss of the first epoch, which is for weights that know nothing yet. Several processes and
    machines: start the command with ``torchrun``; each takes its part of every step's pairs. Raises ReorientError for
    another config in ``out``, and for weights that do not fit.
    """
    reader = PairReader(pairs)
    parts = split(reader.names, config.test_objects)
    make_folder(out)
    logger = TensorBoardLogger(out, name="", version="log")
    processes, here = (int(os.environ.get(name, 1)) for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"))  # torchrun's
    fabric = Fabric(
        accelerator="cpu", strategy="ddp" if processes > 1 else "auto", devices=here, num_nodes=processes // here,
        precision=config.precision, loggers=logger,
    )  # fmt: skip
    fabric.launch()
    torch.manual_seed(config.seed)
    network = build(config.network, config.dropout)
    if warm_start is not None:
        load_weights(network, warm_start)
    network = cast(Any, network).to(memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(network.parameters(), config.lr, weight_decay=config.weight_decay, fused=True)
    network, optimizer = fabric.setup(network, optimizer)
    state: dict[str, Any] = {
        "epoch": 0, "batch": 0, "loss_sum": 0.0, "seconds": 0.0,
        "best_deg": math.inf, "best_epoch": -1, "finished": False, "warm": warm_start is not None,
    }  # fmt: skip
    _begin(config, reader, out, fabric)
    last = out / "last.ckpt"
    if last.is_file():
        with _loading(last, "what this training saved, or a new folder"):
            saved_state = _last_state(last)
            network.load_state_dict(saved_state.pop("network"))
            optimizer.load_state_dict(saved_state.pop("optimizer"))
            state |= saved_state
        if fabric.is_global_zero and not state["finished"]:
            _drop_rows_from(out, state["epoch"])
    vertices, counts = torch.from_numpy(reader.vertices), torch.from_numpy(reader.vertex_count)

    def save() -> None:
        if fabric.is_global_zero:
            with replacing(last) as temporary:
                torch.save(state | {"network": network.state_dict(), "optimizer": optimizer.state_dict()}, temporary)

    while state["epoch"] < config.epochs and not state["finished"]:
        epoch = state["epoch"]
        loss_now = loss_of(config.loss, first=epoch == 0 and not state["warm"])
        batches = Batches(
            reader, parts.train, config.batch, (config.seed, epoch), state["batch"], fabric.global_rank,
            fabric.world_size, Augmentation(config.turned, config.noise),
        )  # fmt: skip
        network.train()
        saved = began = time.monotonic()
        first, rate = state["batch"], 0.0  # killed between the last step and the validation, none is left to time
        for batch in _loader(batches):
            torch.manual_seed(
                hash((config.seed, epoch, state["batch"], fabric.global_rank))
            )  # dropout, wherever resumed
            for group in optimizer.param_groups:
                group["lr"] = lr_at(config, epoch, state["batch"] / len(batches))
            predicted = network(batch["images"].to(memory_format=torch.channels_last))
            loss = loss_now(predicted, batch, vertices, counts)
            optimizer.zero_grad()
            fabric.backward(loss)
            optimizer.step()
            state["batch"] += 1
            state["loss_sum"] += loss.item()
            now = time.monotonic()
            rate = (state["batch"] - first) * config.batch * fabric.world_size / (now - began)
            yield Progress(
                epoch, epoch * len(batches) + state["batch"], config.epochs * len(batches),
                state["loss_sum"] / state["batch"], rate,
            )  # fmt: skip
            if now - saved > save_every_s:
                save()
                saved = now
        validation = Batches(reader, parts.validation, config.batch, (config.seed,), limit=config.validation_pairs)
        errors_deg, validation_loss = validate(network, validation, loss_now, vertices, counts)
        mean_deg = float(errors_deg.mean())
        better = mean_deg < state["best_deg"]
        if better:
            state |= {"best_deg": mean_deg, "best_epoch": epoch}
            if fabric.is_global_zero:
                with replacing(out / "best.safetensors") as temporary:
                    save_file({k: v.contiguous() for k, v in network.module.state_dict().items()}, temporary)
        state["seconds"] += time.monotonic() - began
        steps = (epoch + 1) * len(batches)
        row = {
            "epoch": epoch, "step": steps, "pairs": steps * config.batch * fabric.world_size,
            "seconds": round(state["seconds"], 1), "lr": f"{optimizer.param_groups[0]['lr']:.3g}",
            "loss": f"{state['loss_sum'] / state['batch']:.6f}", "validation_deg": f"{mean_deg:.4f}",
            "validation_median_deg": f"{float(errors_deg.median()):.4f}", "validation_loss": f"{validation_loss:.6f}",
        }  # fmt: skip
        if fabric.is_global_zero:
            _append_row(out, row)
            fabric.log_dict({key: float(row[key]) for key in COLUMNS[4:]}, step=steps)
        yield Progress(epoch, steps, config.epochs * len(batches), float(row["loss"]), rate, mean_deg, better)
        state |= {
            "epoch": epoch + 1, "batch": 0, "loss_sum": 0.0,
            "finished": epoch + 1 == config.epochs or epoch - state["best_epoch"] >= config.patience,
        }  # fmt: skip
        save()


LossFunction = Callable[[Tensor, dict[str, Tensor], Tensor, Tensor], Tensor]


def loss_of(name: LossName, first: bool = False) -> LossFunction:
    """The loss, in the first epoch of fresh weights or later, as a function of predictions, batch, all objects'
    vertices and their counts."""

    def shape_match(predicted: Tensor, batch: dict[str, Tensor], vertices: Tensor, counts: Tensor) -> Tensor:
        index = batch["object_index"]
        posed = vertices[index] @ batch["pose"].transpose(1, 2)
        most = int(counts[index].max())
        return losses.shape_match_loss(predicted, batch["quat_wxyz"], posed[:, :most], counts[index])

    if name == "shapematch" or (name == "hybrid" and not first):
        return shape_match
    angular = losses.chord_loss if name == "chord" and not first else losses.mean_loss
    return lambda predicted, batch, vertices, counts: angular(predicted, batch["quat_wxyz"])


@torch.inference_mode()
def validate(
    network: nn.Module, batches: Batches, loss: LossFunction, vertices: Tensor, counts: Tensor
) -> tuple[Tensor, float]:
    """Angle errors in degrees of all pairs, and the mean loss."""
    network.eval()
    errors_deg, total = [], 0.0
    for batch in _loader(batches):
        predicted = network(batch["images"].to(memory_format=torch.channels_last))
        errors_deg.append(losses.angle_deg(predicted, batch["quat_wxyz"]))
        total += float(loss(predicted, batch, vertices, counts))
    return torch.cat(errors_deg), total / len(errors_deg)


def load_weights(network: nn.Module, path: Path) -> None:
    """A run's weights (.safetensors; .ckpt: its last) or an export's (.onnx) into a network. Raises ReorientError where
    they misfit."""
    with _loading(path, "the network's own"):
        if path.suffix == ".ckpt":
            weights = _last_state(path)["network"]
        else:
            weights = _onnx_weights(path) if path.suffix == ".onnx" else load_file(path)
        known = network.state_dict()
        weights |= {key: known[key] for key in known if key.endswith("num_batches_tracked")}  # no export has it
        network.load_state_dict({key: value.to(known[key].dtype) for key, value in weights.items()})


@contextmanager
def _loading(path: Path, expected: str) -> Iterator[None]:
    """Raises ReorientError for a file that is torn or another's, which the loaders say in many ways."""
    try:
        yield
    except (OSError, SafetensorError, DecodeError, KeyError, RuntimeError, ValueError) as error:
        said = str(error).strip().splitlines()[0] if str(error) else type(error).__name__
        raise ReorientError(f"cannot load weights {str(path)!r} ({said}): expected {expected}") from error


def _last_state(path: Path) -> dict[str, Any]:
    try:
        return dict(torch.load(path, weights_only=True))
    except (EOFError, UnpicklingError, TypeError) as error:  # whose advice is to load it unsafely
        raise RuntimeError("no state of a training") from error


def _onnx_weights(path: Path) -> dict[str, Tensor]:
    tensors = onnx.load(path).graph.initializer
    named = {
        tensor.name.removesuffix(HALF): torch.from_numpy(numpy_helper.to_array(tensor).copy()) for tensor in tensors
    }
    return {name: value for name, value in named.items() if "." in name}


def _loader(batches: Batches) -> DataLoader[dict[str, Tensor]]:
    """One process beside the training reads and prepares ahead."""
    return DataLoader(batches, batch_size=None, num_workers=1, prefetch_factor=4)


def _begin(config: Training, reader: PairReader, out: Path, fabric: Fabric) -> None:
    described = json.loads(json.dumps({"training": asdict(config), "pairs": asdict(reader.config)}, default=str))
    file = out / "config.json"
    if file.is_file():
        if {k: v for k, v in read_record(file).items() if k in described} != described:
            raise ReorientError(f"{str(out)!r} holds a training of another config: expected a new folder")
    elif fabric.is_global_zero:
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(described | {"commit": commit()}, indent=1))


def _append_row(out: Path, row: dict[str, Any]) -> None:
    file = out / "metrics.csv"
    new = not file.exists()
    with file.open("a", newline="") as handle:
        writer = csv.DictWriter(handle, COLUMNS)
        if new:
            writer.writeheader()
        writer.writerow(row)


def _drop_rows_from(out: Path, epoch: int) -> None:
    """Rows of epochs that were over but not yet in the checkpoint when a run was killed."""
    file = out / "metrics.csv"
    if file.is_file():
        rows = [row for row in csv.DictReader(file.open()) if int(row["epoch"]) < epoch]
        with replacing(file) as temporary, temporary.open("w", newline="") as handle:
            writer = csv.DictWriter(handle, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)
