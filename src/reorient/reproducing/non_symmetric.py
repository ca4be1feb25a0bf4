"""Error against angle on unseen non-symmetric objects (paper, Figure 4), mean and hybrid loss, both splits.

Equal budget: every network trains 30 epochs; a tenth of that is trained beside it, which is what a quick run repeats.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from reorient.learning.recipes import LossName
from reorient.reporting.curves import histograms
from reorient.reporting.rows import estimators, numbers
from reorient.reporting.tables import html_table
from reorient.reproducing.findings import Finding
from reorient.reproducing.networks import Network, make_network
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

NAME = "non-symmetric"
COUNT, OBJECT_SEED, PAIRS_PER_OBJECT = 110, 2021, 1500
EPOCHS, FEW_EPOCHS = 30, 3
PAIRS = 1620  # measured on each split
SPLITS = {"train 19, test 81": 81, "train 81, test 19": 19}
LOSSES: tuple[LossName, ...] = ("mean", "hybrid")
PAPER = {"mean": 6.08, "hybrid": 5.76}
DIFFERS = {
    "network": "generated objects; equal budget, one run; own rate, no dropout",
    "icp": "correct clouds, reflection and scale off",
    "swift": "trained on 628 other generated objects",
}


def networks(setting: Setting, test_objects: int) -> list[Network]:
    """Those of one split, as trained in this setting."""
    objects = ObjectSource(only=setting.lists / "non-symmetric.txt", count=COUNT, object_seed=OBJECT_SEED)
    pairs = PairSet(objects, PAIRS_PER_OBJECT)
    budgets = (FEW_EPOCHS,) if setting.quick else (EPOCHS, FEW_EPOCHS)
    return [Network(loss, epochs, NAME, pairs, test_objects) for epochs in budgets for loss in LOSSES]


def measure(setting: Setting) -> None:
    """Train what is missing, then measure each split on its test objects."""
    folder = setting.folder(NAME)
    for title, test_objects in SPLITS.items():
        rows = folder / title.replace(", ", "-").replace(" ", "-")
        if (rows / "rows.csv.gz").is_file():
            continue
        trained = networks(setting, test_objects)
        for network in trained:
            make_network(network, setting, folder / "training")
        source = trained[0].pairs.objects
        names = source.open().names
        rows.mkdir(exist_ok=True)
        only = rows / "objects.txt"
        only.write_text("".join(f"{names[i]}\n" for i in split(names, test_objects).test))
        objects = ObjectSource(only=only, count=COUNT, object_seed=OBJECT_SEED)
        weights = [str(network.weights(setting)) for network in trained]
        measure_pairs(setting, rows, objects, [*weights, "swift", "gicp", "icp", NOTHING, RELEASED], PAIRS)


def _panels(folder: Path) -> dict[str, list[dict[str, str]]]:
    every = Setting()
    return {
        title: labelled(folder / title.replace(", ", "-").replace(" ", "-"), networks(every, test_objects))
        for title, test_objects in SPLITS.items()
    }


def findings(folder: Path) -> Sequence[Finding]:
    """Mean errors, and hybrid against mean loss pair by pair."""
    found: list[Finding] = []
    for title, rows in _panels(folder).items():
        named = {name: name.split(",")[0] for name in estimators(rows) if "epoch" in name}
        paper = {name: f"{PAPER[loss]}°" for name, loss in named.items() if f"{EPOCHS} epochs" in name}
        found += mean_errors(rows, title, paper, DIFFERS | dict.fromkeys(named, DIFFERS["network"]))
        for name in (name for name, loss in named.items() if loss == "hybrid"):
            known = f"{PAPER['hybrid'] - PAPER['mean']:.2f}°" if name in paper else ""
            words = f"{title}, {name}: mean error less that of the mean loss"
            found.append(mean_difference(rows, words, name, name.replace("hybrid", "mean"), known))
    return found


def draw(setting: Setting, folder: Path) -> list[Path]:
    """Error against angle, histograms, tables."""
    panels = _panels(folder)
    levels = {"the paper's hybrid loss: 5.76°": PAPER["hybrid"]}
    spread = {
        title: {name: numbers(of(rows, name), "error_deg").tolist() for name in estimators(rows)}
        for title, rows in panels.items()
    }
    figures = {
        "Error against angle": (
            angle_figure(panels, levels),
            "Mean error in bins of the angle; the band is the 95% interval, objects drawn as a whole. Networks: equal "
            "budget, one run each.",
        ),
        "Error histograms": (
            histograms(spread, np.linspace(0, 30, 61), "error"),
            "Share of pairs in bins of half a degree, each estimator on a scale of its own; larger errors are in the "
            "last bin.",
        ),
    }
    tables = "".join(f"<h3>{title}</h3>{html_table(rows)}" for title, rows in panels.items())
    lead = (
        "100 generated objects that pass the paper's symmetry filter, both splits, world of the paper's simulator, 0 "
        "to 30 degrees, rectangle and dropouts. Networks with an equal budget of 30 epochs (and 3)."
    )
    title = "One estimate on unseen non-symmetric objects (Figure 4 of the paper)"
    return write_page(folder, title, lead, findings(folder), figures, {"All estimators": tables})
