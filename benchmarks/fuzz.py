"""Fuzz every reader: mutated files in; a result or a ReorientError of one line out, in bounded time and memory.

    python benchmarks/fuzz.py --count 5000            # inputs a target; all targets
    python benchmarks/fuzz.py --only depth mesh       # some of them
    python benchmarks/fuzz.py --again out/fuzz/mesh-0 # one finding again, with its traceback

The seeds come from code (``fuzz_targets.py``); the same count and seed make the same inputs. Each target runs in a
process of its own, so that a crash or an endless loop in a decoder is a finding like any other. Findings are kept by
kind (target, error, line of the package) with their smallest input.
"""

import argparse
import io
import logging
import os
import pickle
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import cast

from reorient.errors import ReorientError

Files = dict[str, bytes]
"""The files of an input by their relative path."""

MOST_CPU_S = 5.0  # of one input
MOST_BYTES = 600_000_000  # growth of the process
MOST_CHARACTERS = 2000  # of an error message
STUCK_S = 120.0  # without progress: in a decoder that does not return to Python


@dataclass(frozen=True)
class Target:
    """A reader and valid inputs of it."""

    name: str
    seeds: Callable[[], list[Files]]
    run: Callable[[Path], object]
    """Reads the files in a folder."""
    needs: tuple[str, ...] = ()
    """Modules of extras without which it cannot be fuzzed."""
    share: float = 1.0
    """Of the count of inputs, for slow ones."""

    @property
    def missing(self) -> list[str]:
        return [module for module in self.needs if find_spec(module) is None]


@dataclass
class Outcome:
    """Of all inputs of a target."""

    inputs: int = 0
    results: int = 0
    refusals: int = 0
    seconds: float = 0.0
    slowest_s: float = 0.0
    growth_bytes: int = 0
    findings: dict[str, Files] = field(default_factory=dict)
    """The smallest input of each kind."""


class TooSlow(BaseException):
    """An input takes more processor time than it may."""


# --- mutations ------------------------------------------------------------------------------------------------------

_TOKEN = re.compile(rb'-?\d+\.?\d*(?:[eE][-+]?\d+)?|"[^"\n]{0,80}"|\btrue\b|\bfalse\b|\bnull\b|\[[^\[\]]{0,200}\]')
_ODD = (
    *(b"0", b"-1", b"1", b"1e308", b"-1e308", b"1e-308", b"1e-40", b"1e38", b"NaN", b"nan", b"Infinity", b"-inf"),
    *(b"9" * 5000, b"1" + b"0" * 400, b"65535", b"65536", b"4294967296", b"1e9", b"100000000", b"0.5", b"-0.0"),
    *(b"[]", b"{}", b"null", b"true", b'""', b'"a"', b'"\\ud800"', b'"\\u0000"', b'"../../x"', b"[1]", b"[[1]]"),
    *(b'{"a": 1}', b"[" * 20000, b"[" * 500 + b"]" * 500, b"\n", b"\xe2\x80\xa8", b"\xff\xfe", b"\x00", b",", b":"),
    *(b"'", b'"', b"#", b"%", b"[NaN, 1]", b'["a", {}]', b"1_000", b"0x10", b"\xd9\xa3"),
)
_BINARY = (
    *(b"\x00" * 4, b"\xff" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x80\x7f", b"\x00\x00\xc0\x7f"),
    *(b"\x01\x00\x00\x00", b"\x00\x00\x00\x01", b"\xff" * 8, b"\x00" * 8, b"\x01\x00\x00\x00\x00\x00\x00\x00"),
    *(b"\x00\x00\x00\x00\x00\x00\xf0\x7f", b"\x00\x00\x00\x00\x00\x00\xf8\x7f", b"\xff\xff", b"\x00\x80"),
)


def mutated(rng: random.Random, data: bytes, other: bytes) -> bytes:
    """Data with one to four changes; ``other``: a valid file to take pieces from."""
    for _ in range(rng.choice((1, 1, 1, 1, 2, 3))):
        data = rng.choice(_CHANGES)(rng, data, other)
    return data


def _odd_token(rng: random.Random, data: bytes, other: bytes) -> bytes:
    tokens = [match.span() for match in _TOKEN.finditer(data[:20_000])]
    if not tokens:
        return _bytes(rng, data, other)
    start, end = rng.choice(tokens)
    return data[:start] + rng.choice(_ODD) + data[end:]


def _bytes(rng: random.Random, data: bytes, other: bytes) -> bytes:
    changed = bytearray(data or b"\x00")
    for _ in range(rng.choice((1, 1, 2, 8))):
        changed[_place(rng, len(changed))] = rng.randrange(256)
    return bytes(changed)


def _words(rng: random.Random, data: bytes, other: bytes) -> bytes:
    word = rng.choice(_BINARY)
    place = _place(rng, len(data) + 1)
    return data[:place] + word + data[place + len(word) :]


def _cut(rng: random.Random, data: bytes, other: bytes) -> bytes:
    return data[: _place(rng, len(data) + 1)]


def _without(rng: random.Random, data: bytes, other: bytes) -> bytes:
    start = _place(rng, len(data) + 1)
    return data[:start] + data[start + rng.choice((1, 2, 4, 8, 50, 500)) :]


def _twice(rng: random.Random, data: bytes, other: bytes) -> bytes:
    start = _place(rng, len(data) + 1)
    piece = data[start : start + rng.choice((1, 4, 20, 100))]
    return data[:start] + piece * rng.choice((2, 3, 50)) + data[start:]


def _inserted(rng: random.Random, data: bytes, other: bytes) -> bytes:
    place = _place(rng, len(data) + 1)
    return data[:place] + rng.choice(_ODD) + data[place:]


def _spliced(rng: random.Random, data: bytes, other: bytes) -> bytes:
    return data[: _place(rng, len(data) + 1)] + other[_place(rng, len(other) + 1) :]


_CHANGES = (_odd_token, _odd_token, _odd_token, _bytes, _words, _cut, _without, _twice, _inserted, _spliced)


def _place(rng: random.Random, size: int) -> int:
    """Anywhere, half of the time near the beginning, where headers are."""
    return rng.randrange(min(size, 200)) if rng.random() < 0.5 and size else rng.randrange(max(size, 1))


def mutated_file(rng: random.Random, name: str, data: bytes, other: bytes) -> bytes:
    """A file changed as it is, or what a compressed one holds."""
    if rng.random() < 0.7:
        if data[:2] == b"PK":
            return _in_zip(rng, data, other)
        if data[:2] == b"\x1f\x8b":
            packer = zlib.compressobj(wbits=31)
            return packer.compress(mutated(rng, zlib.decompress(data, 47), zlib.decompress(data, 47))) + packer.flush()
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            return _in_png(rng, data)
    return mutated(rng, data, other)


def _in_zip(rng: random.Random, data: bytes, other: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    chosen = rng.choice(list(members))
    if rng.random() < 0.1:
        del members[chosen]
    else:
        members[chosen] = mutated(rng, members[chosen], rng.choice(list(members.values())))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return packed.getvalue()


def _in_png(rng: random.Random, data: bytes) -> bytes:
    """One chunk changed, with a checksum that is right."""
    chunks, place = [], 8
    while place + 8 <= len(data):
        size = int.from_bytes(data[place : place + 4], "big")
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + size]))
        place += 12 + size
    index = rng.randrange(len(chunks))
    kind, content = chunks[index]
    is_pixels = kind == b"IDAT"
    content = zlib.decompress(content) if is_pixels and index == 2 else content
    content = mutated(rng, content, content)
    chunks[index] = kind, zlib.compress(content) if is_pixels else content
    parts = [data[:8]]
    for kind, content in chunks:
        parts += [len(content).to_bytes(4, "big"), kind, content, zlib.crc32(kind + content).to_bytes(4, "big")]
    return b"".join(parts)


def mutated_input(rng: random.Random, seeds: list[Files]) -> Files:
    """A valid input with one file changed, or, of several, left out or empty."""
    files = dict(rng.choice(seeds))
    name = rng.choice(list(files))
    kind = rng.random()
    if len(files) > 1 and kind < 0.02:
        del files[name]
    elif kind < 0.03:
        files[name] = b""
    else:
        files[name] = mutated_file(rng, name, files[name], rng.choice(list(rng.choice(seeds).values())))
    return files


# --- running --------------------------------------------------------------------------------------------------------


def write(files: Files, folder: Path) -> None:
    """The files of an input, alone, in a folder."""
    for path in list(folder.iterdir()) if folder.is_dir() else []:
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def outcome_of(run: Callable[[Path], object], folder: Path) -> str:
    """ "" for a result, "refused" for a ReorientError as it should be; anything else is the kind of a finding."""
    try:
        run(folder)
    except ReorientError as error:
        return _wrong_message(str(error)) or "refused"
    except (Exception, SystemExit, TooSlow) as error:
        return f"{type(error).__name__} {_line(error)}"
    return ""


def _wrong_message(text: str) -> str:
    if not text.strip() or "\n" in text or len(text) > MOST_CHARACTERS:
        where = re.sub(r"[^a-z ]+", " ", text.replace("\n", " "))[:60]
        return f"a message of {len(text.splitlines())} lines, {len(text)} characters: {where}"[:120]
    return ""


def _line(error: BaseException) -> str:
    """The innermost line of the package in a traceback."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "/reorient/" in f.filename] or list(frames)
    return f"{Path(own[-1].filename).name}:{own[-1].lineno} {own[-1].name}" if own else ""


def _too_slow(_: int, frame: FrameType | None) -> None:
    raise TooSlow


def fuzz(target: Target, count: int, seed: int, box: Path) -> Outcome:
    """Run a target in this process. ``box``: a folder for the files of an input."""
    rng = random.Random(f"{seed} {target.name}")
    outcome = Outcome()
    seeds = target.seeds()
    for files in seeds:
        write(files, box)
        target.run(box)  # valid inputs are read
    signal.signal(signal.SIGPROF, _too_slow)
    before = _peak_bytes()
    begin = time.process_time()
    for _ in range(count):
        files = mutated_input(rng, seeds)
        write(files, box)
        peak, start = _peak_bytes(), time.process_time()
        signal.setitimer(signal.ITIMER_PROF, MOST_CPU_S)
        try:
            kind = outcome_of(target.run, box)
        except TooSlow:
            kind = "TooSlow"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        growth = _peak_bytes() - peak
        if growth > MOST_BYTES and kind in ("", "refused"):
            kind = f"grows by {growth / 1e9:.0f} GB"
        outcome.inputs += 1
        outcome.results += kind == ""
        outcome.refusals += kind == "refused"
        outcome.slowest_s = max(outcome.slowest_s, time.process_time() - start)
        if kind not in ("", "refused") and _size(files) < _size(outcome.findings.get(kind)):
            outcome.findings[kind] = files
    outcome.seconds = time.process_time() - begin
    outcome.growth_bytes = _peak_bytes() - before
    return outcome


def _size(files: Files | None) -> float:
    return float("inf") if files is None else sum(map(len, files.values()))


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def fuzz_apart(target: Target, count: int, seed: int) -> Outcome:
    """Run a target in a process of its own; a crash of that, or a standstill, is a finding, too."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as place:
        box, result = Path(place) / "box", Path(place) / "outcome"
        box.mkdir()
        child = os.fork()
        if not child:
            _child(target, count, seed, box, result)
        status = _waited(child, box)
        if result.is_file():
            return cast(Outcome, pickle.loads(result.read_bytes()))
        files = {str(path.relative_to(box)): path.read_bytes() for path in box.rglob("*") if path.is_file()}
        return Outcome(inputs=count, findings={f"the process ends with status {status}": files})


def _child(target: Target, count: int, seed: int, box: Path, result: Path) -> None:
    try:
        warnings.simplefilter("ignore")
        logging.disable()
        with redirect_stdout(io.StringIO()):
            outcome = fuzz(target, count, seed, box)
        result.with_suffix(".new").write_bytes(pickle.dumps(outcome))
        result.with_suffix(".new").rename(result)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(0)


def _waited(child: int, box: Path) -> int:
    """The status of a child, which is killed when its input does not change for long."""
    last, since = 0, time.monotonic()
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        if (now := box.stat().st_mtime_ns) != last:
            last, since = now, time.monotonic()
        if time.monotonic() - since > STUCK_S:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.05)


def keep(findings: dict[str, Files], name: str, out: Path) -> None:
    """Write the smallest input of each finding into a folder, beside a text that names its kind."""
    for number, (kind, files) in enumerate(findings.items()):
        folder = out / f"{name}-{number}"
        folder.mkdir(parents=True, exist_ok=True)
        write(files, folder)
        (out / f"{name}-{number}.txt").write_text(kind + "\n")


def main() -> None:
    from fuzz_targets import TARGETS

    parser = argparse.ArgumentParser(description="Fuzz every reader.")
    parser.add_argument("--count", type=int, default=5000, help="inputs of each target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=[target.name for target in TARGETS], help="targets")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder for findings")
    parser.add_argument("--again", type=Path, help="folder of a finding to run again")
    given = parser.parse_args()
    targets = {target.name: target for target in TARGETS}
    if given.again:
        print(targets[given.again.name.rpartition("-")[0]].run(given.again))
        return
    shutil.rmtree(given.out, ignore_errors=True)
    print(
        f"{'target':14} {'inputs':>7} {'results':>8} {'refused':>8} {'findings':>8} {'s':>6} {'slowest':>8} {'MB':>5}"
    )
    total, found = 0, 0
    for name in given.only:
        if missing := targets[name].missing:
            print(f"{name:14} not fuzzed: {missing[0]} is not installed")
            continue
        o = fuzz_apart(targets[name], max(1, round(given.count * targets[name].share)), given.seed)
        total, found = total + o.inputs, found + len(o.findings)
        keep(o.findings, name, given.out)
        print(
            f"{name:14} {o.inputs:7} {o.results:8} {o.refusals:8} {len(o.findings):8} {o.seconds:6.0f} "
            f"{o.slowest_s:8.2f} {o.growth_bytes / 1e6:5.0f}",
            flush=True,
        )
        for number, kind in enumerate(o.findings):
            print(f"    {given.out / f'{name}-{number}'}: {kind}", flush=True)
    print(f"{total} inputs, {found} findings")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
