"""Gauss-Newton against a random local search, from the same proposals, by processor time.

    python benchmarks/refining.py --meshes FOLDER --only NAMES --pairs 40

The random search: rounds of perturbations of every hypothesis, the best of which it becomes where that agrees better;
0.15 rad and 6 mm at first, shrinking by 0.6 a round, while the tolerance falls from 10 to 3 mm. Gauss-Newton: the steps
of ``default`` without its scattering. Both start from the best 24 proposals and end with the same 4 fine steps.
"Best": share of pairs with a hypothesis within 5 degrees; "chosen": whose best agreement is one.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import tyro

from reorient import so3
from reorient.estimators.default import pose
from reorient.estimators.refine import Hypotheses, Problem, descend, scatter
from reorient.estimators.search import EFFORTS, propose
from reorient.objects import ObjectSource
from reorient.pairs import sample_pair
from reorient.rendering import Renderer, load_world
from reorient.sensing import randomised

MODES = replace(EFFORTS["normal"], modes=24)
COARSE, MIDDLE, FINE = (stage.tolerances for stage in EFFORTS["normal"].stages[:3])
RANGES_DEG = ((60, 90), (90, 180))


def gauss_newton(problem: Problem, hypotheses: Hypotheses) -> Hypotheses:
    """Twelve steps, on 200 and 400 points of each image."""
    return descend(problem, descend(problem, hypotheses, COARSE, 200), MIDDLE, 400)


def random_search(tries: int, points: int) -> Callable[[Problem, Hypotheses], Hypotheses]:
    """Six rounds of so many perturbations, compared on so many points of each image."""

    def run(problem: Problem, hypotheses: Hypotheses) -> Hypotheses:
        rng = np.random.default_rng(0)
        for k, tolerance_m in enumerate(np.linspace(0.010, 0.003, 6)):
            size_m, smaller = problem.frame.size_m, 0.6**k * np.sqrt(3)
            hypotheses = scatter(
                problem,
                hypotheses,
                rng,
                tries,
                0.15 * smaller,
                0.006 * smaller / size_m,
                tolerance_m / size_m,
                points,
            )
        return hypotheses

    return run


REFINERS = {
    "Gauss-Newton": gauss_newton,
    "random, 12 tries": random_search(12, 300),
    "random, 80 tries": random_search(80, 300),
}


@dataclass(frozen=True)
class Refining:
    """What to run."""

    source: tyro.conf.OmitArgPrefixes[ObjectSource] = field(default_factory=ObjectSource)
    pairs: int = 40
    """Of each range, spread over the objects."""
    noise_mm: float = 1.0


def main(config: Refining) -> None:
    """All pairs, with the nominal pivot; then the table."""
    objects, world = config.source.open(), load_world("benchmark")
    found: dict[tuple[str, int], list[tuple[bool, bool, float]]] = {}
    for index in range(config.pairs):
        renderer = Renderer(objects.load(objects.names[index % len(objects.names)]))
        for low, high in RANGES_DEG:
            rng = np.random.default_rng([9, index, low])
            sensor = randomised(config.noise_mm / 1000)
            pair = sample_pair(rng, renderer, world, sensor, np.radians(low), np.radians(high))
            problem = pose(pair.current, pair.goal, pair.pivot_m)
            start = propose(problem, MODES)
            for name, refiner in REFINERS.items():
                begin = time.process_time()
                refined = refiner(problem, start)
                seconds = time.process_time() - begin
                end = descend(problem, refined, FINE, 1000)
                right = np.degrees(so3.angle_difference(end.R, pair.R_goal_current)) < 5
                chosen = np.argmax(problem.score(end, 0.015, 1000))
                found.setdefault((name, low), []).append((bool(right.any()), bool(right[chosen]), seconds))
    for (name, low), rows in sorted(found.items(), key=lambda item: (item[0][1], item[0][0])):
        best, chosen_right, seconds_each = np.array(rows, float).T
        print(
            f"from {low} degrees, {name:16s}: best {best.mean():.1%}, chosen {chosen_right.mean():.1%}, "
            f"{1000 * np.median(seconds_each):.0f} ms"
        )


if __name__ == "__main__":
    main(tyro.cli(Refining, description=__doc__))
