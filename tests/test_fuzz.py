"""A few hundred inputs of the fuzzer (make fuzz), and that it sees what it looks for."""

import random
import time

import fuzz
import pytest
from fuzz_targets import TARGETS

from reorient.errors import ReorientError

NAMES = (
    "depth",
    "mask",
    "camera",
    "hand-eye",
    "calibration",
    "poses",
    "robot",
    "goal",
    "record",
    "run",
    "trees",
    "words",
)


@pytest.mark.parametrize("name", NAMES)
def test_mutated_files_give_a_result_or_one_line(name, tmp_path):
    (target,) = (target for target in TARGETS if target.name == name)
    outcome = fuzz.fuzz(target, 25, 1, tmp_path)
    assert outcome.findings == {}
    assert outcome.inputs == 25 == outcome.results + outcome.refusals


def broken(folder):
    text = (folder / "x.json").read_bytes()
    if b"1e308" in text:
        raise KeyError("x")
    if b"NaN" in text:
        raise ReorientError("two\nlines")
    if b"[[1]]" in text:
        while True:
            time.process_time()
    raise ReorientError("expected another file")


def test_a_fault_of_each_kind_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(fuzz, "MOST_CPU_S", 0.05)
    target = fuzz.Target("broken", lambda: [{"x.json": b'{"a": 1, "b": [2, 3]}'}], lambda folder: None)
    assert fuzz.fuzz(target, 50, 0, tmp_path).results == 50
    seeds = target.seeds()
    kinds = set()
    for k in range(600):
        fuzz.write(fuzz.mutated_input(random.Random(k), seeds), tmp_path)
        kinds.add(fuzz.outcome_of(broken, tmp_path).split()[0] if b"[[1]]" not in whole(tmp_path) else "refused")
    assert {"KeyError", "a", "refused"} <= kinds
    (tmp_path / "x.json").write_bytes(b"[[1]]")
    outcome = fuzz.fuzz(fuzz.Target("slow", lambda: [{"x.json": b"[[1]]"}], slow_after_first()), 1, 0, tmp_path)
    assert [kind.split()[0] for kind in outcome.findings] == ["TooSlow"]


def whole(folder):
    return (folder / "x.json").read_bytes() if (folder / "x.json").is_file() else b""


def slow_after_first():
    calls = []

    def run(folder):
        calls.append(folder)
        while len(calls) > 1:
            time.process_time()

    return run
