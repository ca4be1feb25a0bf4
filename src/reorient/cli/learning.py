"""The learning verbs: generate pairs, train a network on them, export its weights. They need the extra ``train``."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from reorient.cli.arguments import Positional, Presets
from reorient.cli.progress import show_progress
from reorient.errors import check_range
from reorient.extras import require
from reorient.learning.recipes import PRESETS, NetworkName, Training
from reorient.runs.files import make_folder
from reorient.runs.pool import Pool
from reorient.world.pairs import PairSet


@dataclass(frozen=True)
class Generate:
    """Generate pairs of depth images with known rotations for training.

    The first line of the output states duration and size. An interrupted run can be continued.

    Examples:
        reorient generate data/full --count 872 --object-seed 2020
        reorient generate data/own --meshes my_meshes --pairs-per-object 400
    """

    out: Positional[str]
    """Folder or fsspec URL (s3://..., gs://...) to write to."""
    config: PairSet = field(default_factory=PairSet)
    pool: Pool = field(default_factory=lambda: Pool(-1))

    def run(self) -> None:
        """Print duration and size, then generate."""
        require("zarr")
        from reorient.learning.pair_store import estimate_cost, generate

        cost = estimate_cost(self.config, self.out, self.pool)
        free = "" if cost.free_bytes is None else f" of {cost.free_bytes / 1e9:.0f} GB free"
        print(
            f"{cost.pairs} pairs: about {cost.seconds / 60:.1f} minutes and {cost.bytes / 1e9:.2f} GB{free}",
            flush=True,
        )
        states = generate(self.config, self.out, self.pool)
        show_progress("pairs", ((state.done, state.total) for state in states))
        print(self.out)


@dataclass(frozen=True)
class Train:
    """Train a network on generated pairs.

    RECIPE chooses the settings that the options then change. An interrupted run continues exactly where it stopped.

    Examples:
        reorient train data/full runs/paper paper
        reorient train data/own runs/own swift --warm-start swift.safetensors --epochs 10
        torchrun --nnodes 2 --nproc-per-node 2 -m reorient train data/full runs/paper paper
    """

    pairs: Positional[str]
    """Folder or URL that ``reorient generate`` wrote."""
    out: Positional[Path]
    """Folder for the weights, the log and the configuration."""
    recipe: Annotated[Training, Presets(PRESETS)] = PRESETS["paper"]
    """Settings of the training: paper, swift or debug."""
    warm_start: Path | None = None
    """Weights to start from (.safetensors or .onnx)."""
    threads: int | None = None
    """Number of threads of torch in each process, by default its own choice."""

    def __post_init__(self) -> None:
        """Raises ReorientError for a number of threads below 1."""
        check_range(self, "threads", low=1, high=1024)

    def run(self) -> None:
        """Train, and print loss and validation error of each epoch."""
        require("torch", "lightning_fabric", "zarr", "safetensors", "tensorboard")
        import torch

        from reorient.learning.training import train

        if self.threads is not None:
            torch.set_num_threads(self.threads)

        def states() -> Iterator[tuple[int, int, str]]:
            validation = ""
            for state in train(self.recipe, self.pairs, self.out, self.warm_start):
                if state.validation_deg is not None:
                    validation = f", validation {state.validation_deg:.2f} deg"
                    print(
                        f"epoch {state.epoch + 1}: loss {state.loss:.5f}{validation}{' (best)' * state.best}",
                        flush=True,
                    )
                text = (
                    f"epoch {state.epoch + 1}: loss {state.loss:.5f}, {state.pairs_per_second:.0f} pairs/s{validation}"
                )
                yield state.step, state.steps, text

        show_progress("training", states())
        print(self.out / "best.safetensors")


@dataclass(frozen=True)
class Export:
    """Convert trained weights to ONNX, which the estimators read.

    Examples:
        reorient export runs/swift/best.safetensors swift.onnx --network swift --compact
    """

    weights: Positional[Path]
    """Weights of a training run (.safetensors)."""
    out: Positional[Path]
    """File to write (.onnx)."""
    network: NetworkName = "paper"
    """Network that the weights are of."""
    compact: bool = False
    """Store the weights as float16, for half the size. The arithmetic stays float32."""

    def run(self) -> None:
        """Read and write."""
        require("torch", "onnx", "onnxscript", "safetensors")
        from reorient.learning.export import export

        make_folder(self.out.parent)
        export(self.network, self.weights, self.out, self.compact)
        print(self.out)
