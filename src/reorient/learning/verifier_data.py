"""Data of the verifiers: hypotheses of known error, from rendered objects before a simulated sensor.

The data is a resumable run (``reorient.runs``) with a file for a few objects. With several views the features are those
of the verifier of several views.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.errors import ReorientError, check_counts, check_range, unknown_name
from reorient.estimators.base import History
from reorient.estimators.image_evidence import evidence_images
from reorient.estimators.search import EFFORTS, search
from reorient.estimators.verifier import FEATURES, features, load_verifier
from reorient.estimators.views_verifier import VIEWS_FEATURES, views_features
from reorient.imaging import DepthImage, Goal
from reorient.registration import Hypotheses, Problem, aligned_goal, build_problem
from reorient.registration.build import OBSERVATIONS
from reorient.runs.files import replacing
from reorient.runs.pool import Pool
from reorient.runs.run import Progress, resumable
from reorient.world.goals import ALL_ROUND, sample_goal, sample_history, with_goal_of
from reorient.world.objects import ObjectSource
from reorient.world.pairs import Pair, sample_pair, scene_of
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised
from reorient.world.static_parts import with_static_part
from reorient.world.symmetry import mirror_residual, rotation_group, symmetric_error

RANGES_DEG = ((0, 30), (30, 60), (60, 90), (90, 180))
PIVOT_SHARE = 0.6  # of the pairs come with a pivot
STATIC_SHARES, STATIC_NOISE_M = (0.1, 0.75), 0.001  # of the returns; of their depth
CHIRAL_ABOVE = 0.1  # of the RMS radius, the distance of the mirrored object: less is lost in the errors of the images
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class VerifierData:
    """Data to make."""

    objects: ObjectSource = field(default_factory=lambda: ObjectSource(count=5000))
    """Objects of the pairs."""
    pairs: int = 8
    """Number of pairs of each object."""
    per_shard: int = 5
    """Number of objects in a file."""
    world: str = "benchmark"
    """Preset of camera, size and distance: benchmark, paper or in_hand."""
    in_hand: float = 0.0
    """Share of the pairs that are of the preset in_hand, before the camera of the world."""
    static: float = 0.0
    """Share of the pairs with a part that does not move with the object: 10 to 75% of the pixels."""
    wrong_pivot: float = 0.0
    """Share of the pivots that are 2 to 15 cm off."""
    most_noise_mm: float = 3.0
    """Largest depth noise: a quarter of the pairs has none, half up to 1 mm, the rest up to this."""
    most_wrong_focal: float = 0.02
    """Largest relative error of the stated focal length."""
    goal_views: tuple[int, ...] = (1,)
    """Numbers of goal views, of which each pair has one at random; with others than 1 the data is for the verifier of
    several views."""
    views_now: tuple[int, ...] = (1,)
    """The same for the views of the object now, the current one and earlier ones."""
    slip_deg: float = 2.0
    """Largest error of the stated rotations of further goal views."""
    mirrored: float = 0.0
    """Share of the pairs whose goal is of the mirrored object, so that no hypothesis is right; of objects that are
    nearly their own mirror image there are none."""
    effort: str = "normal"
    """Effort of the search that makes the hypotheses: fast or normal."""
    least_deg: float = 0.0
    """Only the ranges of rotation angles (0-30, 30-60, 60-90, 90-180 degrees) from here on."""
    images: bool = False
    """Keep the evidence images of the hypotheses, too: about 50 kB a pair."""
    seed: int = 0
    """Seed of the pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range, an unknown world and an unknown effort."""
        load_world(self.world)
        if self.effort not in EFFORTS:
            raise unknown_name("effort", self.effort, list(EFFORTS))
        check_counts(self, "pairs", "per_shard")
        check_range(self, "seed", "most_noise_mm")
        check_range(self, "goal_views", low=1, high=ALL_ROUND)
        check_range(self, "views_now", low=1, high=1 + OBSERVATIONS)
        check_range(self, "slip_deg", high=180)
        check_range(self, "least_deg", high=RANGES_DEG[-1][0])
        check_range(self, "in_hand", "static", "wrong_pivot", "mirrored", high=1)
        check_range(self, "most_wrong_focal", high=1, below=True)
        if self.images and self.several_views:
            raise ReorientError("images and several views: expected evidence images of one view now and one goal view")

    @property
    def ranges_deg(self) -> tuple[tuple[int, int], ...]:
        """The ranges of rotation angles, of which the pairs of an object have one after the other."""
        return tuple(x for x in RANGES_DEG if x[0] >= self.least_deg)

    @property
    def several_views(self) -> bool:
        """Whether the data is for the verifier of several views."""
        return {*self.goal_views, *self.views_now} != {1}


def make(config: VerifierData, out: Path, pool: Pool | None = None) -> Progress:
    """Write the shards that are missing in ``out``; yields (shards done, shards in all).

    Raises ReorientError as ``resumable``.
    """
    names = config.objects.open().names
    tasks = {
        f"shard-{begin:06d}": (config, begin, names[begin : begin + config.per_shard])
        for begin in range(0, len(names), config.per_shard)
    }
    yield from resumable(out, config, tasks, _make_shard, _ShardStore(), pool)


class _ShardStore:
    """A file ``<task>.npz`` for each task."""

    def finished(self, folder: Path) -> bool:
        return False  # a shard may have been removed

    def done(self, folder: Path) -> set[str]:
        return {file.stem for file in folder.glob("shard-*.npz")}

    def keep(self, folder: Path, task: str, result: Arrays) -> None:
        with replacing(folder / f"{task}.npz") as temporary:
            np.savez_compressed(temporary, **result)  # type: ignore[arg-type]

    def pack(self, folder: Path, tasks: Sequence[str]) -> None:
        pass


def _make_shard(task: tuple[VerifierData, int, tuple[str, ...]]) -> Arrays:
    """All hypotheses of a few objects, of which the first is number ``begin`` of the source."""
    config, begin, names = task
    objects = config.objects.open()
    parts: list[Arrays] = []
    for number, name in enumerate(names, start=begin):
        try:
            renderer = Renderer(objects.load(name))
        except ReorientError:
            continue
        parts += _hypotheses(config, renderer, number)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}
    return columns | {"features": np.array(VIEWS_FEATURES if config.several_views else FEATURES)}


@dataclass(frozen=True, eq=False)
class Sample:
    """One pair with the errors of its images, as an estimator receives it."""

    low_deg: float
    """Of the range of its angle."""
    noise_m: float
    pair: Pair
    current: DepthImage
    goal: Goal
    history: History
    pivot_m: Float[np.ndarray, "3"] | None
    mirrored: bool
    """Whether the goal is of the mirrored object."""


def samples(config: VerifierData, renderer: Renderer, number: int) -> Iterator[tuple[int, Sample]]:
    """The pairs of object ``number``, each with its index; those that show too little are left out."""
    world = load_world(config.world)
    other = _mirrored(renderer) if config.mirrored else None
    for index in range(config.pairs):
        rng = np.random.default_rng([config.seed, number, index])
        low_deg, high_deg = config.ranges_deg[index % len(config.ranges_deg)]
        try:
            held = world.sometimes_in_hand(rng, config.in_hand)
            noise_m = _noise_m(rng, config.most_noise_mm)
            sensor = randomised(noise_m)
            pair = sample_pair(rng, renderer, held, sensor, np.radians(low_deg), np.radians(high_deg))
        except ReorientError:  # a sheet that shows too little from everywhere
            continue
        if rng.random() < config.static:
            pair = _with_static_part(rng, renderer, pair)
        views, earlier = (int(rng.choice(x)) if x != (1,) else 1 for x in (config.goal_views, config.views_now))
        shown = renderer
        if mirrored := config.mirrored > 0 and rng.random() < config.mirrored:
            if other is None or (of_mirrored := with_goal_of(rng, other, held, sensor, pair)) is None:
                continue
            shown, pair = other, of_mirrored
        goal = sample_goal(rng, shown, held, sensor, pair, views, np.radians(config.slip_deg))
        earlier_images: History = sample_history(rng, renderer, held, sensor, pair, earlier - 1)
        images = pair.current, goal, earlier_images
        current, goal, history = _with_wrong_focal(rng, *images, config.most_wrong_focal)
        pivot_m = _off(rng, pair.pivot_m) if rng.random() < config.wrong_pivot else pair.pivot_m
        known_m = pivot_m if rng.random() < PIVOT_SHARE else None
        yield index, Sample(low_deg, noise_m, pair, current, goal, history, known_m, mirrored)


def _hypotheses(config: VerifierData, renderer: Renderer, number: int) -> Iterator[Arrays]:
    """The hypotheses of each pair of an object: features, error and where they come from."""
    group = rotation_group(renderer.mesh)
    for index, x in samples(config, renderer, number):
        problem = build_problem(x.current, aligned_goal(x.goal, x.pivot_m)[0], x.pivot_m, x.history)
        if config.several_views and len(problem.views_now) == len(problem.goal_views) == 1:
            continue  # one pair of views is left
        hypotheses = search(problem, EFFORTS[config.effort]).hypotheses
        errors = [
            np.pi if x.mirrored else symmetric_error(group, R, x.pair.R_goal_current, x.pair.R_camera_object)
            for R in hypotheses.R
        ]
        yield {
            "figures": (_of_views if config.several_views else features)(problem, hypotheses).astype(np.float32),
            "error_deg": np.degrees(errors).astype(np.float32),
            "pair": np.full(len(errors), number * config.pairs + index),
            "object": np.full(len(errors), number),
            "angle_deg": np.full(len(errors), x.low_deg, np.float32),
        } | ({"images": evidence_images(problem, hypotheses)} if config.images else {})


def _mirrored(renderer: Renderer) -> Renderer | None:
    """Of the mirrored object; None where that is the same object in another pose."""
    if mirror_residual(renderer.mesh) <= CHIRAL_ABOVE:
        return None
    return Renderer(renderer.mesh.copy().apply_transform(np.diag([-1.0, 1.0, 1.0, 1.0])))


def _with_static_part(rng: Generator, renderer: Renderer, pair: Pair) -> Pair:
    """The pair with a fragment of a table, or a gripper, that does not move; unchanged where none fits."""
    with suppress(ReorientError):
        kind = rng.choice(["table", "gripper"])
        current, goal = with_static_part(rng, scene_of(renderer, pair), kind, STATIC_SHARES, STATIC_NOISE_M).images
        return replace(pair, current=current, goal=goal)
    return pair


def _off(rng: Generator, pivot_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A pivot as far off as a flange is from the fingertips."""
    return np.asarray(pivot_m + so3.sample_axes(rng, 1)[0] * rng.uniform(0.02, 0.15))


def _noise_m(rng: Generator, most_mm: float) -> float:
    kind = rng.random()
    return 0.0 if kind < 0.25 else rng.uniform(0.2, 1.0 if kind < 0.75 else max(most_mm, 0.2)) / 1000


def _of_views(problem: Problem, hypotheses: Hypotheses) -> Float[np.ndarray, "k f"]:
    each = [features(*pair) for pair in problem.each_pair(hypotheses)]
    return views_features(problem, hypotheses, each, np.stack([load_verifier().log_odds(x) for x in each]))


def _with_wrong_focal(
    rng: Generator, current: DepthImage, goal: Goal, history: History, most: float
) -> tuple[DepthImage, Goal, History]:
    """All images with the same error in their stated focal length."""
    factor = 1 + rng.uniform(-most, most)
    camera = current.camera
    wrong = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
    views = tuple(replace(x, image=replace(x.image, camera=wrong)) for x in goal.views)
    return (
        replace(current, camera=wrong),
        Goal(replace(goal.image, camera=wrong), views),
        [(replace(image, camera=wrong), R) for image, R in history],
    )
