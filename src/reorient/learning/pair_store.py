"""Pair sets on disk: generated in parallel, stored in chunks, read in shuffled batches (paper, "Dataset Generation").

A set is one Zarr v3 group, local or at any fsspec URL. Every chunk holds one object's pairs, so a split by object is a
split by chunk; a shard of several chunks is written at once, its labels last, so that a shard with labels is whole.
Each pair has a seed of its own: the same bytes whatever the number of workers, and wherever an interruption fell.
"""

import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from jaxtyping import Float, Int, UInt16
from numpy.random import Generator
from zarr.codecs import BloscCodec

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera
from reorient.runs.pool import Pool
from reorient.world.meshes import MOST_VERTICES, some_vertices
from reorient.world.objects import ObjectSource
from reorient.world.pairs import PairSet, sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised

CHUNKS_A_SHARD = 20
PROBE = 50  # pairs made to estimate time and disk
LABELS = {
    "seed": (2, "int64"),
    "quat_start_wxyz": (4, "float64"),
    "placement": (4, "float64"),
    "pivot_m": (3, "float64"),
}
WHOLE = "quat_wxyz"  # written last


@dataclass(frozen=True)
class Progress:
    """How far a generation is."""

    done: int
    """Pairs on disk."""
    total: int


# --- writing --------------------------------------------------------------------------------------------------------


def generate(config: PairSet, path: str | Path, pool: Pool | None = None) -> Iterator[Progress]:
    """Draw the set into ``path`` (a folder or an fsspec URL), yielding after every shard; finishes what is missing.

    Raises ReorientError where ``path`` holds another set or something else.
    """
    group = _create(config, str(path))
    shard = config.chunk * CHUNKS_A_SHARD
    total = cast(Any, group[WHOLE]).shape[0]
    missing = [start for start in range(0, total, shard) if not _has_shard(group, start // shard)]
    done = total - sum(min(shard, total - start) for start in missing)
    yield Progress(done, total)
    tasks = [(config, str(path), start, min(start + shard, total)) for start in missing]
    for size in (pool or Pool()).map(_write_shard, tasks):
        done += size
        yield Progress(done, total)


@dataclass(frozen=True)
class Cost:
    """What a generation will take."""

    pairs: int
    seconds: float
    bytes: int
    free_bytes: int | None
    """On the local disk; None elsewhere."""


def estimate_cost(config: PairSet, path: str | Path, pool: Pool | None = None) -> Cost:
    """Time and disk of the whole set, from a few pairs made now. Raises ReorientError where the disk is too small."""
    names = config.objects.open().names
    total = len(names) * config.pairs_per_object
    rng = np.random.default_rng(config.seed)
    begin = time.perf_counter()
    images = [_draw(config, names[i], 0, k)["images"] for k, i in enumerate(rng.integers(len(names), size=PROBE))]
    seconds = (time.perf_counter() - begin) / PROBE * total / (pool or Pool()).count
    packed = zarr.create_array(
        zarr.storage.MemoryStore(),
        data=np.concatenate(images),
        chunks=(PROBE, *images[0].shape[1:]),
        compressors=_codec(),
    )
    size = int(packed.nbytes_stored() / PROBE * total)
    local = None if "://" in str(path) else Path(path).absolute()
    free = None
    if local is not None:
        existing = next(folder for folder in (local, *local.parents) if folder.exists())
        free = shutil.disk_usage(existing).free
        if size > free:
            raise ReorientError(
                f"{size / 1e9:.1f} GB to write to {str(path)!r}: expected that much free, {free / 1e9:.1f} GB is"
            )
    return Cost(total, seconds, size, free)


def _codec() -> BloscCodec:
    return BloscCodec(cname="zstd", clevel=1, shuffle="shuffle")


def _create(config: PairSet, path: str) -> zarr.Group:
    """The group with its arrays and vertices; kept where the same config made it."""
    described = json.loads(json.dumps(asdict(config), default=str))
    try:
        group = zarr.open_group(path, mode="r+")
    except (FileNotFoundError, KeyError, ValueError):
        group = None
    if group is not None and "config" in group.attrs:
        if group.attrs["config"] != described:
            raise ReorientError(
                f"{path!r} holds other pairs: expected an empty place, or the config {group.attrs['config']}"
            )
        if group.attrs.get("created"):
            return group
    elif "://" not in path and Path(path).exists() and any(Path(path).iterdir()):
        raise ReorientError(f"{path!r} holds something else: expected an empty or a new place")
    objects = config.objects.open()
    n, camera = len(objects.names) * config.pairs_per_object, load_world(config.world).camera
    group = zarr.create_group(path, attributes={"config": described}, overwrite=True)
    image = (camera.height, camera.width)
    for name in ("current", "goal"):
        group.create_array(
            name, shape=(n, *image), dtype="uint16", chunks=(config.chunk, *image),
            shards=(config.chunk * CHUNKS_A_SHARD, *image), compressors=_codec(),
        )  # fmt: skip
    for name, (width, dtype) in (LABELS | {WHOLE: (4, "float64")}).items():
        group.create_array(name, shape=(n, width), dtype=dtype, chunks=(config.chunk * CHUNKS_A_SHARD, width))
    vertices = np.zeros((len(objects.names), MOST_VERTICES, 3), np.float32)
    counts = np.zeros(len(objects.names), np.int32)
    for index, name in enumerate(objects.names):
        chosen = some_vertices(objects.load(name), np.random.default_rng([config.seed, index]))
        counts[index] = len(chosen)
        vertices[index, : len(chosen)] = chosen
    group.create_array("vertices", data=vertices)
    group.create_array("vertex_count", data=counts)
    group.attrs["names"] = list(objects.names)
    group.attrs["created"] = True
    return group


def _has_shard(group: zarr.Group, shard: int) -> bool:
    array = cast(zarr.Array, group[WHOLE])
    return bool(zarr.core.sync.sync((array.store_path / f"c/{shard}/0").exists()))


@lru_cache(maxsize=2)
def _names(source: ObjectSource) -> tuple[Any, tuple[str, ...]]:
    objects = source.open()
    return objects, objects.names


@lru_cache(maxsize=4)
def _renderer(source: ObjectSource, name: str) -> Renderer:
    return Renderer(_names(source)[0].load(name))


def _draw(config: PairSet, name: str, index: int, pair: int) -> dict[str, Any]:
    """One pair as it is stored; ``images``: (2, h, w) in steps of the world's quantum."""
    world = load_world(config.world)
    rng = np.random.default_rng([config.seed, index, pair])
    drawn = sample_pair(
        rng, _renderer(config.objects, name), world, randomised(config.noise_mm / 1000),
        float(np.radians(config.low_deg)), float(np.radians(config.high_deg)),
    )  # fmt: skip
    images = np.rint(np.stack([drawn.current.depth_m, drawn.goal.depth_m]) / world.quantum_m).astype(np.uint16)
    return {
        "images": images,
        "seed": (index, pair),
        "quat_start_wxyz": so3.quat_from_matrix(drawn.R_camera_object),
        "placement": (drawn.placement.scale_m, *drawn.placement.center_m),
        "pivot_m": drawn.pivot_m,
        WHOLE: so3.quat_from_matrix(drawn.R_goal_current),
    }


def _write_shard(task: tuple[PairSet, str, int, int]) -> int:
    config, path, start, stop = task
    names = _names(config.objects)[1]
    drawn = []
    for i in range(start, stop):
        index, pair = divmod(i, config.pairs_per_object)
        drawn.append(_draw(config, names[index], index, pair))
    group = zarr.open_group(path, mode="r+")
    images = np.stack([pair["images"] for pair in drawn])
    for name, values in (("current", images[:, 0]), ("goal", images[:, 1])):
        cast(Any, group[name])[start:stop] = values
    for name in (*LABELS, WHOLE):  # the labels last: they mark the shard as whole
        cast(Any, group[name])[start:stop] = np.array([pair[name] for pair in drawn])
    return stop - start


# --- reading --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Batch:
    """n pairs as the camera saw them."""

    images: UInt16[np.ndarray, "n 2 h w"]
    """Start and goal, in steps of the world's quantum."""
    quat_wxyz: Float[np.ndarray, "n 4"]
    """Of R_goal_current, camera axes."""
    quat_start_wxyz: Float[np.ndarray, "n 4"]
    pivot_m: Float[np.ndarray, "n 3"]
    object_index: Int[np.ndarray, " n"]


class PairReader:
    """A set that ``generate`` has finished."""

    def __init__(self, path: str | Path) -> None:
        """Raises ReorientError where there is no finished set."""
        try:
            self._group = zarr.open_group(str(path), mode="r")
            described = dict(cast(Any, self._group.attrs["config"]))
            self.config = PairSet(ObjectSource.from_json(described.pop("objects")), **described)
            self.names = tuple(cast(Any, self._group.attrs["names"]))
        except (FileNotFoundError, KeyError, ValueError, TypeError) as error:
            raise ReorientError(f"no pairs in {str(path)!r}: expected what `reorient generate` wrote") from error
        self.camera: Camera = load_world(self.config.world).camera
        total, shard = len(self.names) * self.config.pairs_per_object, self.config.chunk * CHUNKS_A_SHARD
        missing = sum(not _has_shard(self._group, i) for i in range(-(-total // shard)))
        if missing:
            raise ReorientError(
                f"{missing} shards of {str(path)!r} are missing: expected `reorient generate` to have ended"
            )
        self.quantum_m = load_world(self.config.world).quantum_m
        self._labels = {name: cast(Any, self._group[name])[:] for name in ("quat_wxyz", "quat_start_wxyz", "pivot_m")}
        self._current, self._goal = cast(Any, self._group["current"]), cast(Any, self._group["goal"])
        self.vertices: Float[np.ndarray, "objects 500 3"] = cast(Any, self._group["vertices"])[:]
        """Of each object, over its bounding radius; rows past ``vertex_count`` are zero."""
        self.vertex_count: Int[np.ndarray, " objects"] = cast(Any, self._group["vertex_count"])[:]
        self._chunks: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def order(self, objects: Sequence[int], rng: Generator, window: int = 64) -> Int[np.ndarray, " pairs"]:
        """All pairs of some objects once: chunks in random order, pairs shuffled within windows of this many chunks."""
        per_object, chunk = self.config.pairs_per_object, self.config.chunk
        starts = (np.asarray(objects)[:, None] * per_object + np.arange(0, per_object, chunk)).ravel()
        starts = rng.permutation(starts)
        windows = [starts[i : i + window] for i in range(0, len(starts), window)]
        return np.concatenate([rng.permutation((w[:, None] + np.arange(chunk)).ravel()) for w in windows])

    def read(self, pairs: Int[np.ndarray, " n"]) -> Batch:
        """Some pairs by number. The last few hundred chunks stay in memory, so read in ``order``."""
        chunk = self.config.chunk
        images = np.empty((len(pairs), 2, self.camera.height, self.camera.width), np.uint16)
        for row, pair in enumerate(pairs.tolist()):
            current, goal = self._chunk(pair // chunk)
            images[row, 0], images[row, 1] = current[pair % chunk], goal[pair % chunk]
        labels = {name: values[pairs] for name, values in self._labels.items()}
        return Batch(images, object_index=pairs // self.config.pairs_per_object, **labels)

    def _chunk(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        if k not in self._chunks:
            if len(self._chunks) >= 192:
                self._chunks.pop(next(iter(self._chunks)))
            rows = slice(k * self.config.chunk, (k + 1) * self.config.chunk)
            self._chunks[k] = self._current[rows], self._goal[rows]
        return self._chunks[k]
