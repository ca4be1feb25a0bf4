"""Pair sets on disk: generated in parallel, stored in chunks (paper, "Dataset Generation").

A set is one Zarr v3 group, local or at any fsspec URL. Every chunk holds pairs of one object, so a split by object is a
split by chunk. A shard of several chunks is written at once, its labels last, so a shard with labels is complete. Each
pair has its own seed: the bytes do not depend on the number of workers, nor on interruptions.
"""

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from zarr.codecs import BloscCodec

from reorient import so3
from reorient.errors import ReorientError
from reorient.runs.files import locked, make_folder
from reorient.runs.pool import Pool
from reorient.world.meshes import MOST_VERTICES, some_vertices
from reorient.world.objects import ObjectSet, ObjectSource
from reorient.world.pairs import PairSet, sample_pair
from reorient.world.rendering import Renderer, World, load_world
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


def generate(config: PairSet, path: str | Path, pool: Pool | None = None) -> Iterator[Progress]:
    """Draw the set into ``path`` (a folder or an fsspec URL), yielding after every shard; a rerun adds missing ones.

    Raises ReorientError where ``path`` holds another set or something else, and where another process is writing into
    a folder; two processes at one URL write the same bytes.
    """
    with nullcontext() if "://" in str(path) else _locked(Path(path)):
        yield from _generate(config, path, pool)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """A lock beside the folder, which is emptied where a set was only begun."""
    with locked(make_folder(folder.parent) / f".{folder.name}.lock"):
        yield


def _generate(config: PairSet, path: str | Path, pool: Pool | None) -> Iterator[Progress]:
    group = _create(config, str(path))
    shard = config.chunk * CHUNKS_A_SHARD
    total = cast(Any, group[WHOLE]).shape[0]
    missing = [start for start in range(0, total, shard) if not has_shard(group, start // shard)]
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
    """The group with its arrays and vertices; an existing one if it has the same config."""
    described = json.loads(json.dumps(asdict(config), default=str))
    existing = _existing(described, path)
    if existing is not None:
        return existing
    objects = config.objects.open()
    group = zarr.create_group(path, attributes={"config": described}, overwrite=True)
    _create_arrays(group, config, len(objects.names))
    _write_vertices(group, config, objects)
    group.attrs["names"] = list(objects.names)
    group.attrs["created"] = True
    return group


def _existing(described: dict[str, Any], path: str) -> zarr.Group | None:
    """The group at this path if it is complete; None at an empty place or for a group without all of its arrays."""
    try:
        group = zarr.open_group(path, mode="r+")
    except (FileNotFoundError, KeyError, ValueError):
        group = None
    if group is None or "config" not in group.attrs:
        if "://" not in path and Path(path).exists() and any(Path(path).iterdir()):
            raise ReorientError(f"{path!r} holds something else: expected an empty or a new place")
        return None
    if group.attrs["config"] != described:
        raise ReorientError(
            f"{path!r} holds other pairs: expected an empty place, or the config {group.attrs['config']}"
        )
    return group if group.attrs.get("created") else None


def _create_arrays(group: zarr.Group, config: PairSet, objects: int) -> None:
    """Empty arrays of the images and the labels of all pairs."""
    n, camera = objects * config.pairs_per_object, load_world(config.world).camera
    image = (camera.height, camera.width)
    for name in ("current", "goal"):
        group.create_array(
            name, shape=(n, *image), dtype="uint16", chunks=(config.chunk, *image),
            shards=(config.chunk * CHUNKS_A_SHARD, *image), compressors=_codec(),
        )  # fmt: skip
    for name, (width, dtype) in (LABELS | {WHOLE: (4, "float64")}).items():
        group.create_array(name, shape=(n, width), dtype=dtype, chunks=(config.chunk * CHUNKS_A_SHARD, width))


def _write_vertices(group: zarr.Group, config: PairSet, objects: ObjectSet) -> None:
    """Some vertices of each object, for ShapeMatch."""
    vertices = np.zeros((len(objects.names), MOST_VERTICES, 3), np.float32)
    counts = np.zeros(len(objects.names), np.int32)
    for index, name in enumerate(objects.names):
        chosen = some_vertices(objects.load(name), np.random.default_rng([config.seed, index]))
        counts[index] = len(chosen)
        vertices[index, : len(chosen)] = chosen
    group.create_array("vertices", data=vertices)
    group.create_array("vertex_count", data=counts)


def has_shard(group: zarr.Group, shard: int) -> bool:
    """Whether the shard of this index is complete."""
    array = cast(Any, group[WHOLE])
    return bool(zarr.core.sync.sync((array.store_path / f"c/{shard}/0").exists()))


@lru_cache(maxsize=2)
def _names(source: ObjectSource) -> tuple[Any, tuple[str, ...]]:
    objects = source.open()
    return objects, objects.names


@lru_cache(maxsize=4)
def _renderer(source: ObjectSource, name: str) -> Renderer:
    return Renderer(_names(source)[0].load(name))


def _draw(config: PairSet, name: str, index: int, pair: int) -> dict[str, Any]:
    """One pair in the form that is stored; ``images``: (2, h, w), in steps of the world's quantum, unknown pixels 0."""
    world = load_world(config.world)
    rng = np.random.default_rng([config.seed, index, pair])
    drawn = sample_pair(
        rng, _renderer(config.objects, name), _without_strays(world.sometimes_in_hand(rng, config.in_hand)),
        randomised(config.noise_mm / 1000),
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


def _without_strays(world: World) -> World:
    """No stray returns: estimators remove them before a network sees an image."""
    return world if world.in_hand is None else replace(world, in_hand=replace(world.in_hand, stray=0.0))


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
    for name in (*LABELS, WHOLE):  # the labels last: they mark the shard as complete
        cast(Any, group[name])[start:stop] = np.array([pair[name] for pair in drawn])
    return stop - start
