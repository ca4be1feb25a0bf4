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
from jaxtyping import Float, Int

from reorient.estimators.image_evidence import CHANNELS, SIZE
from reorient.estimators.verifier import FEATURES
from reorient.learning.image_network import ImageNetwork, loss
from reorient.learning.image_sets import ImageSets, batch_of
from reorient.learning.recipes import ImageTraining
from reorient.learning.trees import fit_platt
from reorient.learning.weights import last_state, loading
from reorient.runs.files import make_folder, replacing
from reorient.runs.provenance import keep_record, run_record


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

    @property
    def line(self) -> str:
        """The figures as a line of text."""
        return (
            f"round {self.number}/{self.rounds}: loss {self.loss:.4f}, held-out {self.held_out_loss:.4f}, right "
            f"{self.right:.1%} (trees {self.right_by_trees:.1%}, best {self.right_at_best:.1%}), {self.seconds:.0f} s"
        )


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
        self.network = ImageNetwork(len(FEATURES), config.dropout)
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
            with (
                replacing(self.out / "metrics.csv") as temporary,
                temporary.open("w", encoding="utf-8", newline="") as handle,
            ):
                writer = csv.DictWriter(handle, list(asdict(self.rounds[0])))
                writer.writeheader()
                writer.writerows(asdict(x) for x in self.rounds)
            yield self.rounds[-1]

    def _round(self, number: int) -> Round:
        begin, config, total = time.monotonic(), self.config, 0.0
        rng = np.random.default_rng([1, number])
        torch.manual_seed(number)  # of the dropout
        self.network.train()
        for step in range(config.steps):
            done = (number * config.steps + step) / (config.rounds * config.steps)
            rate = config.lr * min((number * config.steps + step + 1) / config.steps, 1)
            self.optimizer.param_groups[0]["lr"] = rate * (1 + math.cos(math.pi * done)) / 2
            chosen = rng.choice(self.training_sets, min(config.sets, len(self.training_sets)), replace=False)
            images, features, log_odds, labels, of_set = map(torch.from_numpy, batch_of(self.data, chosen, rng))
            with torch.autocast("cpu", torch.bfloat16):
                verified = self.network(images, features, log_odds, of_set)
            answer = loss(verified.float(), labels, of_set, len(chosen))
            self.optimizer.zero_grad()
            answer.backward()
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
            self.optimizer.step()
            total += answer.item()
        answers = log_odds_of(self.network, self.data, self.held_out_sets)
        rows, of = self.held_out_rows
        right = self.data.right[rows]
        shares = [
            float(right[best_of(of, score)].mean())
            for score in (answers, self.data.log_odds[rows], right.astype(float))
        ]
        sets = len(self.held_out_sets)
        held_out = loss(torch.from_numpy(answers), torch.from_numpy(right), torch.from_numpy(of), sets)
        seconds = round(time.monotonic() - begin, 1)
        return Round(number + 1, config.rounds, seconds, total / config.steps, held_out.item(), *shares)

    @property
    def held_out_rows(self) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
        """The rows of the held-out sets, and the number of the set of each."""
        sets = self.held_out_sets
        return self.data.rows(sets), np.repeat(np.arange(len(sets)), self.data.sizes[sets])

    def compared(self) -> list[dict[str, float]]:
        """By the least angle of the pairs: held-out sets, share right by the network, by the trees and at best, and
        the sets that only the network (won) or only the trees (lost) get right."""
        rows, of = self.held_out_rows
        right, angle_deg = self.data.right[rows], self.data.angle_deg[rows]
        answers = log_odds_of(self.network, self.data, self.held_out_sets)
        network, trees, best = (
            right[best_of(of, score)] for score in (answers, self.data.log_odds[rows], right.astype(float))
        )
        figures = []
        for least_deg in np.unique(angle_deg):
            of_range = angle_deg[best_of(of, answers)] == least_deg
            figures.append(
                {
                    "from_deg": float(least_deg),
                    "sets": int(of_range.sum()),
                    **{
                        name: float(x[of_range].mean())
                        for name, x in (("right", network), ("trees", trees), ("best", best))
                    },
                    "won": int((network & ~trees)[of_range].sum()),
                    "lost": int((trees & ~network)[of_range].sum()),
                }
            )
        return figures


@torch.inference_mode()
def log_odds_of(network: ImageNetwork, data: ImageSets, sets: Int[np.ndarray, " b"]) -> Float[np.ndarray, " m"]:
    """A network's log-odds of the hypotheses of some sets, one set after the other."""
    network.eval()
    parts = []
    for begin in range(0, len(sets), 64):
        images, features, log_odds, _, of = map(torch.from_numpy, batch_of(data, sets[begin : begin + 64], None))
        parts.append(network(images, features, log_odds, of).numpy())
    return np.concatenate(parts)


def best_of(of: Int[np.ndarray, " n"], score: Float[np.ndarray, " n"]) -> Int[np.ndarray, " s"]:
    """The row with the highest score of each set."""
    order = np.lexsort((-score, of))
    return order[np.unique(of, return_index=True)[1]]


def finish(run: Run, out: Path, others: Mapping[str, ImageSets] | None = None) -> dict[str, tuple[float, float]]:
    """Calibrate the network on the held-out objects and write it (.onnx); returns scale and shift by effort.

    ``others``: data of other efforts, of other objects; after a search of an effort without data the trees decide.
    """
    held = {"normal": (run.data, run.held_out_sets)}
    held |= {effort: (data, np.arange(len(data))) for effort, data in (others or {}).items()}
    calibration = {}
    for effort, (data, sets) in held.items():
        log_odds, rows = log_odds_of(run.network, data, sets), data.rows(sets)
        chosen = best_of(np.repeat(np.arange(len(sets)), data.sizes[sets]), log_odds)
        calibration[effort] = fit_platt(log_odds[chosen], data.right[rows][chosen])
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
