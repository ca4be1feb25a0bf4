"""From the rows of the sweeps to sentences: where learning is ahead of geometry, and where neither is."""

from collections.abc import Mapping, Sequence

from reorient.reporting.rows import numbers
from reorient.reproducing.findings import interval
from reorient.runs.run import Row

RIVALS = (("swift", "gicp"), ("paper", "icp"))  # learned, geometric: the best of each here, then the paper's


def conclude(sweeps: Mapping[str, Mapping[str, Sequence[Row]]]) -> list[str]:
    """One sentence on where the best of learning is ahead at all, then one for each pair of rivals and sweep.

    ``sweeps``: by what is varied, the rows by level in words. Shares within 5 degrees are compared pair by pair; ahead
    means that the 95% interval of the difference leaves out zero, so one level in twenty may seem so by chance.
    """
    sentences, wins = [], []
    for learned, geometric in RIVALS:
        for sweep, levels in sweeps.items():
            ahead: dict[str, list[str]] = {learned: [], geometric: [], "": []}
            for level, rows in levels.items():
                low, high, mine, other = _compared(rows, learned, geometric)
                winner = learned if low > 0 else geometric if high < 0 else ""
                ahead[winner].append(f"{level} ({mine:.0%} and {other:.0%})")
                if winner == RIVALS[0][0]:
                    wins.append(level)
            parts = [f"{name} is ahead at {_listed(at, len(levels))}" for name, at in ahead.items() if name and at]
            if ahead[""]:
                parts.append(f"no difference is significant at {_listed(ahead[''], len(levels))}")
            sentences.append(f"{sweep.capitalize()}; {learned} and {geometric}: {'; '.join(parts)}.")
    count = sum(len(levels) for levels in sweeps.values())
    first = f"Learning ({RIVALS[0][0]}) is ahead of geometry ({RIVALS[0][1]}) at {len(wins)} of {count} levels"
    return [first + (f": {', '.join(wins)}." if wins else "."), *sentences]


def _listed(levels: Sequence[str], of: int) -> str:
    return f"every level, from {levels[0]} to {levels[-1]}" if len(levels) == of > 1 else ", ".join(levels)


def _compared(rows: Sequence[Row], learned: str, geometric: str) -> tuple[float, float, float, float]:
    """The interval of the learned's share within 5 degrees less the geometric's, and both shares."""
    mine, other = ([row for row in rows if row["estimator"] == name] for name in (learned, geometric))
    within, within_other = ((numbers(chosen, "error_deg") < 5).astype(float) for chosen in (mine, other))
    return (
        *interval(within - within_other, [row["object"] for row in mine]),
        float(within.mean()),
        float(within_other.mean()),
    )
