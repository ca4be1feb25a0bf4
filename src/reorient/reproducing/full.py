"""ShapeMatch error against angle on the full set, symmetric objects among them (paper, Figure 7).

And the result of training with ShapeMatch alone: according to the paper the network averages q and -q, its real
part comes near zero.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from reorient import so3
from reorient.estimators.learned import Learned
from reorient.experiments.cached import cached_estimator
from reorient.experiments.evaluation import Evaluation, read_config, regenerate
from reorient.learning.recipes import LossName, Training
from reorient.reporting.curves import Panel, curves, histograms
from reorient.reporting.rows import estimators, numbers, read_rows, read_table
from reorient.reporting.tables import html_table
from reorient.reproducing.findings import Finding, number, share
from reorient.reproducing.networks import RECIPE, Network, make_network
from reorient.reproducing.one_shot import (
    NOTHING,
    against_angle,
    labelled,
    mean_difference,
    mean_errors,
    measure_pairs,
    objects_of,
    of,
    write_page,
)
from reorient.reproducing.setting import Setting
from reorient.runs.run import Row, RowStore, Tables, resumable
from reorient.world.meshes import some_vertices
from reorient.world.objects import ObjectSource, split
from reorient.world.pairs import PairSet

LOSSES: tuple[LossName, ...] = ("mean", "shapematch")  # hybrid: the weights in the package
SHAPES = "shapes"  # folder of the run that measures ShapeMatch
SHIPPED = "hybrid (shipped)"
ALONE = "shapematch"
LEARNED = (ALONE, "mean", "hybrid")
UNIT = 1000.0  # ShapeMatch, squared bounding radii, times this


@dataclass(frozen=True)
class Full:
    """As ``Figure``."""

    name: str = "full"
    count: int = 872
    object_seed: int = 2020
    pairs_per_object: int = 200
    """Pairs to train on."""
    epochs: int = 6
    few_epochs: int = 1
    pairs: int = 870
    """Pairs that are measured: five of each test object."""
    recipe: Training = RECIPE

    def objects(self) -> ObjectSource:
        """The whole set."""
        return ObjectSource(count=self.count, object_seed=self.object_seed)

    def networks(self, setting: Setting) -> list[Network]:
        """Those to train beside the shipped one."""
        pairs = PairSet(self.objects(), self.pairs_per_object)
        budgets = (self.few_epochs,) if setting.quick else (self.epochs, self.few_epochs)
        return [Network(loss, epochs, self.name, pairs, self.recipe) for epochs in budgets for loss in LOSSES]

    def measure(self, setting: Setting) -> None:
        """Train the missing networks, measure on all test objects, then ShapeMatch and the networks' real parts."""
        folder = setting.folder(self.name)
        if not (folder / "rows.csv.gz").is_file():
            trained = self.networks(setting)
            for network in trained:
                make_network(network, setting, folder / "training")
            names = self.objects().open().names
            only = folder / "objects.txt"
            only.write_text(
                "".join(f"{names[i]}\n" for i in split(names).test), encoding="utf-8", errors="surrogateescape"
            )
            objects = replace(self.objects(), only=only)
            weights = [str(network.weights(setting)) for network in trained]
            measure_pairs(setting, folder, objects, [*weights, "paper", "swift", "gicp", "icp", NOTHING], self.pairs)
        config, pairs = read_config(folder), defaultdict(list)
        for row in read_rows(folder):
            pairs[row["pair"]].append(row)
        tasks = {pair: (config, rows) for pair, rows in pairs.items()}
        setting.progress("ShapeMatch", resumable(folder / SHAPES, config, tasks, _shapes, RowStore(), setting.pool))

    def findings(self, folder: Path) -> Sequence[Finding]:
        """ShapeMatch and angle errors of all; for ShapeMatch alone, what its real part does."""
        rows, shapes = self._rows(folder)
        found = []
        for name in estimators(shapes):
            mine = of(shapes, name)
            words = f"{name}: mean ShapeMatch, thousandths of the squared radius"
            found.append(
                number(words, numbers(mine, "shape_match"), objects_of(mine), unit="", differs="generated objects")
            )
        found += mean_errors(rows, "all test objects", {}, {})
        longest = max(
            (name for name in estimators(rows) if name.startswith("mean")), key=lambda name: f"{self.epochs} " in name
        )
        found.append(mean_difference(rows, f"{SHIPPED}: mean error less that of {longest}", SHIPPED, longest))
        for name in (name for name in estimators(shapes) if name.startswith(LEARNED)):
            mine = of(shapes, name)
            real, groups = numbers(mine, "raw_real"), objects_of(mine)
            paper = "near zero" if name.startswith(ALONE) else ""
            differs = "the last layer begins near no rotation" if paper else ""
            words = f"{name}: mean absolute real part"
            found.append(number(words, np.abs(real), groups, "mean", unit="", paper=paper, differs=differs))
            found.append(share(f"{name}: real part negative", real < 0, groups))
        return found

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """ShapeMatch against angle, histograms of both errors, real parts."""
        rows, shapes = self._rows(folder)
        names = estimators(rows)
        angle = {"error": {name: numbers(of(rows, name), "error_sym_deg").tolist() for name in names}}
        sm = {"ShapeMatch": {name: numbers(of(shapes, name), "shape_match").tolist() for name in names}}
        learned = [name for name in names if name.startswith(LEARNED)]
        real = {"real part": {name: numbers(of(shapes, name), "raw_real").tolist() for name in learned}}
        unit = "thousandths of the squared bounding radius"
        panel = Panel("", against_angle(shapes, "shape_match"), "mean ShapeMatch, thousandths", unit="")
        figures = {
            "ShapeMatch against angle": (
                curves([panel], "angle between start and goal"),
                f"Mean ShapeMatch error, {unit}, with its 95% interval.",
            ),
            "ShapeMatch histograms": (
                histograms(sm, np.linspace(0, 5, 61), f"ShapeMatch, {unit}", unit=""),
                "The last bin holds the larger ones.",
            ),
            "Symmetry-aware error histograms": (
                histograms(angle, np.linspace(0, 30, 61), "symmetry-aware error"), "The last bin holds the larger ones."
            ),
            "Real part of the raw answer": (
                histograms(real, np.linspace(-1, 1, 81), "real part of the network's quaternion", unit=""),
                "According to the paper, ShapeMatch alone brings it near zero; the truth is above 0.966 for all pairs.",
            ),
        }  # fmt: skip
        count = len(set(objects_of(rows)))
        lead = (
            f"{count} test objects of the full set, symmetric ones among them, the paper's world, 0 to 30 degrees. "
            f"Mean loss and ShapeMatch alone: {self.epochs} epochs (and {self.few_epochs}) each; hybrid: the "
            f"package's weights, of as many pairs as {self.epochs} epochs."
        )
        title = "ShapeMatch on the full set (Figure 7 of the paper)"
        return write_page(
            folder, title, lead, self.findings(folder), figures, {"Angles": html_table(rows)}, setting.format
        )

    def _rows(self, folder: Path) -> tuple[list[Row], list[Row]]:
        """Rows with errors in degrees, and those with ShapeMatch, estimators by their labels."""
        every = self.networks(Setting())
        rows = labelled(folder, every)
        shapes = read_table(folder / SHAPES / "rows.csv.gz", ["shape_match", "raw_real"])
        for row, shape in zip(rows, shapes, strict=True):
            row["estimator"] = SHIPPED if row["estimator"] == "paper" else row["estimator"]
            shape["estimator"] = row["estimator"]
            shape["shape_match"] = str(UNIT * float(shape["shape_match"]))
        return rows, shapes


def shape_match(
    vertices: Float[np.ndarray, "n 3"], R_est: Float[np.ndarray, "3 3"], R_true: Float[np.ndarray, "3 3"]
) -> float:
    """The paper's L_SM of one pair: ``vertices`` over the bounding radius, so the unit is its square."""
    distance, _ = cKDTree(vertices @ R_true.T).query(vertices @ R_est.T)
    return float(np.mean(distance**2) / 2)


def _shapes(task: tuple[Evaluation, list[Row]]) -> Tables:
    """ShapeMatch of all rows of one pair; of a network also the real part of its raw answer."""
    config, rows = task
    pair, renderer = regenerate(config, rows[0])
    posed = some_vertices(renderer.mesh, np.random.default_rng(0)) @ pair.R_camera_object.T
    done = []
    for row in rows:
        R_est = so3.matrix_from_quat(so3.normalize(np.array([float(row[f"q{part}"]) for part in "wxyz"])))
        raw = ""
        if row["estimator"].endswith(".onnx") or row["estimator"] == "paper":
            network = cast(Learned, cached_estimator(row["estimator"]))
            raw = f"{network.raw_quat_wxyz(pair.current, pair.goal)[0]:.6f}"
        error = shape_match(posed, R_est, pair.R_goal_current)
        kept = {key: row[key] for key in ("object", "pair", "estimator", "angle_deg", "low_deg", "high_deg")}
        done.append(kept | {"shape_match": f"{error:.8f}", "raw_real": raw})
    return {"rows": done}


FIGURE = Full()
