"""Measure how runs survive: kill -9 at random moments, and loops with faults for as long as wanted.

    python benchmarks/reliability.py kills --times 50           # every resumable verb on tiny data
    python benchmarks/reliability.py kills --verbs evaluate train
    python benchmarks/reliability.py soak --loops 10000         # closed loops with faults; memory every 100 loops

Kills: a process that has imported everything forks, the child runs the command line and is killed at a random moment,
and the same command runs again in the same folder. Each run that ends is compared with an uninterrupted one: tables
without their times, all other results byte by byte. Results are printed as Markdown.
"""

import argparse
import csv
import gzip
import hashlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

from reorient.cli import main as reorient

OBJECTS = ("--count", "4", "--object-seed", "7")
VERBS = {
    "evaluate": ("evaluate", "OUT", "--pairs", "6", "--estimators", "gicp", "--ranges-deg", "0", "30", *OBJECTS),
    "loops": (
        *("loops", "OUT", "--objects", "2", "--trials", "2", "--systems", "gicp/direct", "--start-deg", "10"),
        *("--faults", "0.1", *OBJECTS),
    ),
    "objects make": ("objects", "make", "OUT", "--count", "12"),
    "generate": ("generate", "OUT", "--pairs-per-object", "200", "--workers", "1", *OBJECTS),
    "verifier make": (
        *("verifier", "make", "OUT", "--pairs", "1", "--per-shard", "1", "--effort", "fast"),
        *("--count", "5", "--object-seed", "7"),
    ),
    "train": ("train", "PAIRS", "OUT", "debug", "--threads", "1"),
}
PAIRS = ("--pairs-per-object", "6", "--count", "8", "--object-seed", "7", "--workers", "1")
MOST_GROWTH_BYTES = 100e6
UNTIMED = ("seconds",)  # columns that differ between runs of the same config
IGNORED = ("config.json", "table.md", "zarr.json")  # with the command, the times of estimates, the time of creation


def begun(path: Path) -> bool:
    """Whether a file is what a killed process was writing: hidden, or zarr's temporary file."""
    return (path.name.startswith(".") and path.name != ".lock") or path.suffix == ".partial"


def contents(folder: Path) -> dict[str, Any]:
    """The results in a folder, without what differs between two uninterrupted runs."""
    found: dict[str, Any] = {}
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = str(file.relative_to(folder))
        if file.name.endswith(".csv.gz") or file.suffix == ".csv":
            with gzip.open(file, "rt", newline="") if file.suffix == ".gz" else file.open(newline="") as text:
                found[name] = [{k: v for k, v in row.items() if k not in UNTIMED} for row in csv.DictReader(text)]
        elif not (begun(file) or file.name in (*IGNORED, ".lock", "last.ckpt") or "log" in name):
            found[name] = hashlib.sha256(file.read_bytes()).hexdigest()
    return found


def forked(words: list[str], kill_after_s: float | None = None, output: str = os.devnull) -> int | None:
    """The exit code of a command line in a child process, whose output goes to a file; None where it was killed before
    its end."""
    child = os.fork()
    if not child:
        os.setsid()
        file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        try:
            reorient(words)
        except SystemExit as error:
            os._exit(int(error.code or 0))
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(3)
        os._exit(0)
    deadline = time.monotonic() + (kill_after_s if kill_after_s is not None else float("inf"))
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(0.002)


def killed(verb: str, times: int, folder: Path, pairs: Path, rng: random.Random) -> dict[str, Any]:
    """Kill a verb so many times; the figures of its row."""

    def words(out: Path) -> list[str]:
        return [{"OUT": str(out), "PAIRS": str(pairs)}.get(word, word) for word in VERBS[verb]]

    begin = time.monotonic()
    assert forked(words(folder / "whole")) == 0, f"{verb} fails without a kill"
    whole_s, whole = time.monotonic() - begin, contents(folder / "whole")
    kills = ended = different = failed = leftovers = 0
    out = folder / "0"
    while kills < times or out.exists():
        output = folder / "output.txt"
        code = forked(words(out), rng.uniform(0, 1.3 * whole_s) if kills < times else None, str(output))
        if code is None:
            kills += 1
            continue
        if code:
            failed += 1
            print(f"{verb} failed with {code}: {output.read_text()[-2000:]}", file=sys.stderr)
        ended += 1
        different += contents(out) != whole
        leftovers += sum(begun(path) for path in out.rglob("*"))
        shutil.rmtree(out)
        out = folder / str(ended)
    return {
        "verb": verb, "kills": kills, "runs that ended": ended, "failed": failed, "with other results": different,
        "hidden files left": leftovers, "s of a run": f"{whole_s:.1f}",
    }  # fmt: skip


def kills(times: int, verbs: list[str], seed: int) -> int:
    rng = random.Random(seed)
    wrong = 0
    with tempfile.TemporaryDirectory() as temporary:
        pairs = Path(temporary) / "pairs"
        if "train" in verbs:
            forked(["generate", str(pairs), *PAIRS])
        for index, verb in enumerate(verbs):
            row = killed(verb, times, Path(temporary) / verb.replace(" ", "-"), pairs, rng)
            if not index:
                print(f"| {' | '.join(row)} |\n|{' --- |' * len(row)}")
            print(f"| {' | '.join(map(str, row.values()))} |", flush=True)
            wrong += row["failed"] + row["with other results"]
    return wrong


def rss_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def soak(loops: int, minutes: float, seed: int) -> int:
    """Closed loops with faults in this process. Memory is sampled; the first hundred loops fill the caches."""
    from reorient.experiments.loops import Loops, run_trial, trials
    from reorient.world.objects import ObjectSource

    objects, systems = 20, ("fast/fusing", "gicp/direct")
    config = Loops(
        ObjectSource(count=objects, object_seed=7), systems, objects, max(1, loops // (objects * len(systems))),
        start_deg=("any",), faults=0.1, slack_deg=1.0, seed=seed,
    )  # fmt: skip
    deadline, statuses, done, met = time.monotonic() + 60 * minutes, Counter[str](), 0, 0
    samples: list[int] = []
    print("| loops | resident MB | faults met |\n| ---: | ---: | ---: |")
    for trial in trials(config).values():
        rows = run_trial(trial)["rows"]
        done += len(rows)
        statuses.update(row["status"] for row in rows)
        met += sum(len(row["faults_met"].split()) for row in rows)
        if done % 100 == 0:
            samples.append(rss_bytes())
            print(f"| {done} | {samples[-1] / 1e6:.0f} | {met} |", flush=True)
        if time.monotonic() > deadline:
            break
    growth = samples[-1] - samples[0] if samples else 0
    print(f"\n{done} loops, {met} faults; {dict(statuses.most_common())}")
    print(f"growth after the first hundred loops: {growth / 1e6:.0f} MB")
    return int(growth > MOST_GROWTH_BYTES)


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure how runs survive.")
    parser.add_argument("what", choices=("kills", "soak"))
    parser.add_argument("--times", type=int, default=50, help="kills of each verb")
    parser.add_argument("--verbs", nargs="+", default=list(VERBS), choices=list(VERBS))
    parser.add_argument("--loops", type=int, default=10_000)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="longest time of the loops")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    wrong = (
        kills(given.times, given.verbs, given.seed)
        if given.what == "kills"
        else soak(given.loops, given.minutes, given.seed)
    )
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
