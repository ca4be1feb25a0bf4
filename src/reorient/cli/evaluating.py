"""The verbs of measuring: evaluate, report."""

import sys
from dataclasses import dataclass, field
from pathlib import Path

from reorient.cli.arguments import Positional
from reorient.cli.progress import show_progress, table_console
from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.runs.pool import Pool


@dataclass(frozen=True)
class Evaluate:
    """Measure the errors of estimators on simulated pairs of images.

    An interrupted run continues where it stopped.

    Examples:
        reorient evaluate out/eval --count 100 --pairs 300
        reorient evaluate out/own --meshes my_meshes --estimators gicp --ranges-deg 0 30 --noise-mm 1
    """

    out: Positional[Path]
    """Folder for config.json, rows.csv.gz and table.md."""
    config: Evaluation = field(default_factory=Evaluation)
    pool: Pool = field(default_factory=Pool)

    def run(self) -> None:
        """Measure, then print the tables."""
        from reorient.reporting import markdown_table, print_tables, read_rows
        from reorient.runs.files import replacing

        show_progress("pairs", evaluate(self.config, self.out, self.pool))
        rows = read_rows(self.out)
        with replacing(self.out / "table.md") as temporary:
            temporary.write_text(markdown_table(rows))
        print_tables(rows, table_console())
        if failed := [row for row in rows if row["message"]]:
            print(
                f"{len(failed)} of {len(rows)} estimates failed and count as no rotation, the first by "
                f"{failed[0]['estimator']}: {failed[0]['message']}",
                file=sys.stderr,
            )
        print(self.out / "rows.csv.gz")


@dataclass(frozen=True)
class Report:
    """Write an HTML page of an evaluation.

    The page is self-contained: error against angle, histograms, best and worst pairs.

    Examples:
        reorient report out/eval
    """

    folder: Positional[Path]
    """Folder of ``reorient evaluate``."""

    def run(self) -> None:
        """Write report.html beside the rows."""
        from reorient.reporting import write_report

        print(write_report(self.folder))
