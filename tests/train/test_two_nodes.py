"""A Ray cluster of two nodes, of which one is killed in the middle: nothing is lost, and the rows are the same."""

import time
from contextlib import suppress

import pytest
import ray
from ray.cluster_utils import Cluster

from reorient.errors import ReorientError
from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.reporting.rows import read_table
from reorient.runs.pool import Pool
from reorient.world.objects import ObjectSource

CONFIG = Evaluation(ObjectSource(count=2, object_seed=7), ("icp",), ranges_deg=((0, 30),), noise_mm=(1.0,), pairs=8)


def patiently(start, **options):
    """Ray gives up after half a minute, which a loaded machine can need."""
    for _ in range(3):
        with suppress(Exception):
            return start(**options)
    return start(**options)


@pytest.fixture
def cluster():
    """Two raylets of one core each."""
    cluster = patiently(Cluster, initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.second = patiently(cluster.add_node, num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster
    ray.shutdown()
    cluster.shutdown()


TASKS = 300  # the workers of a loaded machine need their time to begin


def rows(folder):
    return [row | {"seconds": ""} for row in read_table(folder / "rows.csv.gz", ["pair"])]


def test_a_node_killed_in_the_middle_costs_no_task_and_changes_no_row(cluster, tmp_path):
    killed = tmp_path / "killed"

    def square_and_node(task):  # local: the nodes cannot import this file
        time.sleep(0 if killed.exists() else 0.2)
        return task**2, ray.get_runtime_context().get_node_id()

    def refuse(task):
        raise ReorientError(f"no {task}")

    squares, nodes = [], []
    for square, node in Pool(2, "ray").map(square_and_node, range(TASKS)):
        squares.append(square)
        nodes.append(node)
        if len(set(nodes)) == 2 and not killed.exists():  # both work
            cluster.remove_node(cluster.second, allow_graceful=False)
            killed.touch()
    assert killed.exists()
    assert squares == [task**2 for task in range(TASKS)]
    assert len(set(nodes[-4:])) == 1
    third = patiently(cluster.add_node, num_cpus=1)
    for done, _ in evaluate(CONFIG, tmp_path / "ray", Pool(2, "ray")):
        if done == 3:
            cluster.remove_node(third, allow_graceful=False)
    list(evaluate(CONFIG, tmp_path / "here"))
    assert rows(tmp_path / "ray") == rows(tmp_path / "here")
    with pytest.raises(ReorientError, match="^no 3$"):
        list(Pool(2, "ray").map(refuse, [3]))
    deadline = time.monotonic() + 60  # the cluster takes a while to notice that nodes are gone
    while Pool(-1, "ray").count != 1:
        assert time.monotonic() < deadline
        time.sleep(0.5)
