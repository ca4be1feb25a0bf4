"""From raw rows and closed loops to tables, figures and pages that need no server.

A name is imported when it is first used: figures and the pages of evaluations need the extra ``sim``.
"""

from typing import TYPE_CHECKING

from reorient.extras import imported_on_use

if TYPE_CHECKING:
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
_MODULES = {
    "loop": ("write_loop",),
    "report": ("write_report",),
    "rows": ("Summary", "read_rows", "summarise"),
    "tables": ("OVERLAP", "markdown_table", "print_tables"),
}
if not TYPE_CHECKING:  # a type checker shall see the names above and no others
    __getattr__ = imported_on_use(__name__, _MODULES)
