"""The verb loops: closed loops in simulation."""

from dataclasses import dataclass, field
from pathlib import Path

from reorient.cli.arguments import Positional
from reorient.cli.progress import show_progress, table_console
from reorient.experiments import loops
from reorient.runs.pool import Pool


@dataclass(frozen=True)
class Loops:
    """Measure closed loops at simulated stations.

    The summary has final errors, moves, and how many loops are unsure or converge falsely.
    An interrupted run continues where it stopped.

    Examples:
        reorient loops out/loops --objects 10 --trials 5
        reorient loops out/faults --start-deg any --faults 0.08 --systems default/fusing
        reorient loops out/paper --start-deg 30 --systems paper/algorithm1 gicp/algorithm1
    """

    out: Positional[Path]
    """Folder for config.json, rows.csv.gz and table.md."""
    config: loops.Loops = field(default_factory=loops.Loops)
    pool: Pool = field(default_factory=Pool)

    def run(self) -> None:
        """Run all loops, print the summary."""
        from reorient.reporting.loop_tables import loop_table, markdown_loops, read_loop_rows
        from reorient.runs.files import replacing

        show_progress("trials", loops.run_loops(self.config, self.out, self.pool))
        rows = read_loop_rows(self.out)
        with replacing(self.out / "table.md") as temporary:
            temporary.write_text(markdown_loops(rows), encoding="utf-8", errors="backslashreplace")
        table_console().print(loop_table(rows))
        print(self.out / "rows.csv.gz")
