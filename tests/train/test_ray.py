"""Every verb that measures makes the same files on a local Ray cluster of two workers as on two local processes."""

import csv
import gzip
import hashlib

import pytest
import ray

from reorient.cli import main

OBJECTS = ("--count", "2", "--object-seed", "7")
COMMANDS = {
    "evaluate": ("--pairs", "5", "--estimators", "gicp", "--ranges-deg", "0", "30", "--noise-mm", "1", *OBJECTS),
    "loops": ("--objects", "2", "--trials", "2", "--systems", "gicp/direct", "--start-deg", "10", *OBJECTS),
    "verifier make": ("--pairs", "1", "--per-shard", "1", "--effort", "fast", *OBJECTS),
    "generate": ("--pairs-per-object", "200", "--count", "3"),
    "cell": ("--objects", "1", "--trials", "2", "--systems", "gicp/direct", "--count", "60"),
}


@pytest.fixture(scope="module")
def _cluster():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


def contents(folder):
    """Tables without their times, and the digest of any other file of results."""
    found = {}
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        if file.name.endswith(".csv.gz"):
            with gzip.open(file, "rt", newline="") as text:
                found[str(file.relative_to(folder))] = [row | {"seconds": ""} for row in csv.DictReader(text)]
        elif file.suffix not in (".json", ".md", ".html", ".gif", ".lock") and file.name != ".lock":
            found[str(file.relative_to(folder))] = hashlib.sha256(file.read_bytes()).hexdigest()
    return found


@pytest.mark.usefixtures("_cluster")
@pytest.mark.parametrize("verb", COMMANDS)
def test_ray_makes_the_same(verb, tmp_path):
    if verb == "cell":
        pytest.importorskip("mujoco")
    for backend in ("processes", "ray"):
        where = str(tmp_path / backend)
        main([*verb.split(), where, *COMMANDS[verb], "--workers", "2", "--backend", backend])
    one, two = (contents(tmp_path / backend) for backend in ("processes", "ray"))
    assert len(one) >= 1
    assert one == two


@pytest.mark.usefixtures("_cluster")
def test_ray_reproduces_the_same(tmp_path):
    """At the size of a few objects of one figure."""
    from reorient.reproducing.object_sets import Full, ObjectSets
    from reorient.reproducing.setting import Setting
    from reorient.runs.pool import Pool
    from reorient.world.objects import generated

    (tmp_path / "non-symmetric.txt").write_text("".join(f"{name}\n" for name in generated(110, 2021).names[:3]))
    for pool in (Pool(2), Pool(2, "ray")):
        setting = Setting(tmp_path / "data", tmp_path / pool.backend, tmp_path, pool=pool)
        ObjectSets(full=Full(count=3)).measure(setting)
    one, two = (contents(tmp_path / backend) for backend in ("processes", "ray"))
    assert len(one) >= 1
    assert one == two
