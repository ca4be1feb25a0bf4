"""What generation, loading and training can do a second, side by side in one run.

    python benchmarks/training.py

Generation: all cores, a torus of 400 faces. Store: its size against raw uint16. Training: a step as ``reorient train``
makes it, against the same network in plain eager float32 PyTorch. Loading: from the store, and to prepared batches.
"""

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
import trimesh

from reorient.learning.batches import Augmentation, Batches
from reorient.learning.losses import mean_loss
from reorient.learning.network import build
from reorient.learning.pair_reader import PairReader
from reorient.learning.pair_store import generate
from reorient.learning.recipes import PRESETS, Training
from reorient.runs.pool import Pool
from reorient.world.objects import ObjectSource
from reorient.world.pairs import PairSet

OBJECTS, PAIRS = 8, 500
ROUNDS = 30


def steps_per_second(step: Callable[[], None]) -> float:
    for _ in range(3):
        step()
    begin = time.perf_counter()
    for _ in range(ROUNDS):
        step()
    return ROUNDS / (time.perf_counter() - begin)


def trained(recipe: Training, fast: bool, images: torch.Tensor, true: torch.Tensor) -> float:
    """Pairs a second; ``fast``: bfloat16 autocast, channels last, fused Adam."""
    network = build(recipe.network, recipe.dropout)
    if fast:
        network = cast(Any, network).to(memory_format=torch.channels_last)
        images = images.to(memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(network.parameters(), recipe.lr, fused=fast or None)

    def step() -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=fast):
            predicted = network(images)
        optimizer.zero_grad()
        cast(Any, mean_loss(predicted, true)).backward()
        optimizer.step()

    return steps_per_second(step) * recipe.batch


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        meshes, store = Path(folder) / "meshes", Path(folder) / "pairs"
        meshes.mkdir()
        for i in range(OBJECTS):
            trimesh.creation.torus(0.7, 0.2 + 0.02 * i, major_sections=20, minor_sections=10).export(
                meshes / f"{i}.ply"
            )
        config = PairSet(ObjectSource(meshes=meshes), pairs_per_object=PAIRS)
        cores = os.cpu_count() or 1
        list(generate(PairSet(ObjectSource(meshes=meshes), pairs_per_object=1), Path(folder) / "warm", Pool(cores)))
        begin = time.perf_counter()
        list(generate(config, store, Pool(cores)))
        made = OBJECTS * PAIRS / (time.perf_counter() - begin)
        raw = OBJECTS * PAIRS * 2 * 128 * 128 * 2
        size = sum(file.stat().st_size for file in store.rglob("*") if file.is_file())
        print(f"generation: {made:.0f} pairs/s on {cores} cores; store: {raw / size:.1f} times smaller than raw uint16")
        for name in ("paper", "swift"):
            reader = PairReader(store)  # anew, with nothing in memory
            recipe = PRESETS[name]
            order = reader.order(range(OBJECTS), np.random.default_rng(0))
            begin = time.perf_counter()
            for i in range(0, len(order), recipe.batch):
                reader.read(order[i : i + recipe.batch])
            read = len(order) / (time.perf_counter() - begin)
            batches = Batches(
                reader, range(OBJECTS), recipe.batch, (1,), augmentation=Augmentation(recipe.rotated, recipe.noise)
            )
            begin = time.perf_counter()
            several = list(batches)
            prepared = len(several) * recipe.batch / (time.perf_counter() - begin)
            images, true = several[0]["images"], several[0]["quat_wxyz"]
            fast, plain = (trained(recipe, how, images, true) for how in (True, False))
            print(
                f"{name}: {fast:.0f} pairs/s trained, {plain:.0f} in plain float32, ratio {fast / plain:.1f}; "
                f"{read:.0f} read ({read / fast:.1f} times), {prepared:.0f} augmented too ({prepared / fast:.1f} times)"
            )


if __name__ == "__main__":
    main()
