"""What each part of the default estimator is worth: stages left out, fewer hypotheses, the judge beside other choices.

    python benchmarks/stages.py out/stages-household --meshes FOLDER --only results/household-reporting.txt --pivot
    python benchmarks/stages.py out/stages-generated --count 400 --object-seed 100 --pivot --also out/stages-household

Rows as of ``reorient evaluate``, on its pairs, each variant an "estimator" (an interrupted run goes on where it
stopped); then a Markdown table. "judge" is the likeliest hypothesis of the normal effort before it is polished, "score"
the one of the best hand-made score, "oracle" the one nearest the truth; "default" is the whole estimator, polished.
"of 4": only the 4 hypotheses of the best score were kept. All variants meet the same pairs, so beside Wilson's interval
stands the paired difference from "judge", with a bootstrap interval over objects (pairs of one object are not
independent) and McNemar's exact test.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Bool, Float
from scipy.stats import binomtest

from reorient import load_estimator
from reorient.cli.progress import show_progress
from reorient.estimators.default import pose
from reorient.estimators.judge import features, load_judge
from reorient.estimators.refine import Hypotheses, Problem
from reorient.estimators.search import EFFORTS, Effort, search
from reorient.evaluation import Evaluation, Row, answer_cells, measure_pairs
from reorient.pairs import Pair
from reorient.reporting.rows import estimators, numbers, read_rows, wilson
from reorient.symmetry import SymmetryGroup, symmetric_error

NORMAL = EFFORTS["normal"]
REFERENCE = "judge"
SCORED = 0.015, 1000  # tolerance (in sizes) and points of the hand-made score
RESAMPLES = 4000


@dataclass(frozen=True)
class Variant:
    """How hypotheses are made, how many are kept, and who chooses."""

    choose: str = "judge"
    keep: int | None = None
    """So many of the best score; None: all."""
    effort: Effort = NORMAL


def _left_out() -> dict[str, Effort]:
    unscattered = tuple(replace(stage, copies=0) for stage in NORMAL.stages)
    efforts = {
        "no scattering": replace(NORMAL, stages=unscattered),
        "a quarter of the modes": replace(NORMAL, modes=NORMAL.modes // 4),
    }
    for index, said in ((0, "first"), (-1, "last")):
        kept = list(NORMAL.stages)
        del kept[index]
        efforts[f"no {said} stage"] = replace(NORMAL, stages=tuple(kept))
    return efforts


VARIANTS = (
    {name: Variant(name) for name in ("judge", "score", "oracle")}
    | {f"{name} of {keep}": Variant(name, keep) for keep in (2, 4, 8) for name in ("judge", "oracle")}
    | {
        f"{said}, {name}": Variant(name, None, effort)
        for said, effort in _left_out().items()
        for name in ("judge", "oracle")
    }
)


@dataclass(frozen=True)
class Stages:
    """What to run."""

    out: tyro.conf.Positional[Path]
    """Folder for config.json and rows.csv.gz."""
    config: Evaluation = field(
        default_factory=lambda: Evaluation(
            estimators=("default", *VARIANTS),
            ranges_deg=((0, 30), (30, 60), (60, 90), (90, 180)),
            noise_mm=(1.0,),
        )
    )
    workers: int = 1
    also: tuple[Path, ...] = ()
    """Folders of other runs whose rows count in the table, too."""


def ablate(
    config: Evaluation, pair: Pair, group: SymmetryGroup, pivot_m: Float[np.ndarray, "3"] | None
) -> list[dict[str, Any]]:
    """What each variant answers; a set of hypotheses serves all variants that share it."""
    sets: dict[Effort, tuple[Problem, Hypotheses, float]] = {}
    measured = []
    for name in config.estimators:
        if name not in VARIANTS:
            begin = time.process_time()
            R = load_estimator(name).estimate(pair.current, pair.goal, pivot_m).R_goal_current
            seconds = time.process_time() - begin
        else:
            variant = VARIANTS[name]
            if variant.effort not in sets:
                begin = time.process_time()
                problem = pose(pair.current, pair.goal, pivot_m)
                hypotheses = search(problem, variant.effort)
                hypotheses = hypotheses[np.argsort(-problem.score(hypotheses, *SCORED), kind="stable")]
                sets[variant.effort] = problem, hypotheses, time.process_time() - begin
            problem, hypotheses, seconds = sets[variant.effort]
            begin = time.process_time()
            R = _chosen(variant, problem, hypotheses[np.arange(len(hypotheses))[: variant.keep]], pair, group)
            seconds += time.process_time() - begin
        measured.append(answer_cells(R, pair, group) | {"seconds": f"{seconds:.5f}"})
    return measured


def _chosen(
    variant: Variant, problem: Problem, hypotheses: Hypotheses, pair: Pair, group: SymmetryGroup
) -> Float[np.ndarray, "3 3"]:
    """One of the hypotheses, which come in the order of their score."""
    if variant.choose == "judge":
        best = np.argmax(load_judge().log_odds(features(problem, problem.looks[0], hypotheses)))
    elif variant.choose == "oracle":
        best = np.argmin([symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object) for R in hypotheses.R])
    else:
        best = np.intp(0)
    return hypotheses.R[best]


def markdown(rows: Sequence[Row]) -> str:
    """The table: for each range and all together, every variant against the reference."""
    right = numbers(rows, "error_sym_deg") < 5
    low_deg, milliseconds = numbers(rows, "low_deg"), 1000 * numbers(rows, "seconds")
    name, thing = (np.array([row[column] for row in rows]) for column in ("estimator", "object"))
    spans = {f"{row['low_deg']}–{row['high_deg']}°": float(row["low_deg"]) for row in rows}
    head = (
        "range",
        "variant",
        "pairs",
        "< 5° sym. (95%)",
        f"less {REFERENCE}, points (95%)",
        "only it / only judge",
        "p",
        "ms",
    )
    lines = [head, ["---"] * 2 + ["---:"] * (len(head) - 2)]
    for span, low in (*sorted(spans.items(), key=lambda x: x[1]), ("all", None)):
        cell = np.ones(len(rows), bool) if low is None else low_deg == low
        reference = right[cell & (name == REFERENCE)]
        for variant in estimators(rows):
            mine = cell & (name == variant)
            hits, n = int(right[mine].sum()), int(mine.sum())
            less, more = wilson(hits, n)
            line = [span, variant, str(n), f"{hits / n:.1%} ({100 * less:.1f}–{100 * more:.1f})"]
            if variant != REFERENCE:
                only, other = int((right[mine] & ~reference).sum()), int((reference & ~right[mine]).sum())
                low_end, high_end = _bootstrapped(right[mine].astype(float) - reference, thing[mine])
                p = binomtest(only, only + other).pvalue if only + other else 1.0
                line += [
                    f"{100 * (only - other) / n:+.1f} ({low_end:+.1f} to {high_end:+.1f})",
                    f"{only} / {other}",
                    f"{p:.2g}",
                ]
            else:
                line += ["", "", ""]
            lines.append([*line, f"{np.median(milliseconds[mine]):.0f}"])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _bootstrapped(difference: Float[np.ndarray, " n"], thing: np.ndarray) -> tuple[float, float]:
    """95% interval of the mean in percent points, by drawing objects with all of their pairs."""
    names, place = np.unique(thing, return_inverse=True)
    total, count = np.bincount(place, difference), np.bincount(place)
    drawn = np.random.default_rng(0).integers(len(names), size=(RESAMPLES, len(names)))
    low, high = np.percentile(100 * total[drawn].sum(axis=1) / count[drawn].sum(axis=1), [2.5, 97.5])
    return float(low), float(high)


def verdict(right: dict[str, Bool[np.ndarray, " n"]]) -> str:
    """Whether Wilson's intervals of the judge and the hand-made score are apart."""
    (low, high), (other_low, other_high) = (
        wilson(int(right[name].sum()), len(right[name])) for name in ("judge", "score")
    )
    apart = low > other_high or high < other_low
    return (
        f"judge {low:.1%} to {high:.1%}, hand-made score {other_low:.1%} to {other_high:.1%}: "
        f"the intervals {'do not ' if apart else ''}overlap"
    )


def main(config: Stages) -> None:
    """Measure, then print the table."""
    show_progress("pairs", measure_pairs(config.config, config.out, ablate, config.workers, str(VARIANTS)))
    rows = [row for folder in (config.out, *config.also) for row in read_rows(folder)]
    print(markdown(rows))
    right = numbers(rows, "error_sym_deg") < 5
    name = np.array([row["estimator"] for row in rows])
    if {"judge", "score"} <= set(name):
        print(f"\n{verdict({one: right[name == one] for one in ('judge', 'score')})}")


if __name__ == "__main__":
    main(tyro.cli(Stages, description=__doc__, config=(tyro.conf.OmitArgPrefixes,)))
