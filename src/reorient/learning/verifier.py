"""Data and training of the verifier: hypotheses of known error, from rendered objects before a simulated sensor.

The data is a resumable run (``reorient.runs``) with a file for a few objects. Training is offline only (extra
``train``: scikit-learn); the file that it writes needs numpy alone.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy.random import Generator

from reorient import so3
from reorient.errors import ReorientError, check_range, unknown_name
from reorient.estimators.search import EFFORTS, search
from reorient.estimators.verifier import FEATURES, features
from reorient.imaging import DepthImage
from reorient.registration import build_problem
from reorient.runs.files import replacing
from reorient.runs.pool import Pool
from reorient.runs.run import Progress, resumable
from reorient.world.objects import ObjectSource
from reorient.world.pairs import Pair, sample_pair, scene_of
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised
from reorient.world.static_parts import with_static_part
from reorient.world.symmetry import rotation_group, symmetric_error

RIGHT_DEG = 5.0
RANGES_DEG = ((0, 30), (30, 60), (60, 90), (90, 180))
PIVOT_SHARE = 0.6  # of the pairs come with a pivot
STATIC_SHARES, STATIC_NOISE_M = (0.1, 0.75), 0.001  # of the returns; of their depth
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
    effort: str = "normal"
    """Effort of the search that makes the hypotheses: fast, normal or thorough."""
    seed: int = 0
    """Seed of the pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range, an unknown world and an unknown effort."""
        load_world(self.world)
        if self.effort not in EFFORTS:
            raise unknown_name("effort", self.effort, list(EFFORTS))
        check_range(self, "pairs", "per_shard", low=1)
        check_range(self, "seed", "most_noise_mm")
        check_range(self, "in_hand", "static", "wrong_pivot", high=1)
        check_range(self, "most_wrong_focal", high=1, below=True)


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
            np.savez_compressed(temporary, features=np.array(FEATURES), **result)  # type: ignore[arg-type]

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
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}


def _hypotheses(config: VerifierData, renderer: Renderer, number: int) -> Iterator[Arrays]:
    """The hypotheses of each pair of an object: features, error and where they come from."""
    group, world = rotation_group(renderer.mesh), load_world(config.world)
    for index in range(config.pairs):
        rng = np.random.default_rng([config.seed, number, index])
        low, high = np.radians(RANGES_DEG[index % len(RANGES_DEG)])
        try:
            held = world.sometimes_in_hand(rng, config.in_hand)
            pair = sample_pair(rng, renderer, held, randomised(_noise_m(rng, config.most_noise_mm)), low, high)
        except ReorientError:  # a sheet that shows too little from everywhere
            continue
        if rng.random() < config.static:
            pair = _with_static_part(rng, renderer, pair)
        images = _with_wrong_focal(rng, pair, config.most_wrong_focal)
        pivot_m = _off(rng, pair.pivot_m) if rng.random() < config.wrong_pivot else pair.pivot_m
        problem = build_problem(*images, pivot_m if rng.random() < PIVOT_SHARE else None)
        hypotheses = search(problem, EFFORTS[config.effort]).hypotheses
        errors = [symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object) for R in hypotheses.R]
        yield {
            "figures": features(problem, hypotheses).astype(np.float32),
            "error_deg": np.degrees(errors).astype(np.float32),
            "pair": np.full(len(errors), number * config.pairs + index),
            "object": np.full(len(errors), number),
            "angle_deg": np.full(len(errors), np.degrees(low), np.float32),
        }


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


def _with_wrong_focal(rng: Generator, pair: Pair, most: float) -> tuple[DepthImage, DepthImage]:
    """The two images with the same error in their stated focal length."""
    factor = 1 + rng.uniform(-most, most)
    camera = pair.current.camera
    wrong = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
    return replace(pair.current, camera=wrong), replace(pair.goal, camera=wrong)


@dataclass(frozen=True, eq=False)
class Shards:
    """All hypotheses of a folder."""

    features: Float[np.ndarray, "n f"]
    error_deg: Float[np.ndarray, " n"]
    pair: np.ndarray
    object: np.ndarray

    @property
    def right(self) -> Bool[np.ndarray, " n"]:
        """Whether a hypothesis is within 5 degrees of the truth."""
        return self.error_deg < RIGHT_DEG

    def only(self, rows: np.ndarray) -> "Shards":
        """These rows, as a mask or as numbers."""
        return Shards(self.features[rows], self.error_deg[rows], self.pair[rows], self.object[rows])

    def best(self, score: Float[np.ndarray, " n"]) -> np.ndarray:
        """Of each pair the row with the highest score."""
        order = np.lexsort((-score, self.pair))
        return order[np.unique(self.pair[order], return_index=True)[1]]


def read(folder: Path) -> Shards:
    """The data that ``make`` wrote. Raises ReorientError for none, a broken file, and features of another version."""
    parts = []
    for file in sorted(folder.glob("shard-*.npz")):
        try:
            with np.load(file, allow_pickle=False) as arrays:
                if tuple(arrays["features"].tolist()) != FEATURES:
                    raise ReorientError(f"{str(file)!r} holds features of another version: expected it made anew")
                if "figures" in arrays:
                    parts.append([arrays[name] for name in ("figures", "error_deg", "pair", "object")])
        except ReorientError:
            raise
        except Exception as error:  # numpy raises whatever it likes on broken files
            raise ReorientError(
                f"cannot read {str(file)!r} ({type(error).__name__}: {error}): expected a file of `verifier make`"
            ) from error
    if not parts:
        raise ReorientError(f"no shards in {str(folder)!r}: expected the folder of `reorient verifier make`")
    return Shards(*(np.concatenate(column) for column in zip(*parts, strict=True)))


# --- training -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Training:
    """Settings of the boosted trees."""

    trees: int = 600
    held_out: float = 0.2
    """Share of the objects that calibrate and test the trees."""


def train(
    data: Shards, out: Path, others: Mapping[str, Shards] | None = None, training: Training | None = None
) -> dict[str, float]:
    """Train boosted trees on part of the objects, calibrate them on the rest; writes ``out`` (.npz).

    ``data`` is of effort "normal". ``others``: data of other efforts, of other objects, to calibrate these; an effort
    without data is calibrated as "normal". The confidence is that of the *chosen* hypothesis, so the calibration is,
    too. Returns figures of the held-out objects by name.
    """
    from reorient.learning.trees import fit_platt, fit_trees, tree_arrays

    training = training or Training()
    apart = held_out(data, training)
    model = fit_trees(data.features[~apart], data.right[~apart], training.trees)
    result: dict[str, float] = {
        "objects": len(np.unique(data.object)),
        "pairs": len(np.unique(data.pair)),
        "hypotheses": len(data.pair),
    }
    calibration = {}
    for effort, shards in {"normal": data.only(apart), **(others or {})}.items():
        log_odds = model.decision_function(shards.features)
        chosen = shards.best(log_odds)
        calibration[effort] = fit_platt(log_odds[chosen], shards.right[chosen])
        by_score = shards.best(shards.features[:, FEATURES.index("score")])
        result |= {
            f"{effort}: held-out pairs": len(chosen),
            f"{effort}: right": float(shards.right[chosen].mean()),
            f"{effort}: right by score": float(shards.right[by_score].mean()),
            f"{effort}: right at best": float(shards.right[shards.best(-shards.error_deg)].mean()),
            f"{effort}: log loss": _log_loss(calibration[effort], log_odds[chosen], shards.right[chosen]),
        }
    with replacing(out) as temporary:
        np.savez_compressed(
            temporary,
            features=np.array(FEATURES),
            efforts=np.array(list(EFFORTS)),
            calibration=np.array([calibration.get(effort, calibration["normal"]) for effort in EFFORTS]),
            **tree_arrays(model),
        )
    return result


def held_out(data: Shards, training: Training) -> Bool[np.ndarray, " n"]:
    """The rows of the objects that are not trained on; the same for the same data."""
    objects = np.unique(data.object)
    count = max(int(training.held_out * len(objects)), 1)
    return np.isin(data.object, np.random.default_rng(0).permutation(objects)[:count])


def _log_loss(
    calibration: tuple[float, float], log_odds: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]
) -> float:
    scale, shift = calibration
    return float(np.mean(np.logaddexp(0, np.where(right, -1, 1) * (scale * log_odds + shift))))
