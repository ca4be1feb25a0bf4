"""What a confidence is worth, from an evaluation's rows: reliability, calibration error, risk against coverage.

    python benchmarks/calibration.py results/default-pivot --png out/calibration.png

Right means a symmetry-aware error below 5 degrees. The calibration error is over ten equal bins of confidence, each
weighted by its pairs.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reorient.cli.arguments import Positional, parse
from reorient.reporting.rows import numbers, read_rows
from reorient.reporting.trust import calibration_error, confidence_and_correct, confident, figure, reliability, risk
from reorient.runs.files import replacing


@dataclass(frozen=True)
class Calibration:
    """Which rows."""

    folder: Positional[Path]
    """What ``reorient evaluate`` wrote."""
    estimator: str = "default"
    bins: int = 10
    sure: float = 0.9
    """Confidence from which an answer counts as sure."""
    png: Path | None = None
    """Draw the reliability diagram and the risk-coverage curve here."""


def main(config: Calibration) -> None:
    """Print the tables; draw."""
    rows = [row for row in confident(read_rows(config.folder)) if row["estimator"] == config.estimator]
    if not rows:
        raise SystemExit(
            f"no confidences of {config.estimator!r} in {str(config.folder)!r}: expected rows that have one"
        )
    said, right = confidence_and_correct(rows)
    bins = reliability(said, right, config.bins)
    print("confidence  pairs   said    was  (95% interval)")
    for one in bins:
        low, high = one.interval
        edges = f"{one.low:.1f}-{one.high:.1f}"
        print(f"{edges:10s} {one.n:6d}  {one.confidence:5.1%}  {one.accuracy:5.1%}  ({low:.0%}-{high:.0%})")
    print(f"{len(rows)} pairs, right {right.mean():.1%}, expected calibration error {calibration_error(bins):.3f}")
    low_deg = numbers(rows, "low_deg")
    for upto in (90, 180):
        pairs = low_deg < upto
        sure = pairs & (said >= config.sure)
        share = right[sure].mean() if sure.any() else float("nan")
        print(
            f"up to {upto} degrees: sure of {sure.sum() / pairs.sum():.1%}, of which right {share:.1%} (n={sure.sum()})"
        )
    wrong = risk(said, right)
    print(
        "risk at coverage "
        + ", ".join(f"{c:.0%}: {wrong[int(np.ceil(c * len(rows))) - 1]:.1%}" for c in (0.5, 0.7, 0.8, 0.9, 1.0))
    )
    if config.png is not None:
        with replacing(config.png) as temporary:
            figure(rows).savefig(temporary, dpi=150)


if __name__ == "__main__":
    main(parse(Calibration, "benchmarks/calibration.py", sys.argv[1:]))
