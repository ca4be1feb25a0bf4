"""From the rows of the sweeps to sentences: where learning is ahead of geometry, and where that cannot be told."""

from collections.abc import Mapping, Sequence

import numpy as np

from reorient.evaluation import Row
from reorient.reporting.rows import numbers
from reorient.reproducing.findings import interval

RIVALS = (("swift", "gicp"), ("paper", "icp"))  # ours and the paper's: learned, geometric
Levels = Mapping[float, Sequence[Row]]


def conclude(sweeps: Mapping[str, Levels], words: Mapping[str, str]) -> list[str]:
    """A sentence for each pair of rivals and sweep, and one on where learning is ahead at all.

    ``words``: what a sweep varies. Shares within 5 degrees are compared pair by pair; ahead means that the 95%
    interval of the difference leaves out zero.
    """
    sentences, wins = [], []
    for learned, geometric in RIVALS:
        for sweep, levels in sweeps.items():
            ahead: dict[str, list[str]] = {learned: [], geometric: [], "": []}
            for level, rows in levels.items():
                low, high, said = _difference(rows, learned, geometric)
                winner = learned if low > 0 else geometric if high < 0 else ""
                ahead[winner].append(f"{level:g} ({said})")
                if winner == learned:
                    wins.append(f"{learned} over {geometric}, {words[sweep]} {level:g}")
            parts = [f"{name} is ahead at {', '.join(at)}" for name, at in ahead.items() if name and at]
            if ahead[""]:
                parts.append(f"nobody can be told to be ahead at {', '.join(ahead[''])}")
            sentences.append(f"{words[sweep]}, {learned} against {geometric}: {'; '.join(parts)}.")
    first = (
        f"Learning is ahead of geometry at {len(wins)} of the levels: {'; '.join(wins)}."
        if wins
        else "Learning is ahead of geometry at none of the levels."
    )
    return [first, *sentences]


def _difference(rows: Sequence[Row], learned: str, geometric: str) -> tuple[float, float, str]:
    """The interval of the learned's share within 5 degrees less the geometric's, and both shares in words."""
    mine, other = ([row for row in rows if row["estimator"] == name] for name in (learned, geometric))
    within, rival = numbers(mine, "error_deg") < 5, numbers(other, "error_deg") < 5
    low, high = interval(within.astype(float) - rival.astype(float), [row["object"] for row in mine])
    return low, high, f"{np.mean(within):.0%} / {np.mean(rival):.0%}"
