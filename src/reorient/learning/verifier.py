"""What the judge learns from: hypotheses of known error, from objects before a simulated sensor; and its training.

The data is made in shards of a few objects each, a file a shard, so that an interrupted run goes on where it stopped.
Training is offline only (extra ``train``: scikit-learn); what it writes needs numpy alone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.random import Generator

from reorient.errors import ReorientError, unknown_name
from reorient.estimators.search import EFFORTS, search
from reorient.estimators.verifier import FEATURES, features
from reorient.imaging import DepthImage
from reorient.registration import build_problem
from reorient.runs.files import make_folder, replacing
from reorient.runs.pool import check_workers, processes
from reorient.runs.provenance import keep_record
from reorient.world.objects import ObjectSource
from reorient.world.pairs import Pair, sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised
from reorient.world.symmetry import rotation_group, symmetric_error

RIGHT_DEG = 5.0
RANGES_DEG = ((0, 30), (30, 60), (60, 90), (90, 180))


@dataclass(frozen=True)
class JudgeData:
    """What to make."""

    objects: ObjectSource = field(default_factory=lambda: ObjectSource(count=5000))
    """Whose pairs are drawn."""
    pairs: int = 8
    """Of each object."""
    per_shard: int = 5
    """Objects of a file."""
    world: str = "benchmark"
    """Preset of camera, size and distance: benchmark or paper."""
    most_noise_mm: float = 3.0
    """The noise is none for a quarter of the pairs, up to 1 mm for half, up to this for the rest."""
    most_wrong_focal: float = 0.02
    """Share by which the stated focal length may be wrong."""
    effort: str = "normal"
    """Of the search that makes the hypotheses: fast, normal or thorough."""
    seed: int = 0
    """Of the pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for what cannot be made."""
        load_world(self.world)
        if self.effort not in EFFORTS:
            raise unknown_name("effort", self.effort, list(EFFORTS))
        if min(self.pairs, self.per_shard) < 1 or self.seed < 0:
            raise ReorientError("expected at least one pair an object and object a file, and a seed from 0")
        if not (0 <= self.most_noise_mm < np.inf and 0 <= self.most_wrong_focal < 1):
            raise ReorientError(
                f"noise up to {self.most_noise_mm} mm, focal length wrong by {self.most_wrong_focal}: expected finite "
                "noise from 0 and a share below 1"
            )


def make(config: JudgeData, out: Path, workers: int = 1) -> Iterator[tuple[int, int]]:
    """Write the shards, yielding (done, all). Those that are there already stay. Raises ReorientError where they are of
    another config, and for no workers."""
    check_workers(workers)
    names = config.objects.open().names
    keep_record(make_folder(out) / "config.json", config, f"what is in {str(out)!r}")
    tasks = [
        (config, names[begin : begin + config.per_shard], out / f"shard-{begin:06d}.npz")
        for begin in range(0, len(names), config.per_shard)
    ]
    missing = [task for task in tasks if not task[2].is_file()]
    done = len(tasks) - len(missing)
    yield done, len(tasks)
    with processes(workers) as pool:
        for _ in pool.map(_make_shard, missing) if workers > 1 else map(_make_shard, missing):
            done += 1
            yield done, len(tasks)


def _make_shard(task: tuple[JudgeData, tuple[str, ...], Path]) -> None:
    config, names, file = task
    columns: dict[str, list[np.ndarray]] = {
        name: [] for name in ("figures", "error_deg", "pair", "object", "angle_deg")
    }
    objects, world = config.objects.open(), load_world(config.world)
    begin = config.objects.open().names.index(names[0])
    for number, name in enumerate(names, start=begin):
        try:
            mesh = objects.load(name)
        except ReorientError:
            continue
        group, renderer = rotation_group(mesh), Renderer(mesh)
        for index in range(config.pairs):
            rng = np.random.default_rng([config.seed, number, index])
            low, high = np.radians(RANGES_DEG[index % len(RANGES_DEG)])
            try:
                pair = sample_pair(rng, renderer, world, randomised(_noise_m(rng, config.most_noise_mm)), low, high)
            except ReorientError:  # a sheet that shows too little from everywhere
                continue
            problem = build_problem(
                *_misread(rng, pair, config.most_wrong_focal), pair.pivot_m if rng.random() < 0.6 else None
            )
            hypotheses = search(problem, EFFORTS[config.effort])
            errors = [symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object) for R in hypotheses.R]
            columns["figures"].append(features(problem, hypotheses).astype(np.float32))
            columns["error_deg"].append(np.degrees(errors).astype(np.float32))
            columns["pair"].append(np.full(len(errors), number * config.pairs + index))
            columns["object"].append(np.full(len(errors), number))
            columns["angle_deg"].append(np.full(len(errors), np.degrees(low), np.float32))
    with replacing(file) as temporary:
        arrays: dict[str, Any] = {name: np.concatenate(parts) for name, parts in columns.items() if parts}
        np.savez_compressed(temporary, features=np.array(FEATURES), **arrays)


def _noise_m(rng: Generator, most_mm: float) -> float:
    kind = rng.random()
    return 0.0 if kind < 0.25 else rng.uniform(0.2, 1.0 if kind < 0.75 else max(most_mm, 0.2)) / 1000


def _misread(rng: Generator, pair: Pair, most: float) -> tuple[DepthImage, DepthImage]:
    """The two images with the same error in their stated focal length."""
    factor = 1 + rng.uniform(-most, most)
    camera = pair.current.camera
    wrong = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
    return DepthImage(pair.current.depth_m, wrong), DepthImage(pair.goal.depth_m, wrong)


@dataclass(frozen=True, eq=False)
class Shards:
    """All hypotheses of a folder."""

    figures: Float[np.ndarray, "n f"]
    error_deg: Float[np.ndarray, " n"]
    pair: np.ndarray
    object: np.ndarray

    @property
    def right(self) -> Bool[np.ndarray, " n"]:
        """Whether a hypothesis is within 5 degrees."""
        return self.error_deg < RIGHT_DEG

    def of(self, chosen: np.ndarray) -> "Shards":
        """Those rows alone."""
        return Shards(self.figures[chosen], self.error_deg[chosen], self.pair[chosen], self.object[chosen])


def read(folder: Path) -> Shards:
    """What ``make`` wrote. Raises ReorientError for nothing, a broken file, and figures of another version."""
    parts = []
    for file in sorted(folder.glob("shard-*.npz")):
        try:
            with np.load(file, allow_pickle=False) as arrays:
                if tuple(arrays["features"].tolist()) != FEATURES:
                    raise ReorientError(f"{str(file)!r} holds other figures: expected those of this version, made anew")
                if "figures" in arrays:
                    parts.append([arrays[name] for name in ("figures", "error_deg", "pair", "object")])
        except ReorientError:
            raise
        except Exception as error:  # numpy raises whatever it likes on broken files
            raise ReorientError(
                f"cannot read {str(file)!r} ({type(error).__name__}: {error}): expected what `judge make` wrote"
            ) from error
    if not parts:
        raise ReorientError(f"no shards in {str(folder)!r}: expected what `reorient judge make` wrote")
    return Shards(*(np.concatenate(column) for column in zip(*parts, strict=True)))


# --- training -------------------------------------------------------------------------------------------------------


def train(
    data: Shards, out: Path, others: Mapping[str, Shards] | None = None, held_out: float = 0.2, trees: int = 600
) -> dict[str, float]:
    """Boosted trees on part of the objects, calibrated on the rest; writes ``out`` (.npz), returns figures of the rest.

    ``data`` is of effort "normal". ``others``: what other efforts made, of other objects, to calibrate them on; an
    effort that is missing is calibrated as "normal". The confidence is about the *chosen* hypothesis, so that is what
    it is calibrated on.
    """
    rng = np.random.default_rng(0)
    objects = np.unique(data.object)
    apart = np.isin(data.object, rng.permutation(objects)[: max(int(held_out * len(objects)), 1)])
    model = _fit(data.of(~apart), trees)
    kept = {"normal": data.of(apart), **(others or {})}
    result: dict[str, float] = {
        "objects": len(objects),
        "pairs": len(np.unique(data.pair)),
        "hypotheses": len(data.pair),
    }
    fitted = {}
    for effort, shards in kept.items():
        odds = model.decision_function(shards.figures)
        chosen = _chosen(shards, odds)
        fitted[effort] = _platt(odds[chosen], shards.right[chosen])
        by_agreement = _chosen(shards, shards.figures[:, FEATURES.index("score")])
        result |= {
            f"{effort}: held-out pairs": len(chosen),
            f"{effort}: right": float(shards.right[chosen].mean()),
            f"{effort}: right by agreement": float(shards.right[by_agreement].mean()),
            f"{effort}: right at best": float(shards.right[_chosen(shards, -shards.error_deg)].mean()),
            f"{effort}: log loss": _log_loss(fitted[effort], odds[chosen], shards.right[chosen]),
        }
    calibration = np.array([fitted.get(effort, fitted["normal"]) for effort in EFFORTS])
    with replacing(out) as temporary:
        np.savez_compressed(
            temporary,
            features=np.array(FEATURES),
            efforts=np.array(list(EFFORTS)),
            calibration=calibration,
            **_arrays(model),
        )
    return result


def _fit(data: Shards, trees: int) -> Any:
    from sklearn.ensemble import HistGradientBoostingClassifier

    model = HistGradientBoostingClassifier(
        max_iter=trees,
        learning_rate=0.03,
        max_leaf_nodes=31,
        min_samples_leaf=80,
        l2_regularization=5.0,
        max_features=0.25,
        random_state=0,
    )
    return model.fit(data.figures, data.right)


def _chosen(data: Shards, score: Float[np.ndarray, " n"]) -> np.ndarray:
    """Of each pair the row of the highest score."""
    order = np.lexsort((-score, data.pair))
    return order[np.unique(data.pair[order], return_index=True)[1]]


def _platt(log_odds: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> tuple[float, float]:
    """Scale and shift of the log odds that make them fit, by Newton steps on the likelihood, slightly regularised."""
    x = np.stack([log_odds, np.ones(len(log_odds))], axis=1)
    w = np.array([1.0, 0.0])
    for _ in range(50):
        p = 1 / (1 + np.exp(-x @ w))
        gradient = x.T @ (p - right) + 0.1 * (w - [1.0, 0.0])
        w = w - np.linalg.solve((x * (p * (1 - p))[:, None]).T @ x + 0.1 * np.eye(2), gradient)
    return float(w[0]), float(w[1])


def _log_loss(
    calibration: tuple[float, float], log_odds: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]
) -> float:
    scale, shift = calibration
    return float(np.mean(np.logaddexp(0, np.where(right, -1, 1) * (scale * log_odds + shift))))


def _arrays(model: Any) -> dict[str, Any]:
    """The trees as ``Judge`` takes them."""
    nodes = [stage[0].nodes for stage in model._predictors]
    shape = len(nodes), max(len(tree) for tree in nodes)
    place = np.broadcast_to(np.arange(shape[1]), shape)
    feature, left, right = np.zeros(shape, np.int16), place.astype(np.int16), place.astype(np.int16)
    threshold, value = np.full(shape, np.inf), np.zeros(shape)
    for i, tree in enumerate(nodes):
        n, inner = len(tree), ~tree["is_leaf"].astype(bool)
        value[i, :n] = np.where(inner, 0, tree["value"])
        for name, array in (("feature_idx", feature), ("num_threshold", threshold), ("left", left), ("right", right)):
            array[i, :n] = np.where(inner, tree[name], array[i, :n])
    return {
        "feature": feature,
        "threshold": threshold,
        "left": left,
        "right": right,
        "value": value,
        "depth": np.array(max(int(tree["depth"].max()) for tree in nodes)),
        "baseline": model._baseline_prediction.ravel()[0],
    }
