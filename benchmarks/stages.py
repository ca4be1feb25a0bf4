"""Ablation of ``rotation-search``: stages left out, fewer hypotheses, the verifier beside other choices.

    python benchmarks/stages.py out/stages-household --meshes FOLDER --only results/household-reporting.txt --pivot
    python benchmarks/stages.py out/stages-generated --count 400 --object-seed 100 --pivot --also out/stages-household

Rows as of ``reorient evaluate``, on its pairs, each variant an "estimator" (an interrupted run continues where it
stopped); then a Markdown table. "verifier" is its most probable hypothesis of the normal effort before it is polished,
"score" the hypothesis of the highest score, "oracle" the one nearest the truth; "default" is the whole estimator,
polished. "of 4": only the 4 hypotheses of the highest score were kept. All variants meet the same pairs, so beside
Wilson's interval stands the paired difference from "verifier", with a bootstrap interval over objects (pairs of one
object are not independent) and McNemar's exact test.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import binomtest

from reorient import load_estimator
from reorient.cli.arguments import Positional, parse
from reorient.cli.progress import show_progress
from reorient.errors import ReorientError
from reorient.estimators.search import EFFORTS, Effort, search
from reorient.estimators.verifier import features, load_verifier
from reorient.experiments.cells import answer_cells
from reorient.experiments.evaluation import Evaluation, measure_pairs
from reorient.imaging.goal import Goal
from reorient.registration import INLIER_TOLERANCE, Hypotheses, Problem, build_problem
from reorient.reporting.rows import estimators, numbers, read_rows
from reorient.runs.pool import Pool
from reorient.runs.run import Row
from reorient.world.pairs import Pair
from reorient.world.symmetry import SymmetryGroup, symmetric_error

NORMAL = EFFORTS["normal"]
REFERENCE = "verifier"
SCORED = INLIER_TOLERANCE, 1000  # tolerance (relative to the object diameter) and points of the score
RESAMPLES = 4000


@dataclass(frozen=True)
class Variant:
    """How hypotheses are made, how many are kept, and how one is chosen."""

    choose: str = "verifier"
    keep: int | None = None
    """So many of the best score; None: all."""
    effort: Effort = NORMAL


def _left_out() -> dict[str, Effort]:
    unperturbed = tuple(replace(stage, copies=0) for stage in NORMAL.stages)
    efforts = {
        "no perturbations": replace(NORMAL, stages=unperturbed),
        "a quarter of the modes": replace(NORMAL, modes=NORMAL.modes // 4),
    }
    for index in range(len(NORMAL.stages)):
        kept = NORMAL.stages[:index] + NORMAL.stages[index + 1 :]
        efforts[f"no stage {index + 1}"] = replace(NORMAL, stages=kept)
    return efforts


VARIANTS = (
    {name: Variant(name) for name in ("verifier", "score", "oracle")}
    | {f"{name} of {keep}": Variant(name, keep) for keep in (2, 4, 8) for name in ("verifier", "oracle")}
    | {
        f"{left_out}, {name}": Variant(name, None, effort)
        for left_out, effort in _left_out().items()
        for name in ("verifier", "oracle")
    }
)


@dataclass(frozen=True)
class Stages:
    """Ablation of ``rotation-search``: stages left out, fewer hypotheses, the verifier beside other choices."""

    out: Positional[Path]
    """Folder for config.json and rows.csv.gz."""
    config: Evaluation = field(
        default_factory=lambda: Evaluation(
            estimators=("default", *VARIANTS),
            ranges_deg=((0, 30), (30, 60), (60, 90), (90, 180)),
            noise_mm=(1.0,),
        )
    )
    pool: Pool = field(default_factory=Pool)
    also: tuple[Path, ...] = ()
    """Folders of other runs whose rows count in the table, too."""


def ablate(
    config: Evaluation, pair: Pair, goal: Goal, group: SymmetryGroup, pivot_m: Float[np.ndarray, "3"] | None
) -> list[dict[str, Any]]:
    """The answer of each variant; a set of hypotheses serves all variants that share it."""
    sets: dict[Effort, tuple[Problem, Hypotheses, float]] = {}
    measured = []
    for name in config.estimators:
        if name not in VARIANTS:
            begin = time.process_time()
            R = load_estimator(name).estimate(pair.current, goal, pivot_m).R_goal_current
            seconds = time.process_time() - begin
        else:
            variant = VARIANTS[name]
            if variant.effort not in sets:
                begin = time.process_time()
                problem = build_problem(pair.current, goal, pivot_m)
                hypotheses = search(problem, variant.effort).hypotheses
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
    if variant.choose == "verifier":
        best = np.argmax(load_verifier().log_odds(features(problem, hypotheses)))
    elif variant.choose == "oracle":
        best = np.argmin([symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object) for R in hypotheses.R])
    else:
        best = np.intp(0)
    return np.asarray(hypotheses.R[best])


HEAD = (
    *("range", "variant", "pairs", "< 5° sym. (95%)", f"less {REFERENCE}, points (95%)"),
    *(f"only it / only {REFERENCE}", "p", "ms"),
)


def markdown(rows: Sequence[Row]) -> str:
    """The table: for each range and for all together, every variant; noise levels count together."""
    right = numbers(rows, "error_sym_deg") < 5
    low_deg, milliseconds = numbers(rows, "low_deg"), 1000 * numbers(rows, "seconds")
    name, thing = (np.array([row[column] for row in rows]) for column in ("estimator", "object"))
    spans: dict[str, float | None] = {
        f"{float(row['low_deg']):g}–{float(row['high_deg']):g}°": float(row["low_deg"]) for row in rows
    }
    lines = [HEAD, ["---"] * 2 + ["---:"] * (len(HEAD) - 2)]
    for span, low in (spans | {"all": None}).items():
        cell = np.ones(len(rows), bool) if low is None else low_deg == low
        reference = right[cell & (name == REFERENCE)]
        for variant in estimators(rows):
            mine = cell & (name == variant)
            compared = ["", "", ""] if variant == REFERENCE else _compared(right[mine], reference, thing[mine])
            ms = f"{np.median(milliseconds[mine]):.0f}"
            lines.append([span, variant, str(mine.sum()), _share(right[mine]), *compared, ms])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _share(right: Bool[np.ndarray, " n"]) -> str:
    low, high = binomtest(int(right.sum()), len(right)).proportion_ci(method="wilson")
    return f"{right.mean():.1%} ({100 * low:.1f}–{100 * high:.1f})"


def _compared(right: Bool[np.ndarray, " n"], reference: Bool[np.ndarray, " n"], thing: np.ndarray) -> list[str]:
    """The paired difference with its interval, the pairs that only one gets right, and McNemar's p."""
    only, other = int((right & ~reference).sum()), int((reference & ~right).sum())
    low, high = _bootstrapped(right.astype(float) - reference, thing)
    p = binomtest(only, only + other).pvalue if only + other else 1.0
    return [f"{100 * (only - other) / len(right):+.1f} ({low:+.1f} to {high:+.1f})", f"{only} / {other}", f"{p:.2g}"]


def _bootstrapped(difference: Float[np.ndarray, " n"], thing: np.ndarray) -> tuple[float, float]:
    """95% interval of the mean in percent points, by drawing objects with all of their pairs."""
    names, place = np.unique(thing, return_inverse=True)
    total, count = np.bincount(place, difference), np.bincount(place)
    drawn = np.random.default_rng(0).integers(len(names), size=(RESAMPLES, len(names)))
    low, high = np.percentile(100 * total[drawn].sum(axis=1) / count[drawn].sum(axis=1), [2.5, 97.5])
    return float(low), float(high)


def verdict(rows: Sequence[Row]) -> str:
    """Whether Wilson's intervals of the verifier and the score are apart, all ranges together."""
    intervals = []
    for name in ("verifier", "score"):
        right = numbers([row for row in rows if row["estimator"] == name], "error_sym_deg") < 5
        intervals.append(binomtest(int(right.sum()), len(right)).proportion_ci(method="wilson"))
    (low, high), (other_low, other_high) = intervals
    return (
        f"verifier {low:.1%} to {high:.1%}, score {other_low:.1%} to {other_high:.1%}: "
        f"the intervals {'overlap' if low <= other_high and other_low <= high else 'are apart'}"
    )


def main(config: Stages) -> None:
    """Measure, then print the table."""
    show_progress("pairs", measure_pairs(config.config, config.out, ablate, config.pool, str(VARIANTS)))
    rows: list[Row] = []
    for folder in (config.out, *config.also):
        more = read_rows(folder)
        if set(estimators(more)) != set(config.config.estimators):
            raise ReorientError(f"{str(folder)!r} has other variants: expected {', '.join(config.config.estimators)}")
        rows += more
    print(markdown(rows))
    if {"verifier", "score"} <= set(config.config.estimators):
        print(f"\n{verdict(rows)}")


if __name__ == "__main__":
    main(parse(Stages, "benchmarks/stages.py", sys.argv[1:]))
