"""``benchmarks/real_frames.py``: conditions of the same pairs, rows, and their summary."""

import numpy as np
import pytest
from real_frames import GROUPS, ON_HOLES, UNKNOWN_SHARE, RealFrames, measure, summarise
from real_frames import _drawn as drawn

from reorient.errors import ReorientError
from reorient.reporting.rows import read_table
from reorient.world.objects import ObjectSource
from reorient.world.pairs import share_on_holes
from reorient.world.rendering import Renderer

OBJECTS = ObjectSource(count=3, object_seed=1700)
CONFIG = RealFrames(OBJECTS, ("gicp",), pairs=1)


@pytest.fixture(scope="module")
def renderer():
    objects = OBJECTS.open()
    return Renderer(objects.load(objects.names[1]))


@pytest.mark.parametrize("name", [name for name in GROUPS if name != "pivot"])
def test_conditions_share_the_pair(renderer, name):
    low, high = GROUPS[name].ranges_deg[0]
    conditions = drawn(CONFIG, renderer, 1, name, (low, high), 1.0)
    none = conditions[0]
    assert none.name == "none"
    assert len(conditions) > 1
    for condition in conditions[1:]:
        assert np.array_equal(condition.pair.R_goal_current, none.pair.R_goal_current)
        assert any(
            a.depth_m.shape != b.depth_m.shape or not np.array_equal(a.depth_m, b.depth_m)
            for a, b in ((condition.pair.current, none.pair.current), (condition.pair.goal, none.pair.goal))
        )


def test_pivots_are_shifted_away_from_the_camera(renderer):
    none, nominal, *shifted = drawn(CONFIG, renderer, 1, "pivot", (0, 60), 1.0)
    assert not none.with_pivot
    for condition in (nominal, *shifted):
        assert condition.with_pivot
        shift_m = condition.pair.pivot_m - none.pair.pivot_m
        assert np.linalg.norm(shift_m) == pytest.approx(condition.level / 100)
        assert shift_m[2] >= 0


def test_lost_pixels_are_known_or_not_and_are_the_share(renderer):
    conditions = drawn(CONFIG, renderer, 2, "unknown", (0, 30), 0.0)
    whole = conditions[0].pair
    names = [condition.name for condition in conditions]
    assert names[-2:] == ["frame", "frame"]
    assert "gripper" in names
    for condition in conditions[1:]:
        pair = condition.pair
        assert UNKNOWN_SHARE[0] <= condition.level <= UNKNOWN_SHARE[1]
        left = [
            image.valid.sum() / full.valid.sum()
            for image, full in zip((pair.current, pair.goal), (whole.current, whole.goal), strict=True)
        ]
        assert min(left) == pytest.approx(1 - condition.level, abs=0.15)
        if condition.name != "frame":
            assert pair.goal.unknown.any() == (condition.known == "1")
    known, zero = (condition.pair.goal for condition in conditions[-2:])
    assert known.camera != zero.camera == whole.goal.camera
    assert known.valid.sum() == zero.valid.sum()
    assert known.points().mean(axis=0) == pytest.approx(zero.points().mean(axis=0), abs=1e-9)


def test_points_land_on_holes(renderer):
    none, known, zero = drawn(CONFIG, renderer, 0, "holes", (33, 60), 0.0)
    assert ON_HOLES[0] <= known.level <= ON_HOLES[1]
    assert share_on_holes(none.pair) < known.level == share_on_holes(zero.pair)
    assert known.pair.goal.unknown.any()
    assert not zero.pair.goal.unknown.any()


def test_rows_are_raw_and_the_table_counts_them(tmp_path):
    config = RealFrames(OBJECTS, ("gicp",), ("stray",), (0.0,), pairs=2)
    assert list(measure(config, tmp_path))[-1] == (2, 2)
    rows = read_table(tmp_path / "rows.csv.gz", ("condition", "error_sym_deg", "object", "level"))
    assert len(rows) == 2 * 3 * 2
    lines = summarise(rows).splitlines()
    assert sum("| stray | none |" in line for line in lines) == 3
    right = sum(float(row["error_sym_deg"]) < 5 for row in rows if row["low_deg"] == "0" and row["condition"] == "none")
    assert f"{right / 2:.1%} of 2" in lines[2]
    assert list(measure(config, tmp_path))[-1] == (2, 2)


def test_unknown_groups_are_named():
    with pytest.raises(ReorientError, match="did you mean 'holes'"):
        RealFrames(groups=("hole",))
