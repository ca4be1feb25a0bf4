"""The table of an evaluation on a BOP dataset: symmetry-aware rotation errors beside BOP's MSSD and its recall."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest

from reorient.reporting.rows import estimators, numbers
from reorient.runs.run import Row

THRESHOLDS = np.arange(1, 11) * 0.05  # of the diameter: BOP averages the recall over these
_HEADINGS = ("rotation", "estimator", "pairs", "refused", "median° sym.", "< 5° sym. (95%)", "MSSD/d", "AR MSSD", "ms")


def bop_table(rows: Sequence[Row]) -> str:
    """Markdown: a line for each range of the rotation between the views and each estimator, then over all ranges.

    MSSD/d: median of the maximum symmetry-aware surface distance over the diameter. AR MSSD: recall, averaged over the
    thresholds 0.05 to 0.5 diameters. A refused pair counts as "no rotation". Raises ReorientError for broken rows.
    """
    lines = [_HEADINGS, ("---", "---", *("---:",) * (len(_HEADINGS) - 2))]
    ranges = sorted({(float(row["low_deg"]), float(row["high_deg"])) for row in rows})
    for low, high in [*ranges, (None, None)]:
        for name in estimators(rows):
            chosen = [
                row
                for row in rows
                if row["estimator"] == name
                and (low is None or (float(row["low_deg"]), float(row["high_deg"])) == (low, high))
            ]
            if chosen:
                lines.append(("all" if low is None else f"{low:g}–{high:g}°", name, *_cells(chosen)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def recall(rows: Sequence[Row]) -> float:
    """Share of the pairs with an MSSD below a threshold, averaged over BOP's thresholds."""
    relative = numbers(rows, "mssd_mm") / numbers(rows, "diameter_mm")
    return float(np.mean(relative[:, None] < THRESHOLDS))


def _cells(rows: Sequence[Row]) -> tuple[str, ...]:
    errors_deg = numbers(rows, "error_sym_deg")
    good = int(np.sum(errors_deg < 5))
    low, high = binomtest(good, len(rows)).proportion_ci(method="wilson")
    relative = numbers(rows, "mssd_mm") / numbers(rows, "diameter_mm")
    return (
        str(len(rows)),
        str(sum(bool(row["message"]) for row in rows)),
        f"{np.median(errors_deg):.2f}",
        f"{good / len(rows):.1%} ({100 * low:.0f}–{100 * high:.0f})",
        f"{np.median(relative):.3f}",
        f"{recall(rows):.1%}",
        f"{1000 * np.median(numbers(rows, 'seconds')):.0f}",
    )
