"""Reading pair sets: every pair by its index, and orders that read each chunk once per epoch."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from jaxtyping import Float, Int, UInt16
from numpy.random import Generator

from reorient.errors import ReorientError, reason_of
from reorient.imaging import Camera
from reorient.learning.pair_store import CHUNKS_A_SHARD, has_shard
from reorient.world.meshes import MOST_VERTICES
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
        self._path = str(path)
        with self._reading():
            self._group = zarr.open_group(self._path, mode="r")
            described = dict(cast(Any, self._group.attrs["config"]))
            self.config = PairSet(ObjectSource.from_json(described.pop("objects")), **described)
            self.names = tuple(map(str, cast(Any, self._group.attrs["names"])))
            world = load_world(self.config.world)
            self.camera: Camera = world.camera
            self.quantum_m = world.quantum_m
            total, shard = len(self.names) * self.config.pairs_per_object, self.config.chunk * CHUNKS_A_SHARD
            missing = sum(not has_shard(self._group, i) for i in range(-(-total // shard)))
        if missing:
            raise ReorientError(
                f"{missing} shards of {self._path!r} are missing: expected `reorient generate` to have ended"
            )
        with self._reading():
            self._labels = {
                name: self._array(name, (total, width))[:]
                for name, width in (("quat_wxyz", 4), ("quat_start_wxyz", 4), ("pivot_m", 3))
            }
            self._opened: dict[int, tuple[Any, Any]] = {}
            self._images()
            self.vertices: Float[np.ndarray, "objects 500 3"] = self._array(
                "vertices", (len(self.names), MOST_VERTICES, 3)
            )[:]
            """Vertices of each object over its bounding radius; rows from ``vertex_count`` on are zero."""
            self.vertex_count: Int[np.ndarray, " objects"] = self._array("vertex_count", (len(self.names),))[:]
        self._chunks: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """A block that reads the set: ReorientError for whatever Zarr and its codecs raise on a broken one."""
        try:
            yield
        except Exception as error:
            raise ReorientError(
                f"no pairs in {self._path!r} ({reason_of(error)}): expected what `reorient generate` wrote"
            ) from error

    def _array(self, name: str, shape: tuple[int, ...]) -> Any:
        """An array of the set. Raises ValueError for one of another shape or of no numbers."""
        array = cast(Any, self._group[name])
        if array.shape != shape or array.dtype.kind not in "fiu":
            raise ValueError(f"{name} of shape {array.shape}, {array.dtype}")
        return array

    def _images(self) -> tuple[Any, Any]:
        """The arrays of current and goal, opened by this process: the connections of a URL do not outlive a fork."""
        process = os.getpid()
        if process not in self._opened:
            self._group = zarr.open_group(self._path, mode="r")
            shape = (len(self.names) * self.config.pairs_per_object, self.camera.height, self.camera.width)
            self._opened = {process: (self._array("current", shape), self._array("goal", shape))}
        return self._opened[process]

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
            with self._reading():
                current, goal = self._images()
                self._chunks[k] = current[rows], goal[rows]
        return self._chunks[k]
