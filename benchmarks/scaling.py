"""Measure how the verbs scale: with 1 and 2 workers of one machine, and on a Ray cluster of 1 and 2 nodes.

    python benchmarks/scaling.py --size 1      # about a quarter of an hour on two idle cores
    python benchmarks/scaling.py --only evaluate --size 0.2

Each command runs as a process of its own, the start of Python and, for Ray, the connection to the cluster included.
Prints a table in Markdown. A speed-up counts only on a machine with nothing else to do.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

OBJECTS = ("--count", "20", "--object-seed", "7")
SETUPS = (("processes", 1), ("processes", 2), ("ray", 1), ("ray", 2))


def commands(size: float) -> dict[str, list[str]]:
    """Command lines whose work grows with the size."""
    return {
        "evaluate": [
            *("evaluate", "OUT", "--estimators", "default", "gicp", "--pairs", f"{round(100 * size)}"),
            *("--ranges-deg", "0", "180", "--noise-mm", "1", *OBJECTS),
        ],
        "loops": ["loops", "OUT", "--objects", "10", "--trials", f"{max(1, round(4 * size))}", *OBJECTS],
        "verifier make": [
            *("verifier", "make", "OUT", "--pairs", "4", "--per-shard", "1"),
            *("--count", f"{max(2, round(30 * size))}", "--object-seed", "7"),
        ],
        "generate": ["generate", "OUT", "--pairs-per-object", "1000", "--count", f"{max(4, round(20 * size))}"],
    }


@contextmanager
def cluster(nodes: int) -> Iterator[dict[str, str]]:
    """A Ray cluster of this many raylets of one core each; the environment in which its address is known."""
    ray_cluster = import_module("ray.cluster_utils")
    made = ray_cluster.Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        for _ in range(nodes - 1):
            made.add_node(num_cpus=1)
        made.wait_for_nodes()
        yield {"RAY_ADDRESS": made.address}
    finally:
        made.shutdown()


def seconds(words: list[str], environment: dict[str, str]) -> float:
    begin = time.perf_counter()
    subprocess.run(words, env=os.environ | environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    return time.perf_counter() - begin


def measured(words: list[str], backend: str, workers: int, out: Path) -> float:
    words = [sys.executable, "-m", "reorient", *(str(out) if word == "OUT" else word for word in words)]
    words += ["--workers", str(workers), "--backend", backend]
    if backend == "processes":
        return seconds(words, {})
    with cluster(workers) as environment:
        return seconds(words, environment)


def trained(pairs: Path, processes: int, out: Path, size: float) -> float:
    """A training of the recipe debug, with one thread and the same number of pairs a step in all."""
    more = ["--epochs", str(max(1, round(2 * size))), "--batch", str(32 // processes), "--threads", "1"]
    words = ["-m", "reorient", "train", str(pairs), str(out), "debug", *more]
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    return seconds([sys.executable, *(torchrun if processes > 1 else []), *words], {})


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure how the verbs scale.")
    parser.add_argument("--size", type=float, default=1.0, help="of the work")
    parser.add_argument("--only", nargs="+", default=[*commands(1), "train"])
    given = parser.parse_args()
    print("| command | 1 process, s | 2 processes, s | speed-up | Ray, 1 node, s | Ray, 2 nodes, s | speed-up |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for verb, words in commands(given.size).items():
            if verb not in given.only:
                continue
            a, b, c, d = (
                measured(words, backend, workers, folder / f"{verb}-{backend}-{workers}") for backend, workers in SETUPS
            )
            print(f"| `{verb}` | {a:.0f} | {b:.0f} | {a / b:.2f} | {c:.0f} | {d:.0f} | {c / d:.2f} |", flush=True)
        if "train" in given.only:
            pairs = folder / "pairs"
            seconds([sys.executable, "-m", "reorient", "generate", str(pairs), "--count", "20"], {})
            a, b = (trained(pairs, processes, folder / f"train-{processes}", given.size) for processes in (1, 2))
            print(f"| `train` (torchrun) | {a:.0f} | {b:.0f} | {a / b:.2f} | – | – | – |")


if __name__ == "__main__":
    main()
