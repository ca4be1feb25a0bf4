"""What a verb that runs a loop writes about it."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from reorient.cli.estimating import confidence_in_words
from reorient.formatting import FigureFormat
from reorient.runs.files import make_folder

if TYPE_CHECKING:
    from reorient.controller import OrientResult
    from reorient.imaging import DepthImage

EXIT_CODES = {"converged": 0, "dry_run": 0, "interrupted": 130}  # of the other statuses: 1


@dataclass(frozen=True)
class LoopOutputs:
    """Files of the run."""

    out: Path | None = None
    """Folder for a page and a GIF of the run."""
    format: FigureFormat | None = None
    """With --out: write the curve of the remaining angle as a figure for a paper, too."""
    mcap: Path | None = None
    """File to write the run to as MCAP, which Foxglove and Rerun open. It needs the extra view."""

    def check(self) -> None:
        """Make the folder. Raises ReorientError where that, or MCAP, is not possible."""
        from reorient.extras import import_extra, require

        if self.out is not None:
            make_folder(self.out)
        if self.out is not None and self.format is not None:
            require("matplotlib")
        if self.mcap is not None:
            import_extra("mcap_protobuf")

    def write(self, goal: "DepthImage", result: "OrientResult", errors_deg: Sequence[float], title: str) -> None:
        """Write what is asked for, unless the loop has no step; prints the paths. Errors as ``write_loop``."""
        if not result.steps:
            return
        if self.out is not None:
            from reorient.reporting.loop import write_loop

            print(*write_loop(self.out, goal, result, errors_deg, title, self.format), sep="\n")
        if self.mcap is not None:
            from reorient.viewing.mcap_file import write_mcap

            print(write_mcap(self.mcap, goal, result))


def print_outcome(result: "OrientResult") -> int:
    """Print how a loop ended; the exit code."""
    code = EXIT_CODES.get(result.status, 1)
    for error in result.errors:
        print(f"error during the loop: {error}")
    moves = f"{result.moves} move" + "s" * (result.moves != 1)
    if result.converged:
        place = "" if result.distance_m is None else f", {1000 * result.distance_m:.1f} mm from the goal's place"
        print(f"converged after {moves}{place}, confidence {confidence_in_words(result.confidence)}")
    elif code:
        print(f"reorient: not converged after {moves} ({result.status}): {result.reason}", file=sys.stderr)
    else:
        print(result.reason)
    return code
