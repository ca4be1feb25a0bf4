"""The verbs of measuring: evaluate, report."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from reorient.cli.arguments import Metavar, Positional
from reorient.cli.progress import show_progress, table_console
from reorient.errors import ReorientError, check_counts, check_range
from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.formatting import FigureFormat
from reorient.runs.pool import Pool


@dataclass(frozen=True)
class BopChoice:
    """Real images.

    With --bop the pairs are views of a dataset in BOP's layout, and of the options above --estimators, --pairs and
    --seed count.
    """

    bop: Path | None = None
    """Folder of a dataset in BOP's layout: models, and scenes with depth, mask_visib, scene_camera.json and
    scene_gt.json."""
    split: str = "test"
    """Folder of the dataset that has the scenes."""
    objects: Annotated[tuple[int, ...], Metavar("ID")] = ()
    """Numbers of the objects, by default all."""
    pair_list: Path | None = None
    """CSV file of pairs with scene_id, obj_id, im_id, im_id_goal, by default random pairs."""


@dataclass(frozen=True)
class Evaluate:
    """Measure the errors of estimators on simulated pairs, or on a BOP dataset.

    An interrupted run continues where it stopped.

    Examples:
        reorient evaluate out/eval --count 100 --pairs 300
        reorient evaluate out/own --meshes my_meshes --estimators gicp --ranges-deg 0 30 --noise-mm 1
        reorient evaluate out/bop --bop bop/ycbv --objects 5 12 --estimators default --pairs 200
    """

    out: Positional[Path]
    """Folder for config.json, rows.csv.gz and table.md."""
    config: Evaluation = field(default_factory=Evaluation)
    bop_choice: BopChoice = field(default_factory=BopChoice)
    pool: Pool = field(default_factory=Pool)

    def run(self) -> None:
        """Measure, then print the tables."""
        if self.bop_choice.bop is not None:
            self._run_bop(self.bop_choice.bop)
            return
        if self.bop_choice != BopChoice():
            raise ReorientError(
                "--split, --objects and --pair-list are options of a BOP dataset: expected --bop DATASET"
            )
        from reorient.reporting import markdown_table, print_tables, read_rows
        from reorient.runs.files import replacing

        show_progress("pairs", evaluate(self.config, self.out, self.pool))
        rows = read_rows(self.out)
        with replacing(self.out / "table.md") as temporary:
            temporary.write_text(markdown_table(rows), encoding="utf-8", errors="backslashreplace")
        print_tables(rows, table_console())
        if failed := [row for row in rows if row["message"]]:
            print(
                f"{len(failed)} of {len(rows)} estimates failed and count as no rotation, the first by "
                f"{failed[0]['estimator']}: {failed[0]['message']}",
                file=sys.stderr,
            )
        print(self.out / "rows.csv.gz")

    def _run_bop(self, dataset: Path) -> None:
        from reorient.experiments.bop import BopEvaluation, evaluate_bop
        from reorient.reporting import read_rows
        from reorient.reporting.bop import bop_table
        from reorient.runs.files import replacing

        choice, config = self.bop_choice, self.config
        bop = BopEvaluation(
            dataset, choice.split, choice.objects, choice.pair_list, config.pairs, config.estimators, config.seed
        )
        show_progress("pairs", evaluate_bop(bop, self.out, self.pool))
        table = bop_table(read_rows(self.out))
        with replacing(self.out / "table.md") as temporary:
            temporary.write_text(table, encoding="utf-8", errors="backslashreplace")
        print(table + str(self.out / "rows.csv.gz"))


@dataclass(frozen=True)
class Report:
    """Write an HTML page of an evaluation.

    The page is self-contained: tables, charts that can be filtered, whose marks open their pair in 3D, best and worst
    pairs, reliability.

    Examples:
        reorient report out/eval
        reorient report out/eval --format pdf
        reorient report out/eval --pair 17
    """

    folder: Positional[Path]
    """Folder of ``reorient evaluate``."""
    pairs: int = 200
    """Number of pairs that the page shows in 3D, the best and worst ones first; a page has room for several hundred."""
    pair: int | None = None
    """Write the page of this pair alone, by the number that the page of the evaluation gives."""
    format: FigureFormat | None = None
    """Write the figures for a paper, too."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_counts(self, "pairs")
        check_range(self, "pair")

    def run(self) -> None:
        """Write report.html beside the rows."""
        from reorient.reporting.report import write_figures, write_pair, write_report

        if self.pair is not None:
            print(write_pair(self.folder, self.pair))
            return
        print(write_report(self.folder, self.pairs))
        if self.format is not None:
            print(*write_figures(self.folder, self.format), sep="\n")
