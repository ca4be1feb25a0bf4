"""Work on several processes."""

import subprocess
import sys

import pytest

from reorient.errors import ReorientError
from reorient.runs.pool import check_workers

SCRIPT = """
from time import sleep
from reorient.runs.pool import processes
if __name__ == "__main__":
    with processes(2) as pool:
        list(pool.map(abs, range(8)))
        busy = pool.submit(sleep, 60)
        print("ready", flush=True)
        busy.result()
"""


def test_workers_end_with_a_killed_caller(tmp_path):
    """They hold its standard output, which closes only when the last of them has ended."""
    (tmp_path / "work.py").write_text(SCRIPT)
    with subprocess.Popen([sys.executable, tmp_path / "work.py"], stdout=subprocess.PIPE, text=True) as caller:
        assert caller.stdout.readline() == "ready\n"
        caller.kill()
        assert caller.communicate(timeout=20)[0] == ""


@pytest.mark.parametrize("workers", [0, -2])
def test_no_workers_are_refused(workers):
    with pytest.raises(ReorientError, match=f"{workers} workers: expected at least 1"):
        check_workers(workers)
