"""Error against angle on unseen non-symmetric objects (paper, Figure 4), mean and hybrid loss, both splits.

Equal budget: every network trains 30 epochs; a tenth of that is trained beside it, which is what a quick run repeats.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from reorient.learning.recipes import LossName, Training
from reorient.reporting.curves import histograms
from reorient.reporting.rows import estimators, numbers
from reorient.reporting.tables import html_table
from reorient.reproducing.findings import Finding
from reorient.reproducing.networks import RECIPE, Network, make_network
from reorient.reproducing.one_shot import (
    NOTHING,
    RELEASED,
    angle_figure,
    labelled,
    mean_difference,
    mean_errors,
    measure_pairs,
    of,
    write_page,
)
from reorient.reproducing.setting import Setting
from reorient.world.objects import ObjectSource, split
from reorient.world.pairs import PairSet

LOSSES: tuple[LossName, ...] = ("mean", "hybrid")
PAPER = {"mean": 6.08, "hybrid": 5.76}
DIFFERS = {
    "network": "generated objects; equal budget, one run; own rate, no dropout",
    "icp": "correct clouds, reflection and scale off",
    "swift": "trained on 628 other generated objects",
}


@dataclass(frozen=True)
class NonSymmetric:
    """As ``Figure``."""

    name: str = "non-symmetric"
    count: int = 110
    object_seed: int = 2021
    pairs_per_object: int = 1500
    """Pairs to train on."""
    epochs: int = 30
    few_epochs: int = 3
    pairs: int = 1620
    """Pairs that are measured on each split."""
    splits: Mapping[str, int] = field(default_factory=lambda: {"train 19, test 81": 81, "train 81, test 19": 19})
    """Number of test objects, by title."""
    recipe: Training = RECIPE

    def objects(self, setting: Setting) -> ObjectSource:
        """The set that is split."""
        return ObjectSource(only=setting.lists / "non-symmetric.txt", count=self.count, object_seed=self.object_seed)

    def networks(self, setting: Setting, test_objects: int) -> list[Network]:
        """Those of one split, as trained in this setting."""
        pairs = PairSet(self.objects(setting), self.pairs_per_object)
        budgets = (self.few_epochs,) if setting.quick else (self.epochs, self.few_epochs)
        return [
            Network(loss, epochs, self.name, pairs, self.recipe, test_objects) for epochs in budgets for loss in LOSSES
        ]

    def measure(self, setting: Setting) -> None:
        """Train the missing networks, then measure each split on its test objects."""
        folder = setting.folder(self.name)
        for title, test_objects in self.splits.items():
            rows = folder / title.replace(", ", "-").replace(" ", "-")
            if (rows / "rows.csv.gz").is_file():
                continue
            trained = self.networks(setting, test_objects)
            for network in trained:
                make_network(network, setting, folder / "training")
            source = trained[0].pairs.objects
            names = source.open().names
            rows.mkdir(exist_ok=True)
            only = rows / "objects.txt"
            only.write_text(
                "".join(f"{names[i]}\n" for i in split(names, test_objects).test),
                encoding="utf-8",
                errors="surrogateescape",
            )
            objects = ObjectSource(only=only, count=self.count, object_seed=self.object_seed)
            weights = [str(network.weights(setting)) for network in trained]
            measure_pairs(setting, rows, objects, [*weights, "swift", "gicp", "icp", NOTHING, RELEASED], self.pairs)

    def findings(self, folder: Path) -> Sequence[Finding]:
        """Mean errors, and hybrid against mean loss pair by pair."""
        found: list[Finding] = []
        for title, rows in self._panels(folder).items():
            named = {name: name.split(",")[0] for name in estimators(rows) if "epoch" in name}
            paper = {name: f"{PAPER[loss]}°" for name, loss in named.items() if f"{self.epochs} epochs" in name}
            found += mean_errors(rows, title, paper, DIFFERS | dict.fromkeys(named, DIFFERS["network"]))
            for name in (name for name, loss in named.items() if loss == "hybrid"):
                known = f"{PAPER['hybrid'] - PAPER['mean']:.2f}°" if name in paper else ""
                words = f"{title}, {name}: mean error less that of the mean loss"
                found.append(mean_difference(rows, words, name, name.replace("hybrid", "mean"), known))
        return found

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """Error against angle, histograms, tables."""
        panels = self._panels(folder)
        levels = {"the paper's hybrid loss: 5.76°": PAPER["hybrid"]}
        spread = {
            title: {name: numbers(of(rows, name), "error_deg").tolist() for name in estimators(rows)}
            for title, rows in panels.items()
        }
        figures = {
            "Error against angle": (
                angle_figure(panels, levels),
                "Mean error in bins of the angle; the band is the 95% interval, objects drawn as a whole. Networks: "
                "equal budget, one run each.",
            ),
            "Error histograms": (
                histograms(spread, np.linspace(0, 30, 61), "error"),
                "Share of pairs in bins of half a degree, each estimator on a scale of its own; larger errors are in "
                "the last bin.",
            ),
        }
        tables = "".join(f"<h3>{title}</h3>{html_table(rows)}" for title, rows in panels.items())
        lead = (
            "100 generated objects that pass the paper's symmetry filter, both splits, world of the paper's simulator, "
            "0 to 30 degrees, rectangle and dropouts. Networks with an equal budget of 30 epochs (and 3)."
        )
        title = "One estimate on unseen non-symmetric objects (Figure 4 of the paper)"
        return write_page(
            folder, title, lead, self.findings(folder), figures, {"All estimators": tables}, setting.format
        )

    def _panels(self, folder: Path) -> dict[str, list[dict[str, str]]]:
        every = Setting()
        return {
            title: labelled(folder / title.replace(", ", "-").replace(" ", "-"), self.networks(every, test_objects))
            for title, test_objects in self.splits.items()
        }


FIGURE = NonSymmetric()
