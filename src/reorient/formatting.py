"""Numbers as text, the same in the command line, reports and messages. A missing value (None or NaN) prints as "-"."""

import math
from typing import Literal

MISSING = "-"
FigureFormat = Literal["png", "svg", "pdf"]
"""Of a figure for a paper."""


def format_probability(probability: float | None) -> str:
    """One decimal, at most "99.9%": an estimated probability is never certain. 0.9989 and 1.0 give "99.9%"."""
    if probability is None or math.isnan(probability):
        return MISSING
    return f"{min(100 * probability, 99.9):.1f}%"


def format_share(share: float | None) -> str:
    """Whole percent of a counted part: 0.304 gives "30%", 0.9989 ">99%", 0.002 "<1%"; "100%" is all, "0%" none."""
    if share is None or math.isnan(share):
        return MISSING
    if 0 < share < 0.005:
        return "<1%"
    return ">99%" if 0.995 <= share < 1 else f"{100 * share:.0f}%"


def format_number(value: float | None, decimals: int = 2) -> str:
    """A number with a fixed count of decimals."""
    return MISSING if value is None or math.isnan(value) else f"{value:.{decimals}f}"
