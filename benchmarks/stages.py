"""Each stage of the default estimator left out: share within 5 degrees of the answer, and of the best hypothesis.

    python benchmarks/stages.py out/stages.csv.gz --meshes FOLDER --only NAMES --pairs 40

One row a pair, range and variant. "Chosen" is the answer before polishing: by the judge, or by the hand-made score.
Time is of the process (CPU), so that other work on the machine does not count.
"""

import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tyro
from rich.progress import track

from reorient import so3
from reorient.estimators.default import pose
from reorient.estimators.judge import features, load_judge
from reorient.estimators.search import EFFORTS, Effort, search
from reorient.files import make_folder, write_table
from reorient.objects import ObjectSource
from reorient.pairs import sample_pair
from reorient.rendering import Renderer, load_world
from reorient.sensing import randomised

NORMAL = EFFORTS["normal"]
VARIANTS: dict[str, Effort] = {
    "fast": EFFORTS["fast"],
    "normal": NORMAL,
    "without scattering": replace(NORMAL, stages=tuple(replace(stage, copies=0) for stage in NORMAL.stages)),
    "12 modes": replace(NORMAL, modes=12),
    "one stage": replace(NORMAL, stages=NORMAL.stages[:1]),
}
RANGES_DEG = ((30, 60), (60, 90), (90, 180))


@dataclass(frozen=True)
class Stages:
    """What to run."""

    out: tyro.conf.Positional[Path]
    """CSV.gz to write."""
    source: tyro.conf.OmitArgPrefixes[ObjectSource] = field(default_factory=ObjectSource)
    pairs: int = 40
    """Of each range, spread over the objects."""
    noise_mm: float = 1.0
    pivot: bool = True


def main(config: Stages) -> None:
    """All pairs, then the summary."""
    make_folder(config.out.parent)
    objects, world, judge = config.source.open(), load_world("benchmark"), load_judge()
    rows = []
    for index in track(range(config.pairs), "pairs"):
        name = objects.names[index % len(objects.names)]
        renderer = Renderer(objects.load(name))
        for low, high in RANGES_DEG:
            rng = np.random.default_rng([7, index, low])
            pair = sample_pair(
                rng, renderer, world, randomised(config.noise_mm / 1000), np.radians(low), np.radians(high)
            )
            for variant, effort in VARIANTS.items():
                begin = time.process_time()
                problem = pose(pair.current, pair.goal, pair.pivot_m if config.pivot else None)
                hypotheses = search(problem, effort)
                score = problem.score(hypotheses, 0.015, 1000)
                odds = judge.log_odds(features(problem, problem.looks[0], hypotheses))
                seconds = time.process_time() - begin
                error = np.degrees(so3.angle_difference(hypotheses.R, pair.R_goal_current))
                rows.append(
                    {
                        "object": name,
                        "pair": index,
                        "low_deg": low,
                        "variant": variant,
                        "best_deg": f"{error.min():.4f}",
                        "judge_deg": f"{error[np.argmax(odds)]:.4f}",
                        "score_deg": f"{error[np.argmax(score)]:.4f}",
                        "seconds": f"{seconds:.4f}",
                    }
                )
    write_table(config.out, rows)
    for variant in VARIANTS:
        print(variant)
        for low, high in RANGES_DEG:
            chosen = [row for row in rows if row["variant"] == variant and row["low_deg"] == low]
            share = {
                key: np.mean([float(str(row[key])) < 5 for row in chosen])
                for key in ("best_deg", "judge_deg", "score_deg")
            }
            ms = 1000 * np.median([float(str(row["seconds"])) for row in chosen])
            print(
                f"  {low}-{high}: best of the set {share['best_deg']:.1%}, judge {share['judge_deg']:.1%}, "
                f"hand-made {share['score_deg']:.1%}, {ms:.0f} ms"
            )


if __name__ == "__main__":
    main(tyro.cli(Stages, description=__doc__))
