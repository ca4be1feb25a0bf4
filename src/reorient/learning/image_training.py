"""Training of the verifier on images, on one thread: resumable, and able to begin with earlier weights.

A run folder holds ``config.json``, ``metrics.csv`` and ``last.ckpt``; ``finish`` calibrates the network and writes its
ONNX file. Objects that are not trained on calibrate and test it.
"""

import csv
import json
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from jaxtyping import Bool, Float, Int

from reorient.errors import check_range
from reorient.estimators.image_evidence import CHANNELS, SIZE
from reorient.estimators.search import EFFORTS
from reorient.estimators.verifier import FEATURES
from reorient.learning.image_network import ImageNetwork, loss
from reorient.learning.image_sets import ImageSets, batch_of
from reorient.learning.trees import fit_platt
from reorient.learning.weights import last_state, loading
from reorient.runs.files import make_folder, replacing
from reorient.runs.provenance import keep_record, run_record


@dataclass(frozen=True)
class ImageTraining:
    """Settings of the training of the verifier on images."""

    rounds: int = 40
    """Rounds of the whole run; each ends with a checkpoint and the figures of the held-out objects."""
    steps: int = 200
    """Steps of a round."""
    sets: int = 24
    """Sets of hypotheses in a step."""
    lr: float = 2e-3
    """Largest learning rate; it rises in the first round and falls to 0 as a cosine."""
    decay: float = 0.02
    """Weight decay."""
    held_out: float = 0.2
    """Share of the objects that calibrate and test the network."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "rounds", "steps", "sets", low=1)
        check_range(self, "lr", "decay")
        check_range(self, "held_out", high=1, below=True)


@dataclass(frozen=True)
class Round:
    """Figures after a round."""

    number: int
    rounds: int
    seconds: float
    loss: float
    """Of the training sets."""
    held_out_loss: float
    right: float
    """Share of the held-out sets whose chosen hypothesis is right."""
    right_by_trees: float
    right_at_best: float
    """Share of the held-out sets with a right hypothesis."""


class Run:
    """A training in a folder, from its last checkpoint on."""

    def __init__(self, data: ImageSets, out: Path, config: ImageTraining, start: Path | None = None) -> None:
        """``start``: checkpoint (.ckpt) of another run, whose weights this one begins with. Raises ReorientError where
        the folder holds a run of another config or other data, and for weights of another network."""
        torch.set_num_threads(1)
        self.data, self.out, self.config = data, out, config
        apart = data.held_out(config.held_out)
        self.training_sets, self.held_out_sets = np.nonzero(~apart)[0], np.nonzero(apart)[0]
        make_folder(out)
        described = run_record(config, sets=len(data), hypotheses=len(data.log_odds), start=start and str(start))
        keep_record(out / "config.json", described, ("config", "sets", "hypotheses", "start"))
        torch.manual_seed(0)
        self.network = ImageNetwork(len(FEATURES))
        rows = data.features[data.rows(self.training_sets)]
        self.network.mean.copy_(torch.from_numpy(rows.mean(axis=0)))
        self.network.deviation.copy_(torch.from_numpy(rows.std(axis=0) + 1e-6))
        self.optimizer = torch.optim.AdamW(self.network.parameters(), config.lr, weight_decay=config.decay)
        self.rounds: list[Round] = []
        if (file := out / "last.ckpt").is_file():
            with loading(file, "the checkpoint of this run"):
                state = last_state(file)
                self.network.load_state_dict(state["network"])
                self.optimizer.load_state_dict(state["optimizer"])
                self.rounds = [Round(**x) for x in json.loads(state["rounds"])]
        elif start is not None:
            with loading(start, "the checkpoint of a training of the verifier on images"):
                self.network.load_state_dict(last_state(start)["network"])

    def go_on(self) -> Iterator[Round]:
        """The rounds that are left."""
        while len(self.rounds) < self.config.rounds:
            self.rounds.append(self._round(len(self.rounds)))
            state = {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}
            with replacing(self.out / "last.ckpt") as temporary:
                torch.save(state | {"rounds": json.dumps([asdict(x) for x in self.rounds])}, temporary)
            with replacing(self.out / "metrics.csv") as temporary, temporary.open("w", newline="") as handle:
                writer = csv.DictWriter(handle, list(asdict(self.rounds[0])))
                writer.writeheader()
                writer.writerows(asdict(x) for x in self.rounds)
            yield self.rounds[-1]

    def _round(self, number: int) -> Round:
        begin, config, total = time.monotonic(), self.config, 0.0
        rng = np.random.default_rng([1, number])
        self.network.train()
        for step in range(config.steps):
            done = (number * config.steps + step) / (config.rounds * config.steps)
            rate = config.lr * min((number * config.steps + step + 1) / config.steps, 1)
            self.optimizer.param_groups[0]["lr"] = rate * (1 + math.cos(math.pi * done)) / 2
            chosen = rng.choice(self.training_sets, min(config.sets, len(self.training_sets)), replace=False)
            images, features, log_odds, right, of = map(torch.from_numpy, batch_of(self.data, chosen, rng))
            answer = loss(self.network(images, features, log_odds, of), right, of, len(chosen))
            self.optimizer.zero_grad()
            answer.backward()
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
            self.optimizer.step()
            total += answer.item()
        held = self.held_out_sets
        log_odds = self.log_odds(held)
        rows = self.data.rows(held)
        of = np.repeat(np.arange(len(held)), self.data.sizes[held])
        right = self.data.right[rows]
        figures = selection(of, right, log_odds), selection(of, right, self.data.log_odds[rows])
        held_loss = float(loss(*map(torch.from_numpy, (log_odds, right, of)), len(held)))
        seconds = time.monotonic() - begin
        best = selection(of, right, right.astype(float))
        return Round(
            number + 1, config.rounds, round(seconds, 1), total / config.steps, held_loss,
            *(float(x.mean()) for x in (*figures, best)),
        )  # fmt: skip

    def log_odds(self, sets: Int[np.ndarray, " b"]) -> Float[np.ndarray, " m"]:
        """The network's log-odds of the hypotheses of some sets."""
        return log_odds_of(self.network, self.data, sets)


@torch.inference_mode()
def log_odds_of(network: ImageNetwork, data: ImageSets, sets: Int[np.ndarray, " b"]) -> Float[np.ndarray, " m"]:
    """A network's log-odds of the hypotheses of some sets, one set after the other."""
    network.eval()
    parts = []
    for begin in range(0, len(sets), 64):
        images, features, log_odds, _, of = map(torch.from_numpy, batch_of(data, sets[begin : begin + 64], None))
        parts.append(network(images, features, log_odds, of).numpy())
    return np.concatenate(parts)


def selection(
    of: Int[np.ndarray, " n"], right: Bool[np.ndarray, " n"], score: Float[np.ndarray, " n"]
) -> Bool[np.ndarray, " s"]:
    """Whether the row with the highest score of each set is right."""
    return right[best_of(of, score)]


def best_of(of: Int[np.ndarray, " n"], score: Float[np.ndarray, " n"]) -> Int[np.ndarray, " s"]:
    """The row with the highest score of each set."""
    order = np.lexsort((-score, of))
    return order[np.unique(of, return_index=True)[1]]


def finish(run: Run, out: Path, others: Mapping[str, ImageSets] | None = None) -> dict[str, tuple[float, float]]:
    """Calibrate the network on the held-out objects and write it (.onnx); returns scale and shift by effort.

    ``others``: data of other efforts, of other objects; an effort without data is calibrated as "normal".
    """
    held = {"normal": (run.data, run.held_out_sets)}
    held |= {effort: (data, np.arange(len(data))) for effort, data in (others or {}).items()}
    calibration = {}
    for effort, (data, sets) in held.items():
        log_odds, rows = log_odds_of(run.network, data, sets), data.rows(sets)
        chosen = best_of(np.repeat(np.arange(len(sets)), data.sizes[sets]), log_odds)
        calibration[effort] = fit_platt(log_odds[chosen], data.right[rows][chosen])
    calibration = {effort: calibration.get(effort, calibration["normal"]) for effort in EFFORTS}
    export(run.network, out, calibration)
    return calibration


def export(network: ImageNetwork, out: Path, calibration: Mapping[str, tuple[float, float]]) -> None:
    """Write a network for one set of any number of hypotheses, with its calibration (.onnx)."""
    several = {0: torch.export.Dim("n")}
    images = torch.zeros(3, 2, len(CHANNELS), SIZE, SIZE, dtype=torch.uint8)
    program = torch.onnx.export(
        network.eval(),
        (images, torch.zeros(3, len(FEATURES)), torch.zeros(3)),
        input_names=["images", "features", "log_odds"],
        output_names=["verified"],
        dynamic_shapes=(several, several, several),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    proto = program.model_proto
    for key, value in {"features": FEATURES, "calibration": dict(calibration)}.items():
        proto.metadata_props.add(key=key, value=json.dumps(value))
    with replacing(out) as temporary:
        onnx.save(proto, temporary)
