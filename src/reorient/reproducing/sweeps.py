"""Where learning beats geometry: one thing at a time made worse, for the networks and for registration.

What is usual and what is varied: ``conditions``. No pivot is given.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from zlib import crc32

import numpy as np

from reorient import so3
from reorient.errors import ReorientError
from reorient.experiments.cached import cached_estimator
from reorient.reporting.curves import Curve, Panel, curves
from reorient.reporting.rows import estimators, numbers, read_table
from reorient.reproducing.conclusions import conclude
from reorient.reproducing.conditions import SWEEPS, WORLD, Condition, Sweep, see
from reorient.reproducing.findings import Finding, number, share
from reorient.reproducing.one_shot import objects_of, of, write_page
from reorient.reproducing.setting import Setting
from reorient.runs.files import replacing
from reorient.runs.run import Row, RowStore, Tables, resumable
from reorient.world.objects import ObjectSource
from reorient.world.pairs import Pair
from reorient.world.rendering import Renderer
from reorient.world.symmetry import SymmetryGroup, rotation_group, symmetric_error

ESTIMATORS = ("paper", "swift", "gicp", "icp")


@dataclass(frozen=True)
class Sweeps:
    """What to measure."""

    objects: ObjectSource
    estimators: tuple[str, ...] = ESTIMATORS
    pairs: int = 300
    """At each level, spread over the objects."""
    seed: int = 0
    world: str = WORLD
    sweeps: Mapping[str, Sweep] = field(default_factory=lambda: SWEEPS)


@dataclass(frozen=True)
class SweepFigure:
    """As ``Figure``."""

    name: str = "sweeps"
    pairs: int = 300
    sweeps: Mapping[str, Sweep] = field(default_factory=lambda: SWEEPS)

    def measure(self, setting: Setting) -> None:
        """All levels of all sweeps, pair by pair."""
        config = Sweeps(setting.household(), pairs=setting.part(self.pairs), seed=setting.seed, sweeps=self.sweeps)
        # in an order by hash, so that a part has objects of all sources
        names = sorted(config.objects.open().names, key=lambda name: crc32(name.encode()))
        tasks = {str(index): (config, names[index % len(names)], index) for index in range(config.pairs)}
        states = resumable(setting.folder(self.name), config, tasks, _measure_pair, RowStore(), setting.pool)
        setting.progress(self.name, states)

    def findings(self, folder: Path) -> Sequence[Finding]:
        """The share within 5 degrees of each estimator at each level, and the median."""
        found = []
        for sweep, levels in _rows(folder).items():
            for level, rows in levels.items():
                for name in estimators(rows):
                    mine = of(rows, name)
                    errors_deg, groups = numbers(mine, "error_deg"), objects_of(mine)
                    words = f"{self.sweeps[sweep].words(level)}, {name}"
                    found.append(share(f"{words}: within 5°", errors_deg < 5, groups))
                    found.append(number(f"{words}: median", errors_deg, groups, "median"))
        return found

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """One figure a sweep, share within 5 degrees beside the median; and a page of conclusions."""
        sweeps = _rows(folder)
        figures = {}
        for sweep, levels in sweeps.items():
            names = estimators(next(iter(levels.values())))
            shares, medians = ({name: _curve(levels, name, which) for name in names} for which in ("within", "median"))
            panels = [
                Panel("within 5°", shares, "share of pairs (95% interval)", "%", logarithmic=False),
                Panel("median", medians, "error (95% interval)"),
            ]
            caption = "Plain errors; bootstrap intervals, objects drawn as a whole."
            figures[sweep.capitalize()] = curves(panels, self.sweeps[sweep].axis), caption
        in_words = {
            self.sweeps[sweep].axis: {self.sweeps[sweep].words(level): at for level, at in levels.items()}
            for sweep, levels in sweeps.items()
        }
        sentences = conclude(in_words)
        text = folder / "conclusions.md"
        with replacing(text) as temporary:
            lines = "".join(f"- {line}\n" for line in sentences)
            temporary.write_text(f"# Where learning beats geometry\n\n{lines}", encoding="utf-8")
        rows = [row for levels in sweeps.values() for at in levels.values() for row in at]
        pairs = len({row["pair"] for row in rows})
        lead = (
            f"{pairs} pairs a level of {len(set(objects_of(rows)))} unseen objects; everything else as it is usual: "
            + (
                "1 mm of noise, rectangle, 1% dropouts, 0 to 30 degrees, exact intrinsics, 128 pixels, no pivot. The "
                "networks were trained on 0 to 30 degrees."
            )
        )
        more = {"Conclusions": "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in sentences) + "</ul>"}
        title = "Where does learning beat geometry?"
        return [
            text,
            *write_page(folder, title, lead, self.findings(folder), figures, more, setting.format),
        ]


def _measure_pair(task: tuple[Sweeps, str, int]) -> Tables:
    config, name, index = task
    mesh = config.objects.open().load(name)
    renderer, group = Renderer(mesh), rotation_group(mesh)
    known: dict[Condition, list[Row]] = {}  # the usual condition is a level of most sweeps
    rows = []
    for name_of, sweep in config.sweeps.items():
        for level, condition in sweep.conditions.items():
            if condition not in known:
                pair = see(renderer, condition, np.random.default_rng([config.seed, index]))
                known[condition] = [_estimate(estimator, pair, group) for estimator in config.estimators]
            head = {"object": name, "pair": str(index), "sweep": name_of, "level": f"{level:g}"}
            rows += [head | row for row in known[condition]]
    return {"rows": rows}


def _estimate(name: str, pair: Pair, group: SymmetryGroup) -> Row:
    """What an estimator answers; one that refuses has answered "no rotation"."""
    message = ""
    try:
        R = cached_estimator(name).estimate(pair.current, pair.goal).R_goal_current
    except ReorientError as error:
        R, message = np.eye(3), str(error)
    true = pair.R_goal_current
    return {
        "estimator": name,
        "angle_deg": f"{np.degrees(so3.angle(true)):.4f}",
        "error_deg": f"{np.degrees(so3.angle_difference(R, true)):.5f}",
        "error_sym_deg": f"{np.degrees(symmetric_error(group, R, true, pair.R_camera_object)):.5f}",
        "message": message,
    }


def _rows(folder: Path) -> dict[str, dict[float, list[Row]]]:
    """The rows by sweep and level."""
    sorted_rows: dict[str, dict[float, list[Row]]] = {}
    for row in read_table(folder / "rows.csv.gz", ["sweep", "level", "estimator", "error_deg"]):
        sorted_rows.setdefault(row["sweep"], {}).setdefault(float(row["level"]), []).append(row)
    return sorted_rows


def _curve(levels: Mapping[float, list[Row]], estimator: str, which: str) -> Curve:
    found = []
    for rows in levels.values():
        mine = of(rows, estimator)
        errors_deg, groups = numbers(mine, "error_deg"), objects_of(mine)
        within = which == "within"
        found.append(share("", errors_deg < 5, groups) if within else number("", errors_deg, groups, "median"))
    x = np.array(list(levels))
    return Curve(x, *(np.array([getattr(f, end) for f in found]) for end in ("value", "low", "high")))


FIGURE = SweepFigure()
