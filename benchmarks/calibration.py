"""What a confidence is worth, from an evaluation's rows: reliability, calibration error, risk against coverage.

    python benchmarks/calibration.py results/default-pivot

Right means a symmetry-aware error below 5 degrees. The calibration error is over ten equal bins of confidence, each
weighted by its pairs.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from reorient.reporting.rows import numbers, read_rows, wilson


@dataclass(frozen=True)
class Calibration:
    """Which rows."""

    folder: tyro.conf.Positional[Path]
    """What ``reorient evaluate`` wrote."""
    estimator: str = "default"
    bins: int = 10
    sure: float = 0.9
    """Confidence from which an answer counts as sure."""


def main(config: Calibration) -> None:
    """Print the tables."""
    rows = [row for row in read_rows(config.folder) if row["estimator"] == config.estimator and row["confidence"]]
    said = numbers(rows, "confidence")
    right = numbers(rows, "error_sym_deg") < 5
    low_deg = numbers(rows, "low_deg")
    place = np.minimum((said * config.bins).astype(int), config.bins - 1)
    print("confidence  pairs   said    was  (95% interval)")
    off = 0.0
    for k in range(config.bins):
        chosen = place == k
        if n := int(chosen.sum()):
            hits = int(right[chosen].sum())
            low, high = wilson(hits, n)
            off += abs(said[chosen].mean() - hits / n) * n / len(rows)
            edges = f"{k / config.bins:.1f}-{(k + 1) / config.bins:.1f}"
            print(f"{edges:10s} {n:6d}  {said[chosen].mean():5.1%}  {hits / n:5.1%}  ({low:.0%}-{high:.0%})")
    print(f"{len(rows)} pairs, right {right.mean():.1%}, expected calibration error {off:.3f}")
    for upto in (90, 180):
        pairs = low_deg < upto
        sure = pairs & (said >= config.sure)
        share = right[sure].mean() if sure.any() else float("nan")
        print(
            f"up to {upto} degrees: sure of {sure.sum() / pairs.sum():.1%}, of which right {share:.1%} (n={sure.sum()})"
        )
    order = np.argsort(-said, kind="stable")
    risk = 1 - np.cumsum(right[order]) / np.arange(1, len(rows) + 1)
    print(
        "risk at coverage "
        + ", ".join(f"{c:.0%}: {risk[int(c * len(rows)) - 1]:.1%}" for c in (0.5, 0.7, 0.8, 0.9, 1.0))
    )


if __name__ == "__main__":
    main(tyro.cli(Calibration, description=__doc__))
