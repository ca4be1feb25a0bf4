"""Reading pair sets: every pair by its index, and orders that read each chunk once per epoch."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from jaxtyping import Float, Int, UInt16
from numpy.random import Generator

from reorient.errors import ReorientError
from reorient.imaging import Camera
from reorient.learning.pair_store import CHUNKS_A_SHARD, has_shard
from reorient.world.objects import ObjectSource
from reorient.world.pairs import PairSet
from reorient.world.rendering import load_world

_CHUNKS_KEPT = 192  # in memory


@dataclass(frozen=True)
class Batch:
    """n pairs as they are stored."""

    images: UInt16[np.ndarray, "n 2 h w"]
    """Start and goal depth, in steps of the world's quantum."""
    quat_wxyz: Float[np.ndarray, "n 4"]
    """Of R_goal_current, camera axes."""
    quat_start_wxyz: Float[np.ndarray, "n 4"]
    """Of R_camera_object at the start."""
    pivot_m: Float[np.ndarray, "n 3"]
    """Nominal rotation centre, camera axes."""
    object_index: Int[np.ndarray, " n"]


class PairReader:
    """A complete set of pairs on disk."""

    def __init__(self, path: str | Path) -> None:
        """Raises ReorientError if there is no complete set at the path."""
        try:
            self._group = zarr.open_group(str(path), mode="r")
            described = dict(cast(Any, self._group.attrs["config"]))
            self.config = PairSet(ObjectSource.from_json(described.pop("objects")), **described)
            self.names = tuple(cast(Any, self._group.attrs["names"]))
        except (FileNotFoundError, KeyError, ValueError, TypeError) as error:
            raise ReorientError(f"no pairs in {str(path)!r}: expected what `reorient generate` wrote") from error
        self.camera: Camera = load_world(self.config.world).camera
        total, shard = len(self.names) * self.config.pairs_per_object, self.config.chunk * CHUNKS_A_SHARD
        missing = sum(not has_shard(self._group, i) for i in range(-(-total // shard)))
        if missing:
            raise ReorientError(
                f"{missing} shards of {str(path)!r} are missing: expected `reorient generate` to have ended"
            )
        self.quantum_m = load_world(self.config.world).quantum_m
        self._labels = {name: cast(Any, self._group[name])[:] for name in ("quat_wxyz", "quat_start_wxyz", "pivot_m")}
        self._current, self._goal = cast(Any, self._group["current"]), cast(Any, self._group["goal"])
        self.vertices: Float[np.ndarray, "objects 500 3"] = cast(Any, self._group["vertices"])[:]
        """Vertices of each object over its bounding radius; rows from ``vertex_count`` on are zero."""
        self.vertex_count: Int[np.ndarray, " objects"] = cast(Any, self._group["vertex_count"])[:]
        self._chunks: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def order(self, objects: Sequence[int], rng: Generator, window: int = 64) -> Int[np.ndarray, " pairs"]:
        """Indices of all pairs of some objects: chunks in random order, pairs shuffled within ``window`` chunks."""
        per_object, chunk = self.config.pairs_per_object, self.config.chunk
        starts = (np.asarray(objects)[:, None] * per_object + np.arange(0, per_object, chunk)).ravel()
        starts = rng.permutation(starts)
        windows = [starts[i : i + window] for i in range(0, len(starts), window)]
        return np.concatenate([rng.permutation((w[:, None] + np.arange(chunk)).ravel()) for w in windows])

    def read(self, pairs: Int[np.ndarray, " n"]) -> Batch:
        """Pairs by index. Fast in the order of ``order``: the most recent chunks stay in memory."""
        chunk = self.config.chunk
        images = np.empty((len(pairs), 2, self.camera.height, self.camera.width), np.uint16)
        for row, pair in enumerate(pairs.tolist()):
            current, goal = self._chunk(pair // chunk)
            images[row, 0], images[row, 1] = current[pair % chunk], goal[pair % chunk]
        labels = {name: values[pairs] for name, values in self._labels.items()}
        return Batch(images, object_index=pairs // self.config.pairs_per_object, **labels)

    def _chunk(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        if k not in self._chunks:
            if len(self._chunks) >= _CHUNKS_KEPT:
                self._chunks.pop(next(iter(self._chunks)))
            rows = slice(k * self.config.chunk, (k + 1) * self.config.chunk)
            self._chunks[k] = self._current[rows], self._goal[rows]
        return self._chunks[k]
