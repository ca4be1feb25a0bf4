"""Training recipes: the paper's, that of swift, a tiny one for tests, that of the verifier on images.

No torch here: the CLI imports this file.
"""

import math
from dataclasses import dataclass
from typing import Literal

from reorient.errors import check_counts, check_range, unknown_name

NetworkName = Literal["paper", "swift"]
LossName = Literal["mean", "shapematch", "hybrid", "chord"]


@dataclass(frozen=True)
class Training:
    """Settings of the training.

    The defaults are the paper's, except the learning rate.
    """

    network: NetworkName = "paper"
    """Network: the paper's siamese ResNet-9, or swift, which takes both images at once."""
    loss: LossName = "hybrid"
    """Loss: mean, shapematch, hybrid (mean in the first epoch, then shapematch) or chord (mean in the first epoch, then
    the quaternion distance). A warm start omits that epoch."""
    epochs: int = 100
    """Largest number of epochs, which the patience may shorten."""
    batch: int = 64
    """Number of pairs in a step of one process."""
    lr: float = 0.0003
    """Learning rate. With the paper's 0.002 the network still predicted no rotation after 250,000 pairs."""
    schedule: Literal["steps", "cosine"] = "steps"
    """Learning rate over time: steps multiplies it by 0.9 every 5 epochs, cosine lowers it to 0 after a warm-up."""
    weight_decay: float = 1e-9
    """Weight of the l2 penalty."""
    dropout: float = 0.4
    """Share of the head's units left out in a step. The paper's 0.4 increases the error (RESULTS.md)."""
    patience: int = 10
    """Number of epochs without a better validation error after which the training stops."""
    test_objects: int | None = None
    """Number of objects kept for testing, chosen by a hash of the name, by default a fifth."""
    validation_pairs: int = 4096
    """Number of pairs of other objects that are measured after each epoch."""
    precision: Literal["bf16-mixed", "32-true"] = "bf16-mixed"
    """Precision: bf16-mixed computes products in bfloat16, 32-true everything in float32."""
    rotated: float = 0.0
    """Share of pairs whose current image is rotated by a nearly correct estimate first, as in an iterated estimate."""
    noise: float = 0.0
    """Largest standard deviation of the depth noise added in training, relative to the width of the view."""
    seed: int = 0
    """Seed of the first weights, the order of the pairs and the augmentation."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values outside their range."""
        check_counts(self, "epochs", "batch", "patience", "validation_pairs")
        check_range(self, "seed", "noise", "weight_decay")
        check_range(self, "rotated", high=1)
        check_range(self, "dropout", high=1, below=True)
        check_range(self, "lr", high=1, above=True, below=True)


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
    decay: float = 0.1
    """Weight decay."""
    dropout: float = 0.3
    """Share of the last layers' inputs left out in a step."""
    held_out: float = 0.2
    """Share of the objects that calibrate and test the network."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "rounds", "steps", "sets", low=1)
        check_range(self, "lr", "decay")
        check_range(self, "dropout", "held_out", high=1, below=True)


PRESETS = {
    "paper": Training(),
    "swift": Training(
        "swift",
        "chord",
        epochs=12,
        batch=64,
        lr=0.0005,
        schedule="cosine",
        weight_decay=1e-5,
        dropout=0.1,
        patience=12,
        rotated=0.6,
        noise=0.01,
    ),
    "debug": Training(epochs=2, batch=8, validation_pairs=16, precision="32-true"),
}


def load_preset(name: str) -> Training:
    """A preset by name. Raises ReorientError for an unknown one."""
    if name not in PRESETS:
        raise unknown_name("training preset", name, list(PRESETS))
    return PRESETS[name]


def lr_at(config: Training, epoch: int, share: float) -> float:
    """Learning rate in an epoch (from 0), of which the share ``share`` is complete."""
    if config.schedule == "steps":
        return config.lr * 0.9 ** (epoch // 5)
    done = (epoch + share) / config.epochs
    return config.lr * min(1.0, (done + 1e-4) / 0.02) * (1 + math.cos(math.pi * done)) / 2
