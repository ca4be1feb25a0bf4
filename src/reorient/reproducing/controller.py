"""Algorithm 1 on unseen objects in simulation (paper, "Controller Experiments on Simulated Objects", Figure 9).

22 non-symmetric test objects of the full set x 100 starts 30 degrees away, K = 100, eta = 0.2, delta = 0.5 degrees. The
error against iteration is drawn from the first 20 trials of the first 5 objects, as in the paper's figure.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reorient.experiments.loops import COLUMNS, Loops, run_loops
from reorient.reporting.curves import Curve, Panel, curves, histograms
from reorient.reporting.rows import estimators, numbers, read_table
from reorient.reproducing.findings import Finding, number, share
from reorient.reproducing.one_shot import objects_of, of, write_page
from reorient.reproducing.setting import Setting
from reorient.runs.run import Row
from reorient.world.objects import ObjectSource

PAPER = {"median": "1.47°", "within": "90%", "above": "0.5%"}
DIFFERS = "generated objects; 6 epochs"


@dataclass(frozen=True)
class Controller:
    """As ``Figure``."""

    name: str = "controller"
    estimators: tuple[str, ...] = ("paper", "swift", "gicp", "icp")
    objects: int = 22
    trials: int = 100
    drawn_objects: int = 5
    drawn_trials: int = 20

    def measure(self, setting: Setting) -> None:
        """All loops; a part runs fewer trials of the same objects."""
        source = ObjectSource(only=setting.lists / "full-test.txt", count=872, object_seed=2020)
        config = Loops(
            source,
            tuple(f"{name}/algorithm1" for name in self.estimators),
            self.objects,
            setting.part(self.trials),
            start_deg=("30",),
            noise_mm=(0.0,),
            world="paper",
            seed=setting.seed,
        )
        setting.progress(self.name, run_loops(config, setting.folder(self.name), setting.pool))

    def findings(self, folder: Path) -> Sequence[Finding]:
        """Final errors and moves of each estimator; the symmetry-aware median beside the plain one."""
        rows, found = _rows(folder), []
        for name in estimators(rows):
            mine = of(rows, name)
            final, aware, groups = numbers(mine, "error_deg"), numbers(mine, "error_sym_deg"), objects_of(mine)
            at_limit = [row["status"] == "max_images" for row in mine]
            paper = PAPER if name == "paper" else dict.fromkeys(PAPER, "")
            differs = DIFFERS if name == "paper" else ""
            found += [
                number(f"{name}: median final error", final, groups, "median", paper=paper["median"], differs=differs),
                number(f"{name}: median final error, symmetry-aware", aware, groups, "median"),
                share(f"{name}: within 5°", final < 5, groups, paper=paper["within"], differs=differs),
                share(f"{name}: within 5°, symmetry-aware", aware < 5, groups),
                share(f"{name}: above 30°", final > 30, groups, paper=paper["above"], differs=differs),
                number(f"{name}: moves, mean", numbers(mine, "moves"), groups, unit=" moves"),
                number(f"{name}: moves, median", numbers(mine, "moves"), groups, "median", unit=" moves"),
                share(f"{name}: ended at the limit of 100 images", np.array(at_limit), groups),
            ]
        return found

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """Error against iteration, histograms of the final error."""
        rows = _rows(folder)
        first = list(dict.fromkeys(objects_of(rows)))[: self.drawn_objects]
        drawn = [row for row in rows if row["object"] in first and int(row["trial"]) < self.drawn_trials]
        lines = {name: by_iteration(of(drawn, name)) for name in estimators(drawn)}
        most = f"{len(first)} objects x {len({row['trial'] for row in drawn})} trials"
        final = {"": {name: numbers(of(rows, name), "error_deg").tolist() for name in estimators(rows)}}
        levels = {"paper's median at the end, 1.47°": 1.47}
        figures = {
            "Error against iteration": (
                curves([Panel(most, lines, "error (median, quartiles)", levels=levels)], "moves"),
                "A loop that has ended keeps its last error.",
            ),
            "Final errors": (
                histograms(final, np.linspace(0, 10, 81), "final error"),
                "The last bin holds the larger ones.",
            ),
        }
        lead = (
            f"{len(set(objects_of(rows)))} non-symmetric test objects of the full set x "
            f"{len({row['trial'] for row in rows})} trials, start 30 degrees away, K = 100, eta = 0.2, delta = 0.5 "
            "degrees, world of the paper's simulator, no noise, a new rectangle on every image, pivot known to 1 cm."
        )
        return write_page(
            folder,
            "Algorithm 1 in simulation (Figure 9 of the paper)",
            lead,
            self.findings(folder),
            figures,
            suffix=setting.format,
        )


def _rows(folder: Path) -> list[Row]:
    return read_table(folder / "rows.csv.gz", COLUMNS)


def by_iteration(rows: Sequence[Row]) -> Curve:
    """Median and quartiles of the error after each move; a loop that has ended keeps its last error."""
    loops = [[float(error) for error in row["trajectory_deg"].split()] for row in rows]
    last = max(len(errors) for errors in loops)
    whole = np.array([[*errors, *[errors[-1]] * (last - len(errors))] for errors in loops])
    low, middle, high = np.percentile(whole, [25, 50, 75], axis=0)
    return Curve(np.arange(last).astype(float), middle, low, high)


FIGURE = Controller()
