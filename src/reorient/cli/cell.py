"""The simulated robot cell's verb."""

from dataclasses import dataclass, field
from pathlib import Path

from reorient.cli.arguments import Positional
from reorient.cli.progress import show_progress
from reorient.experiments.cell import run
from reorient.experiments.cell_trials import Experiment
from reorient.formatting import FigureFormat
from reorient.runs.pool import Pool


@dataclass(frozen=True)
class Cell:
    """Run the experiment with physical objects in a simulated robot cell.

    The cell has an arm, a gripper and two cameras; the gripper is removed from the images by segmentation. An
    interrupted run continues where it stopped.

    Examples:
        reorient cell out/cell --objects 3 --trials 1
        reorient cell out/far --ranges-deg 30 90 90 180 --systems gicp/direct
    """

    out: Positional[Path]
    """Folder for config.json, rows.csv.gz, masks.csv.gz, report.html and cell.gif."""
    config: Experiment = field(default_factory=Experiment)
    pool: Pool = field(default_factory=Pool)
    format: FigureFormat | None = None
    """Write the figures for a paper, too."""

    def run(self) -> None:
        """Run all trials, print the summary, write the page and the animation."""
        from reorient.reporting.cell import write_cell_figures, write_cell_report
        from reorient.reporting.cell_rows import print_summary

        show_progress("trials", run(self.config, self.out, self.pool))
        print_summary(self.out)
        for path in write_cell_report(self.config, self.out):
            print(path)
        if self.format is not None:
            print(*write_cell_figures(self.out, self.format), sep="\n")
