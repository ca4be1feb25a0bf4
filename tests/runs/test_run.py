"""A run that is interrupted, killed or started twice: no task is lost, none is measured twice."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

import pytest

from reorient.errors import ReorientError
from reorient.reporting.rows import read_table
from reorient.runs.pool import Pool
from reorient.runs.run import RowStore, resumable


@dataclass(frozen=True)
class Config:
    most: int = 3


def square(task):
    if task == 3:
        raise KeyboardInterrupt
    return {"rows": [{"task": str(task), "square": str(task**2)}], "more": [{"task": str(task)}]}


def run(folder, numbers, config=None, measure=square, workers=1, **more):
    tasks = {f"task {number}": number for number in numbers}
    return list(resumable(folder, config or Config(), tasks, measure, RowStore(), Pool(workers), **more))


def squares(folder):
    return [row["square"] for row in read_table(folder / "rows.csv.gz", ["square"])]


def test_an_interrupted_run_continues(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, [1, 2, 3, 4])
    with (tmp_path / "partial.jsonl").open("a") as torn:
        torn.write('{"task": "task 3", "rows": [{"ta')
    once = []
    assert run(tmp_path, [1, 2, 3, 4], measure=lambda task: once.append(task) or square(-task)) == [
        *((2, 4), (3, 4), (4, 4))
    ]
    assert once == [3, 4]
    assert squares(tmp_path) == ["1", "4", "9", "16"]
    assert len(read_table(tmp_path / "more.csv.gz", ["task"])) == 4
    assert run(tmp_path, [1, 2, 3, 4]) == [(4, 4)]
    assert {path.name for path in tmp_path.iterdir()} == {".lock", "config.json", "more.csv.gz", "rows.csv.gz"}


@pytest.mark.slow
def test_rows_do_not_depend_on_the_workers(tmp_path):
    for workers in (1, 2):
        run(tmp_path / str(workers), [5, 2, 8, 1], workers=workers)
    one, two = ((tmp_path / str(workers) / "rows.csv.gz").read_bytes() for workers in (1, 2))
    assert one == two


def test_provenance_is_kept_and_compared(tmp_path):
    run(tmp_path, [1, 2], names=["a"])
    record = json.loads((tmp_path / "config.json").read_text())
    assert record["config"] == {"most": 3}
    assert {"version", "commit", "command", "workers", "backend"} < set(record)
    for config, more in ((Config(4), {"names": ["a"]}), (Config(), {"names": ["b"]})):
        with pytest.raises(ReorientError, match="holds a run of another config: expected the same config, or a new fo"):
            run(tmp_path, [1, 2], config, **more)
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(ReorientError, match=r"broken .*config.json"):
        run(tmp_path, [1, 2], names=["a"])


def test_tasks_are_checked_by_their_keys_when_rows_are_packed(tmp_path):
    """As many lines as tasks, but one of them twice: what two processes in one folder used to leave."""
    store = RowStore()
    for task in (1, 1, 4):
        store.keep(tmp_path, f"task {task}", square(task))
    with pytest.raises(ReorientError, match="1 of 3 tasks have no rows in .*, the first is 'task 2'"):
        store.pack(tmp_path, ["task 1", "task 2", "task 4"])
    assert not (tmp_path / "rows.csv.gz").exists()
    run(tmp_path, [1, 2, 4])
    assert squares(tmp_path) == ["1", "4", "16"]


def test_results_of_another_version_are_not_mixed(tmp_path):
    store = RowStore()
    store.keep(tmp_path, "task 9", square(9))
    with pytest.raises(ReorientError, match="holds results of other tasks, such as 'task 9'"):
        run(tmp_path, [1, 2])
    with pytest.raises(ReorientError, match="rows with other columns: it was begun by another version"):
        store.keep(tmp_path, "task 1", {"rows": [{"task": "1"}]})
    with pytest.raises(ReorientError, match="rows with other columns"):
        run(tmp_path, [9, 1], measure=lambda task: {"rows": [{"task": str(task)}]})


EVALUATE = ("evaluate", "--count", "2", "--pairs", "12", "--ranges-deg", "0", "30", "--noise-mm", "1", "--workers", "2")


def evaluate(folder, **more):
    command = [sys.executable, "-m", "reorient", EVALUATE[0], str(folder), *EVALUATE[1:]]
    return subprocess.Popen(command, text=True, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, **more)


def lines(folder):
    file = folder / "partial.jsonl"
    return len(file.read_text().splitlines()) if file.is_file() else 0


def wait_for_rows(folder, process):
    deadline = time.monotonic() + 60
    while lines(folder) < 2:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def rows_without_times(folder):
    return [row | {"seconds": ""} for row in read_table(folder / "rows.csv.gz", ["pair"])]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot stop and continue a process by signals")
@pytest.mark.slow
def test_a_second_process_is_refused_and_a_killed_one_does_not_block(tmp_path):
    first = evaluate(tmp_path / "run", start_new_session=True)
    wait_for_rows(tmp_path / "run", first)
    os.kill(first.pid, signal.SIGSTOP)  # it keeps the lock
    second = evaluate(tmp_path / "run")
    _, message = second.communicate(timeout=60)
    assert second.returncode == 2
    assert message.startswith("reorient: another process is writing into")
    assert len(message.splitlines()) == 1
    os.kill(first.pid, signal.SIGKILL)
    first.communicate()
    assert 2 <= lines(tmp_path / "run") < 12
    for folder in ("run", "whole"):
        again = evaluate(tmp_path / folder)
        _, message = again.communicate(timeout=120)
        assert again.returncode == 0, message
    assert rows_without_times(tmp_path / "run") == rows_without_times(tmp_path / "whole")
    assert [row["pair"] for row in rows_without_times(tmp_path / "run")[::2]] == [str(k) for k in range(12)]
