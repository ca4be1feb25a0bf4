"""The best and the worst prediction: start, goal, start rotated by the estimate (paper, Figures 5 and 6).

Of the network in the package on the non-symmetric test objects of the full set; with `swift` and `gicp` beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from reorient.experiments.evaluation import read_config
from reorient.reporting.page import inline_image
from reorient.reporting.pairs import three_panels
from reorient.reporting.pictures import montage, png_data_uri
from reorient.reporting.rows import estimators
from reorient.reproducing.findings import Finding
from reorient.reproducing.one_shot import labelled, mean_errors, measure_pairs, of, write_page
from reorient.reproducing.setting import Setting
from reorient.runs.files import replacing
from reorient.runs.run import Row
from reorient.world.objects import ObjectSource

LEAST_DEG = 15.0  # the best is chosen among pairs that differ by at least this: smaller rotations are easy
PAPER = {"best": "below 0.1° (at 26.36°)", "worst": "25.09° (at 22.59°)"}


@dataclass(frozen=True)
class BestWorst:
    """As ``Figure``."""

    name: str = "best-worst"
    pairs: int = 644
    estimators: tuple[str, ...] = ("paper", "swift", "gicp")

    def measure(self, setting: Setting) -> None:
        """One estimate of each pair."""
        folder = setting.folder(self.name)
        objects = ObjectSource(only=setting.lists / "full-test.txt", count=872, object_seed=2020)
        measure_pairs(setting, folder, objects, self.estimators, self.pairs)

    def findings(self, folder: Path) -> Sequence[Finding]:
        """Best and worst error (deg) per estimator, and mean errors."""
        rows = labelled(folder)
        nan = float("nan")
        return [
            Finding(
                f"{name}, {end} of the pairs", float(row["error_deg"]), nan, nan, len(of(rows, name)),
                paper=PAPER[end] if name == "paper" else "",
                differs=f"full set's test objects; at {float(row['angle_deg']):.1f}°; "
                f"best of those from {LEAST_DEG:g}°",
            )
            for name in estimators(rows)
            for end, row in _extremes(rows, name).items()
        ] + mean_errors(rows, "all pairs", {}, {})  # fmt: skip

    def draw(self, setting: Setting, folder: Path) -> list[Path]:
        """One picture an estimator, the best pair above the worst, and a page."""
        rows, config = labelled(folder), read_config(folder)
        written, sections = [], {}
        for name in estimators(rows):
            ends = _extremes(rows, name)
            pictures: list[Image.Image] = []
            labels: list[str] = []
            for end, row in ends.items():
                pictures += three_panels(row, config)
                labels += [
                    f"{end}: start", f"goal, {float(row['angle_deg']):.1f}° away",
                    f"start rotated, {float(row['error_deg']):.2f}° off",
                ]  # fmt: skip
            sheet = montage(pictures, 3, labels)
            written.append(folder / f"{name}.png")
            with replacing(written[-1]) as temporary:
                sheet.save(temporary, optimize=True)
            objects = ", ".join(f"{end}: {row['object']}, pair {row['pair']}" for end, row in ends.items())
            sections[name] = inline_image(png_data_uri(sheet), f"best and worst of {name}", objects, kind="dark")
        lead = "The third panel is rendered exactly from the mesh: it should look like the goal."
        title = "Best and worst predictions (Figures 5 and 6 of the paper)"
        return written + write_page(folder, title, lead, self.findings(folder), {}, sections)


def _extremes(rows: Sequence[Row], estimator: str) -> dict[str, Row]:
    ordered = sorted(of(rows, estimator), key=lambda row: float(row["error_deg"]))
    rotated = (row for row in ordered if float(row["angle_deg"]) >= LEAST_DEG)
    return {"best": next(rotated, ordered[0]), "worst": ordered[-1]}


FIGURE = BestWorst()
