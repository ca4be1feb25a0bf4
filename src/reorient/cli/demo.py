"""The verb demo: the closed loop on a simulated object, whose true error is known."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reorient.cli.outputs import print_outcome
from reorient.cli.stations import StationChoice, rotate_away
from reorient.errors import check_range
from reorient.formatting import FigureFormat
from reorient.runs.files import make_folder


@dataclass(frozen=True)
class Demo:
    """Rotate a simulated object to a goal, and write a GIF and a page of the run.

    The object is generated. The estimator sees depth images of it, and no model.

    Examples:
        reorient demo --out out/demo
        reorient demo --object-index 7 --start-deg 25 --noise-mm 0
    """

    out: Path = Path("out/demo")
    """Folder for the GIF and the page."""
    object_index: int = 51
    """Number of the generated object."""
    start_deg: float = 130.0
    """Angle between start and goal."""
    noise_mm: float = 1.0
    """Standard deviation of the depth noise."""
    estimator: str = "rotation-search"
    """One of default (rotation-search), rotation-search, fast, thorough, gicp, icp, paper and swift, an .onnx file,
    or your own module:Class."""
    seed: int = 0
    """Seed of the poses and the noise."""
    format: FigureFormat | None = None
    """Write the curve of the remaining angle as a figure for a paper, too."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "object_index", "noise_mm", "seed")
        check_range(self, "start_deg", high=180)

    def run(self) -> int:
        """Make the station, capture the goal, rotate to the start, and close the loop."""
        from reorient import so3
        from reorient.controller import Step, orient
        from reorient.estimators import load_estimator
        from reorient.reporting.loop import write_loop

        make_folder(self.out)
        estimator = load_estimator(self.estimator)
        station: Any = StationChoice("rendered", self.object_index, self.seed, 0.0, self.noise_mm).open()
        goal, R_goal = station.capture_goal(), station.R_camera_object
        rotate_away(station, self.start_deg, np.random.default_rng(self.seed))
        errors_deg = [self.start_deg]
        print(f"Generated object {self.object_index}, {self.start_deg:g} deg from its goal; estimator {self.estimator}")

        def show(step: Step) -> None:
            print(f"[{step.index + 1}] true error {errors_deg[-1]:.2f} deg; {step.message}", flush=True)
            errors_deg.append(float(np.degrees(so3.angle_difference(R_goal, station.R_camera_object))))

        result = orient(station, goal, estimator, subscribers=[show])
        code = print_outcome(result)
        title = f"Generated object {self.object_index}, {self.start_deg:g} degrees from the goal"
        for path in write_loop(self.out, goal, result, errors_deg, title, self.format):
            print(path)
        return code
