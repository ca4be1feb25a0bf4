"""Other people's registration as estimators. What does not import here must say so; every test says what it met."""

import warnings

import numpy as np
import pytest

import peers
from peers import NEEDS, PEERS, Peers
from registration import Peer, Starts, optional
from reorient import so3
from reorient.errors import ReorientError
from reorient.experiments.evaluation import Evaluation
from reorient.reporting import markdown_table, read_rows
from reorient.world.objects import ObjectSource
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised


@pytest.fixture(scope="module")
def pair():
    renderer = Renderer(ObjectSource(count=5).open().load("generated-0-000004"))
    angle_rad = np.radians(40)
    rng = np.random.default_rng(1)
    return sample_pair(rng, renderer, load_world("benchmark"), randomised(0.0), angle_rad, angle_rad)


@pytest.mark.parametrize("name", PEERS)
def test_finds_the_rotation_or_says_what_is_missing(name, pair):
    try:
        optional(NEEDS.get(name, "small_gicp"))
    except ReorientError as error:
        warnings.warn(f"{name}: {error}", stacklevel=1)
        with pytest.raises(ReorientError, match="does not import"):
            PEERS[name].estimate(pair.current, pair.goal)
        return
    estimate = PEERS[name].estimate(pair.current, pair.goal, pair.pivot_m)
    assert np.degrees(so3.angle_difference(estimate.R_goal_current, pair.R_goal_current)) < 1
    moved = pair.placement.center_m - estimate.R_goal_current @ pair.placement.center_m - estimate.t_goal_current_m
    assert np.linalg.norm(moved) < 0.002
    assert estimate.evidence.inlier_ratio > 0.5
    assert estimate.confidence is None
    again = PEERS[name].estimate(pair.current, pair.goal)
    # nor does the pivot change anything; some peers' threads add up in any order, so the last digits differ
    assert so3.angle_difference(again.R_goal_current, estimate.R_goal_current) < 1e-6


def test_of_many_starts_the_best_is_kept(pair):
    for best_by in ("score", "inliers"):
        estimate = Peer(Starts(60), best_by, coarse=True).estimate(pair.current, pair.goal)
        assert np.degrees(so3.angle_difference(estimate.R_goal_current, pair.R_goal_current)) < 1


def test_a_missing_package_says_how_to_get_it():
    with pytest.raises(ReorientError, match=r"no_such_thing does not import \(.*\): expected `pip install"):
        optional("no_such_thing")


def test_the_run_goes_on_without_what_is_missing(tmp_path, monkeypatch, capsys):
    def absent(module):
        if module == "open3d":
            raise ReorientError("open3d does not import (libGL.so.1)")
        return optional(module)

    monkeypatch.setattr(peers, "optional", absent)
    config = Evaluation(ObjectSource(count=1), ("kiss-matcher", "fgr", "icp"), ranges_deg=((0, 30),), pairs=2)
    peers.main(Peers(tmp_path / "run", config))
    assert "fgr: not installable here: open3d does not import (libGL.so.1)" in capsys.readouterr().out
    rows = read_rows(tmp_path / "run")
    assert [row["estimator"] for row in rows] == ["kiss-matcher", "icp"] * 4
    assert markdown_table(rows).count("| kiss-matcher |") == 2
    assert "Kiss(voxel=" in (tmp_path / "run" / "config.json").read_text()
