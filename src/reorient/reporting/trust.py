"""Calibration of the confidence: reliability, expected calibration error, risk against coverage.

An estimate is correct if its symmetry-aware error is below 5 degrees. Noise levels and ranges are pooled.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from scipy.stats import binomtest

from reorient.reporting.rows import CORRECT_DEG, estimators, numbers
from reorient.reporting.style import PAGE_INCHES, REFERENCE, STYLE, colours_of, legend
from reorient.runs.run import Row


@dataclass(frozen=True)
class Bin:
    """The estimates whose confidence is in one interval."""

    low: float
    high: float
    n: int
    confidence: float
    """Mean confidence."""
    hits: int
    """Number of correct estimates."""

    @property
    def accuracy(self) -> float:
        """Share of correct estimates."""
        return self.hits / self.n

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95% interval of that share."""
        low, high = binomtest(self.hits, self.n).proportion_ci(method="wilson")
        return low, high


def confident(rows: Sequence[Row]) -> list[Row]:
    """The rows with a confidence."""
    return [row for row in rows if row["confidence"]]


def confidence_and_correct(rows: Sequence[Row]) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """The confidences, and whether each estimate is correct."""
    return numbers(rows, "confidence"), numbers(rows, "error_sym_deg") < CORRECT_DEG


def reliability(confidence: Float[np.ndarray, " n"], correct: Bool[np.ndarray, " n"], bins: int = 10) -> list[Bin]:
    """Bins of equal width in confidence, without the empty ones."""
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    members = [(k, place == k) for k in range(bins)]
    return [
        Bin(k / bins, (k + 1) / bins, int(mine.sum()), float(confidence[mine].mean()), int(correct[mine].sum()))
        for k, mine in members
        if mine.any()
    ]


def calibration_error(bins: Sequence[Bin]) -> float:
    """Expected calibration error: |confidence - accuracy| of the bins, weighted by their pairs."""
    return sum(abs(x.confidence - x.accuracy) * x.n for x in bins) / sum(x.n for x in bins)


def risk(confidence: Float[np.ndarray, " n"], correct: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Share of incorrect estimates among the k most confident ones, for k from 1 to all."""
    return 1 - np.cumsum(correct[np.argsort(-confidence, kind="stable")]) / np.arange(1, len(confidence) + 1)


def figure(rows: Sequence[Row]) -> Figure:
    """Reliability (left) and risk against coverage (right) of each estimator, from rows with a confidence."""
    colours = colours_of(estimators(rows))
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(PAGE_INCHES, 4.2))
        left, right = drawn.subplots(1, 2)
        left.plot([0, 1], [0, 1], color=REFERENCE, ls=":", lw=1.2)
        for name, colour in colours.items():
            confidence, correct = confidence_and_correct([row for row in rows if row["estimator"] == name])
            bins = reliability(confidence, correct)
            x, y = (np.array([getattr(one, what) for one in bins]) for what in ("confidence", "accuracy"))
            off = np.abs(np.array([one.interval for one in bins]).T - y)
            left.errorbar(x, y, off, fmt="none", ecolor=colour, elinewidth=1.2, capsize=2.5)
            area = 12 + 130 * np.array([one.n for one in bins]) / len(confidence)
            left.scatter(x, y, s=area, color=colour, zorder=3, label=f"{calibration_error(bins):.3f}")
            coverage = np.arange(1, len(confidence) + 1) / len(confidence)
            right.plot(coverage, risk(confidence, correct), color=colour)
            right.plot(coverage, np.maximum(1 - correct.mean() / coverage, 0), color=colour, ls=":", lw=1.2)
        left.set(xlabel="confidence", ylabel="accuracy", xlim=(-0.02, 1.03), ylim=(-0.02, 1.03), title="reliability")
        left.legend(title="expected calibration error", loc="lower right")
        right.set(xlabel="coverage: share of estimates, most confident first", ylabel="risk: share of these incorrect")
        right.set(xlim=(0, 1), title="risk against coverage")
        right.set_ylim(bottom=0)
        for axis in (left.xaxis, left.yaxis, right.xaxis, right.yaxis):
            axis.set_major_formatter(PercentFormatter(1, decimals=0))
        legend(drawn, colours)
    return drawn
