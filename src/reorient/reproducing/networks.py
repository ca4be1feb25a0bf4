"""The networks of a figure: pairs drawn, a training run, its weights as ONNX. Needs the extra ``train``.

Every step continues where an earlier one stopped, and is left out where its result exists.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from reorient.extras import extras_named
from reorient.learning.recipes import LossName, Training, load_preset
from reorient.reproducing.setting import Setting
from reorient.runs.files import make_folder
from reorient.world.pairs import PairSet

# that of the weights in the package: with the paper's rate of 0.002, or its dropout of 0.4 on few objects, training
# hardly leaves "no rotation" here (RESULTS.md)
RECIPE = replace(load_preset("paper"), schedule="cosine", lr=0.0005, dropout=0.0)


@dataclass(frozen=True)
class Network:
    """One training."""

    loss: LossName
    epochs: int
    set_name: str
    """Folder of the pairs."""
    pairs: PairSet
    recipe: Training = RECIPE
    test_objects: int | None = None

    @property
    def name(self) -> str:
        """Of its run and of its weights."""
        kept = "" if self.test_objects is None else f"-{self.test_objects}"
        return f"{self.set_name}{kept}-{self.loss}-{self.epochs}"

    @property
    def label(self) -> str:
        """In tables and figures."""
        return f"{self.loss}, {self.epochs} epoch{'s' * (self.epochs > 1)}"

    @property
    def training(self) -> Training:
        """The recipe; no run stops early, so that all have the same budget."""
        return replace(
            self.recipe, loss=self.loss, epochs=self.epochs, patience=self.epochs, test_objects=self.test_objects
        )

    @property
    def kept(self) -> str:
        """Which weights of the run: the best on validation objects; of ShapeMatch alone the last, as the question is
        what becomes of them."""
        return "last.ckpt" if self.loss == "shapematch" else "best.safetensors"

    def weights(self, setting: Setting) -> Path:
        """Where its exported weights are."""
        return setting.data / "weights" / f"{self.name}.onnx"


def make_network(network: Network, setting: Setting, keep: Path) -> None:
    """Whatever is missing of pairs, training and export; the run's metrics are copied to the folder ``keep``."""
    run, weights = setting.data / "runs" / network.name, network.weights(setting)
    if not weights.is_file():
        pairs = _pairs(network, setting)
        from reorient.learning.export import export
        from reorient.learning.training import train

        def states() -> Iterator[tuple[int, int, str]]:
            validation = ""
            for state in train(network.training, pairs, run):
                if state.validation_deg is not None:
                    validation = f", validation {state.validation_deg:.2f}°"
                yield state.step, state.steps, f"{network.name}: {state.pairs_per_second:.0f} pairs/s{validation}"
            yield 1, 1, network.name  # a finished run has no states

        setting.progress(network.name, states())
        make_folder(weights.parent)
        export(network.training.network, run / network.kept, weights, compact=True)
    if run.is_dir():
        shutil.copyfile(run / "metrics.csv", make_folder(keep) / f"{network.name}.csv")


def _pairs(network: Network, setting: Setting) -> Path:
    with extras_named():
        from reorient.learning.pair_store import generate
    path = make_folder(setting.data / "pairs") / network.set_name
    states = generate(network.pairs, path, setting.pool)
    setting.progress(f"pairs of {network.set_name}", ((state.done, state.total) for state in states))
    return path
