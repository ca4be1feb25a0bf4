"""What a confidence is worth: reliability, calibration error, risk against coverage, as numbers and as a figure.

Right means a symmetry-aware error below 5 degrees. Noise levels and ranges count together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from scipy.stats import binomtest

from reorient.reporting.figures import PAGE_INCHES, REFERENCE, STYLE, colours_of, legend
from reorient.reporting.rows import estimators, numbers
from reorient.runs.run import Row

RIGHT_DEG = 5.0


@dataclass(frozen=True)
class Bin:
    """The answers whose confidence lies in one interval."""

    low: float
    high: float
    n: int
    said: float
    """Their mean confidence."""
    hits: int
    """How many of them are right."""

    @property
    def was(self) -> float:
        """The share that is right."""
        return self.hits / self.n

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95% interval of that share."""
        low, high = binomtest(self.hits, self.n).proportion_ci(method="wilson")
        return low, high


def confident(rows: Sequence[Row]) -> list[Row]:
    """The rows that have a confidence."""
    return [row for row in rows if row["confidence"]]


def said_and_right(rows: Sequence[Row]) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """The confidences, and whether each answer is right."""
    return numbers(rows, "confidence"), numbers(rows, "error_sym_deg") < RIGHT_DEG


def reliability(said: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"], bins: int = 10) -> list[Bin]:
    """Equal intervals of confidence, the empty ones left out."""
    place = np.minimum((said * bins).astype(int), bins - 1)
    members = [(k, place == k) for k in range(bins)]
    return [
        Bin(k / bins, (k + 1) / bins, int(mine.sum()), float(said[mine].mean()), int(right[mine].sum()))
        for k, mine in members
        if mine.any()
    ]


def calibration_error(bins: Sequence[Bin]) -> float:
    """Expected calibration error: how far what was said is from what was, each bin weighted by its pairs."""
    return sum(abs(x.said - x.was) * x.n for x in bins) / sum(x.n for x in bins)


def risk(said: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The share wrong among the k surest answers, for k from 1 to all."""
    return 1 - np.cumsum(right[np.argsort(-said, kind="stable")]) / np.arange(1, len(said) + 1)


def figure(rows: Sequence[Row]) -> Figure:
    """Reliability (left) and risk against coverage (right) of each estimator, of rows that have a confidence."""
    colours = colours_of(estimators(rows))
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(PAGE_INCHES, 4.2))
        left, right_panel = drawn.subplots(1, 2)
        left.plot([0, 1], [0, 1], color=REFERENCE, ls=":", lw=1.2)
        for name, colour in colours.items():
            said, right = said_and_right([row for row in rows if row["estimator"] == name])
            bins = reliability(said, right)
            x, y = (np.array([getattr(one, what) for one in bins]) for what in ("said", "was"))
            off = np.abs(np.array([one.interval for one in bins]).T - y)
            left.errorbar(x, y, off, fmt="none", ecolor=colour, elinewidth=1.2, capsize=2.5)
            area = 12 + 130 * np.array([one.n for one in bins]) / len(said)
            left.scatter(x, y, s=area, color=colour, zorder=3, label=f"{calibration_error(bins):.3f}")
            coverage = np.arange(1, len(said) + 1) / len(said)
            right_panel.plot(coverage, risk(said, right), color=colour)
            right_panel.plot(coverage, np.maximum(1 - right.mean() / coverage, 0), color=colour, ls=":", lw=1.2)
        left.set(xlabel="confidence", ylabel="share right", xlim=(-0.02, 1.03), ylim=(-0.02, 1.03), title="reliability")
        left.legend(title="expected calibration error", loc="lower right")
        right_panel.set(xlabel="coverage: share answered, surest first", ylabel="risk: share of these wrong")
        right_panel.set(xlim=(0, 1), title="risk against coverage")
        right_panel.set_ylim(bottom=0)
        for axis in (left.xaxis, left.yaxis, right_panel.xaxis, right_panel.yaxis):
            axis.set_major_formatter(PercentFormatter(1, decimals=0))
        legend(drawn, colours)
    return drawn
