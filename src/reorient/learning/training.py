"""Training of the networks on a pair set (paper, "Training Details"), with lightning-fabric.

A run folder holds config.json (config, commit), metrics.csv, a TensorBoard log, ``last.ckpt`` (everything that an exact
resume needs) and ``best.safetensors``: the weights with the least error on the validation objects, which are a part of
the training objects. Test objects are never read.
"""

import csv
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import torch
from lightning_fabric import Fabric
from lightning_fabric.loggers.tensorboard import TensorBoardLogger
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.utils.data import DataLoader

from reorient.errors import ReorientError
from reorient.learning import losses
from reorient.learning.batches import Augmentation, Batches
from reorient.learning.network import build
from reorient.learning.pair_reader import PairReader
from reorient.learning.recipes import LossName, Training, lr_at
from reorient.learning.weights import last_state, load_weights, loading
from reorient.runs.files import locked, make_folder, replacing
from reorient.runs.provenance import commit, read_record
from reorient.world.objects import Split, split

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
    """Progress of a training. ``validation_deg`` is given after the last step of an epoch."""

    epoch: int
    step: int
    steps: int
    """Steps of the whole run, unless it stops early."""
    loss: float
    pairs_per_second: float
    validation_deg: float | None = None
    best: bool = False


LossFunction = Callable[[Tensor, dict[str, Tensor], Tensor, Tensor], Tensor]


def train(
    config: Training, pairs: str | Path, out: Path, warm_start: Path | None = None, save_every_s: float = 120.0
) -> Iterator[Progress]:
    """Train into the folder ``out``; a stopped run of the same config is continued exactly.

    ``warm_start``: initial weights, of a run (.safetensors) or an export (.onnx); hybrid and chord then have no first
    epoch of the mean loss, which is for untrained weights. Several processes and machines: start the command with
    ``torchrun``; each process takes its part of every step's pairs. Raises ReorientError for another config in ``out``,
    for weights that do not fit the network, and where another training is writing into ``out``.
    """
    reader = PairReader(pairs)
    parts = split(reader.names, config.test_objects)
    make_folder(out)
    fabric = _launch(config, out)
    with locked(out / ".lock") if fabric.global_rank == 0 else nullcontext():
        run = _Run(config, reader, parts, out, fabric, warm_start)
        while run.state["epoch"] < config.epochs and not run.state["finished"]:
            yield from run.epoch(save_every_s)


def _launch(config: Training, out: Path) -> Fabric:
    """One process, or as many as torchrun started."""
    logger = TensorBoardLogger(out, name="", version="log")
    processes, here = (int(os.environ.get(name, 1)) for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"))  # torchrun's
    fabric = Fabric(
        accelerator="cpu", strategy="ddp" if processes > 1 else "auto", devices=here, num_nodes=processes // here,
        precision=config.precision, loggers=logger,
    )  # fmt: skip
    fabric.launch()
    return fabric


class _Run:
    """A training in its folder: the network, the optimizer, and the state that a checkpoint holds."""

    def __init__(
        self, config: Training, reader: PairReader, parts: Split, out: Path, fabric: Fabric, warm_start: Path | None
    ) -> None:
        self.config, self.reader, self.parts, self.out, self.fabric = config, reader, parts, out, fabric
        torch.manual_seed(config.seed)
        network = build(config.network, config.dropout)
        if warm_start is not None:
            load_weights(network, warm_start)
        network = cast(Any, network).to(memory_format=torch.channels_last)
        optimizer = torch.optim.Adam(network.parameters(), config.lr, weight_decay=config.weight_decay, fused=True)
        self.network, self.optimizer = fabric.setup(network, optimizer)
        self.state: dict[str, Any] = {
            "epoch": 0, "batch": 0, "loss_sum": 0.0, "seconds": 0.0,
            "best_deg": math.inf, "best_epoch": -1, "finished": False, "warm": warm_start is not None,
        }  # fmt: skip
        _begin(config, reader, out, fabric)
        self.checkpoint = out / "last.ckpt"
        if self.checkpoint.is_file():
            self._resume()
        self.vertices, self.counts = torch.from_numpy(reader.vertices), torch.from_numpy(reader.vertex_count)

    def _resume(self) -> None:
        with loading(self.checkpoint, "what this training saved, or a new folder"):
            saved_state = last_state(self.checkpoint)
            self.network.load_state_dict(saved_state.pop("network"))
            self.optimizer.load_state_dict(saved_state.pop("optimizer"))
            self.state |= saved_state

    def _save(self) -> None:
        if self.fabric.is_global_zero:
            weights = {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}
            with replacing(self.checkpoint) as temporary:
                torch.save(self.state | weights, temporary)

    def epoch(self, save_every_s: float) -> Iterator[Progress]:
        """The remaining steps of the present epoch, then its validation."""
        config, state, epoch = self.config, self.state, self.state["epoch"]
        loss = loss_of(config.loss, first=epoch == 0 and not state["warm"])
        batches = Batches(
            self.reader, self.parts.train, config.batch, (config.seed, epoch), state["batch"],
            (self.fabric.global_rank, self.fabric.world_size), Augmentation(config.rotated, config.noise),
        )  # fmt: skip
        began, rate = time.monotonic(), 0.0  # a run killed after the last step has no step left to time
        for progress in self._steps(batches, loss, began, save_every_s):
            rate = progress.pairs_per_second
            yield progress
        yield self._validate(len(batches), loss, began, rate)
        state |= {
            "epoch": epoch + 1, "batch": 0, "loss_sum": 0.0,
            "finished": epoch + 1 == config.epochs or epoch - state["best_epoch"] >= config.patience,
        }  # fmt: skip
        self._save()

    def _steps(self, batches: Batches, loss: LossFunction, began: float, save_every_s: float) -> Iterator[Progress]:
        """Optimization steps, with checkpoints in between."""
        config, state, fabric = self.config, self.state, self.fabric
        self.network.train()
        saved, first = began, state["batch"]
        for batch in _loader(batches):
            self._step(batch, loss, state["batch"] / len(batches))
            now = time.monotonic()
            rate = (state["batch"] - first) * config.batch * fabric.world_size / (now - began)
            yield Progress(
                state["epoch"], state["epoch"] * len(batches) + state["batch"], config.epochs * len(batches),
                state["loss_sum"] / state["batch"], rate,
            )  # fmt: skip
            if now - saved > save_every_s:
                self._save()
                saved = now

    def _step(self, batch: dict[str, Tensor], loss: LossFunction, share: float) -> None:
        """One optimization step, at this share of the epoch."""
        config, state = self.config, self.state
        # the same dropout wherever the run is resumed
        torch.manual_seed(hash((config.seed, state["epoch"], state["batch"], self.fabric.global_rank)))
        for group in self.optimizer.param_groups:
            group["lr"] = lr_at(config, state["epoch"], share)
        predicted = self.network(batch["images"].to(memory_format=torch.channels_last))
        value = loss(predicted, batch, self.vertices, self.counts)
        self.optimizer.zero_grad()
        self.fabric.backward(value)
        self.optimizer.step()
        state["batch"] += 1
        state["loss_sum"] += value.item()

    def _validate(self, batches: int, loss: LossFunction, began: float, rate: float) -> Progress:
        """Measure the validation pairs, keep the weights if they are the best, and write a row of metrics."""
        config, state, epoch = self.config, self.state, self.state["epoch"]
        pairs = Batches(self.reader, self.parts.validation, config.batch, (config.seed,), limit=config.validation_pairs)
        errors_deg, validation_loss = validate(self.network, pairs, loss, self.vertices, self.counts)
        mean_deg = float(errors_deg.mean())
        better = mean_deg < state["best_deg"]
        if better:
            state |= {"best_deg": mean_deg, "best_epoch": epoch}
            if self.fabric.is_global_zero:
                with replacing(self.out / "best.safetensors") as temporary:
                    save_file({k: v.contiguous() for k, v in self.network.module.state_dict().items()}, temporary)
        state["seconds"] += time.monotonic() - began
        steps = (epoch + 1) * batches
        row = {
            "epoch": epoch, "step": steps, "pairs": steps * config.batch * self.fabric.world_size,
            "seconds": round(state["seconds"], 1), "lr": f"{self.optimizer.param_groups[0]['lr']:.3g}",
            "loss": f"{state['loss_sum'] / state['batch']:.6f}", "validation_deg": f"{mean_deg:.4f}",
            "validation_median_deg": f"{float(errors_deg.median()):.4f}", "validation_loss": f"{validation_loss:.6f}",
        }  # fmt: skip
        if self.fabric.is_global_zero:
            _write_row(self.out, row)
            self.fabric.log_dict({key: float(row[key]) for key in COLUMNS[4:]}, step=steps)
        return Progress(epoch, steps, config.epochs * batches, float(row["loss"]), rate, mean_deg, better)


def loss_of(name: LossName, first: bool = False) -> LossFunction:
    """The loss as a function of predictions, batch, vertices of all objects and their counts.

    ``first``: that of the first epoch of untrained weights.
    """

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
    """Angular errors of all pairs in degrees, and the mean loss."""
    network.eval()
    errors_deg, total = [], 0.0
    for batch in _loader(batches):
        predicted = network(batch["images"].to(memory_format=torch.channels_last))
        errors_deg.append(losses.angle_deg(predicted, batch["quat_wxyz"]))
        total += float(loss(predicted, batch, vertices, counts))
    return torch.cat(errors_deg), total / len(errors_deg)


def _loader(batches: Batches) -> DataLoader[dict[str, Tensor]]:
    """A loader with one process that reads and prepares batches ahead."""
    return DataLoader(batches, batch_size=None, num_workers=1, prefetch_factor=4)


def _begin(config: Training, reader: PairReader, out: Path, fabric: Fabric) -> None:
    described = json.loads(json.dumps({"training": asdict(config), "pairs": asdict(reader.config)}, default=str))
    file = out / "config.json"
    if file.is_file():
        if {k: v for k, v in read_record(file).items() if k in described} != described:
            raise ReorientError(f"{str(out)!r} holds a training of another config: expected a new folder")
    elif fabric.is_global_zero:
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(described | {"commit": commit()}, indent=1), encoding="utf-8")


def _write_row(out: Path, row: dict[str, Any]) -> None:
    """Add a row to the metrics, without those of its own and later epochs that a killed run left."""
    file = out / "metrics.csv"
    rows: list[dict[str, Any]] = []
    if file.is_file():
        with file.open(encoding="utf-8", newline="") as handle:
            rows = [x for x in csv.DictReader(handle) if int(x["epoch"]) < row["epoch"]]
    with replacing(file) as temporary, temporary.open("w", encoding="utf-8", newline="") as handle:
        writer = csv.DictWriter(handle, COLUMNS)
        writer.writeheader()
        writer.writerows([*rows, row])
