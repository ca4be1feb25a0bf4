"""A number with its interval, beside the paper's; and whether it holds when a part of it is measured again."""

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.stats import binomtest

from reorient.reporting.page import table
from reorient.runs.files import replacing

RESAMPLES = 1000
Statistic = Literal["mean", "median"]


@dataclass(frozen=True)
class Finding:
    """One number of a figure."""

    what: str
    """The same words in the whole figure and in a part of it."""
    value: float
    low: float
    high: float
    """Ends of the 95% interval; NaN where there is none."""
    n: int
    unit: str = "°"
    paper: str = ""
    """What the paper has for it."""
    differs: str = ""
    """What is not as in the paper."""


def interval(
    values: Float[np.ndarray, " n"], groups: Sequence[str], statistic: Statistic = "mean"
) -> tuple[float, float]:
    """95% bootstrap interval of a statistic; whole groups (objects) are drawn, as errors of one object go together."""
    which = np.unique(np.asarray(groups), return_inverse=True)[1]
    count = int(which.max()) + 1
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(count, np.full(count, 1 / count), size=RESAMPLES)  # how often each group is
    if statistic == "mean":
        found = drawn @ np.bincount(which, values) / (drawn @ np.bincount(which))
    else:
        order = np.argsort(values)
        weight = np.cumsum(drawn[:, which[order]], axis=1)
        found = values[order][np.argmax(weight >= weight[:, -1:] / 2, axis=1)]
    low, high = np.percentile(found, [2.5, 97.5])
    return float(low), float(high)


def number(
    what: str,
    values: Float[np.ndarray, " n"],
    groups: Sequence[str],
    statistic: Statistic = "mean",
    *,
    unit: str = "°",
    paper: str = "",
    differs: str = "",
) -> Finding:
    """A statistic of some values, with its interval."""
    value = float(np.mean(values) if statistic == "mean" else np.median(values))
    return Finding(what, value, *interval(values, groups, statistic), len(values), unit, paper, differs)


def share(what: str, hits: np.ndarray, groups: Sequence[str], *, paper: str = "", differs: str = "") -> Finding:
    """A share in percent; its interval covers both Wilson's and the bootstrap's, which is empty at 0 and 100%."""
    low, high = interval(hits.astype(float), groups)
    first, last = binomtest(int(hits.sum()), len(hits)).proportion_ci(method="wilson")
    return Finding(
        what, 100 * float(np.mean(hits)), 100 * min(low, first), 100 * max(high, last), len(hits), "%", paper, differs
    )


def held(part: Finding, whole: Finding) -> bool | None:
    """Whether two measurements on different pairs agree within their intervals; None where they have none."""
    below, above = sorted((part, whole), key=lambda finding: finding.value)
    room = float(np.hypot(below.high - below.value, above.value - above.low))
    return None if np.isnan(room) else above.value - below.value <= room


def write_findings(findings: Sequence[Finding], path: Path) -> None:
    """As a plain CSV table."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(asdict(findings[0])))
        writer.writeheader()
        for finding in findings:
            writer.writerow({key: f"{x:.4f}" if isinstance(x, float) else x for key, x in asdict(finding).items()})


WORDS = (0, 5)  # which of the columns are set to the left
HEADINGS = ("number", "paper", "ours", "95%", "n", "what differs")


def cells(finding: Finding) -> list[str]:
    """One line of a table with these headings."""
    digits = 1 if finding.unit == "%" else 4 if finding.unit == "" else 2
    value, low, high = (f"{x:.{digits}f}" for x in (finding.value, finding.low, finding.high))
    known = "–" if np.isnan(finding.low) else f"{low}–{high}"
    return [finding.what, finding.paper or "–", f"{value}{finding.unit}", known, str(finding.n), finding.differs]


def html_findings(findings: Sequence[Finding]) -> str:
    """The table as HTML."""
    return table(HEADINGS, [cells(finding) for finding in findings], WORDS, "numbers")
