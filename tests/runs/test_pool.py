"""Workers: order, errors, and an end together with their caller."""

import os
import subprocess
import sys

import pytest

from reorient.errors import ReorientError
from reorient.runs.pool import Pool

SCRIPT = """
from time import sleep
from reorient.runs.pool import Pool
if __name__ == "__main__":
    for seconds in Pool(2).map(lambda seconds: sleep(seconds), [0, 0, 60, 60]):
        print("ready", flush=True)
"""


def test_workers_end_with_a_killed_caller(tmp_path):
    """They hold its standard output, which closes only when the last of them has ended."""
    (tmp_path / "work.py").write_text(SCRIPT)
    command = [sys.executable, tmp_path / "work.py"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as caller:
        assert [caller.stdout.readline() for _ in range(2)] == ["ready\n"] * 2
        caller.kill()
        assert caller.communicate(timeout=20)[0] == ""


def test_results_come_in_order_whatever_the_number_of_workers():
    tasks = list(range(20))
    assert list(Pool(1).map(lambda x: (x, x**2), tasks)) == list(Pool(2).map(lambda x: (x, x**2), tasks))
    assert set(Pool(2).map(lambda _: os.getpid(), tasks)).isdisjoint({os.getpid()})
    assert list(Pool(2).map(abs, [])) == []


def test_an_error_of_a_task_reaches_the_caller():
    def refuse(task):
        raise ReorientError(f"no {task}")

    for workers in (1, 2):
        with pytest.raises(ReorientError, match="no 3"):
            list(Pool(workers).map(refuse, [3]))


@pytest.mark.parametrize("workers", [0, -2])
def test_no_workers_are_refused(workers):
    with pytest.raises(ReorientError, match=f"workers={workers}: expected at least 1, or -1 for one per core"):
        Pool(workers)


def test_one_worker_per_core():
    assert Pool(-1).count == os.cpu_count()
