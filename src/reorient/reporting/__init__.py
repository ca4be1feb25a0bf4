"""From raw rows and closed loops to tables, figures and pages that need no server."""

from reorient.reporting.loop import write_loop
from reorient.reporting.report import write_report
from reorient.reporting.rows import Summary, read_rows, summarise
from reorient.reporting.tables import OVERLAP, markdown_table, print_tables

__all__ = [
    "OVERLAP",
    "Summary",
    "markdown_table",
    "print_tables",
    "read_rows",
    "summarise",
    "write_loop",
    "write_report",
]
