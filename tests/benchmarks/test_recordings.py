"""``benchmarks/recordings.py``: a folder of recordings made here, of known rotations."""

import csv

import numpy as np
import pytest
import recordings
import trimesh
from recordings import Recordings, measure, read, summarise

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera
from reorient.world.rendering import Placement, Renderer

CAMERA = Camera(96, 96, 250.0, 250.0, 48.0, 48.0)
CENTER_M = np.array([0.0, 0.01, 0.6])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, mesh: trimesh.Trimesh):
    path = tmp_path_factory.mktemp("recordings")
    start = so3.exp(np.array([0.4, -0.7, 0.2]))
    R = np.stack([so3.exp(np.radians(angle) * np.array([0.6, 0.8, 0.0])) @ start for angle in (0, 10, 20)])
    depth_m = np.stack([Renderer(mesh).depth(CAMERA, each, Placement(0.08, CENTER_M)) for each in R])
    camera = np.array([96, 96, 250, 250, 47.5, 47.5])  # centres at integers
    arrays = {"depth_m": depth_m.astype(np.float32), "camera": camera, "R_camera_object": R}
    np.savez(path / "a_fixed.npz", tool_m=CENTER_M, **arrays)
    np.savez(path / "b_moving.npz", tool_m=np.tile(CENTER_M, (3, 1)), **arrays)
    return path


def test_every_pair_has_a_row_for_each_estimator_and_pivot(folder, tmp_path):
    config = Recordings(folder, tmp_path / "rows.csv", ("gicp",))
    rows = measure(config)
    assert [(row["recording"], row["pivot"]) for row in rows].count(("a_fixed", "1")) == 3
    assert len(rows) == 9  # the moving point is no pivot
    assert {row["angle_deg"] for row in rows} == {"10.000", "20.000"}
    assert max(float(row["error_deg"]) for row in rows) < 1  # the direction of the truth is that of the estimates
    kept = rows[:4]
    lines = (tmp_path / "rows.csv").read_text().splitlines(keepends=True)
    (tmp_path / "rows.csv").write_text("".join(lines[:5]) + lines[5][:20])  # killed while writing
    again = measure(config)
    assert again[:4] == kept
    assert len(again) == 9
    table = summarise(again, config.edges_deg)
    assert "| a | 0–33° | gicp | given | 3 |" in table
    assert "100.0% of 3" in table


def test_listed_pairs_and_unknown_pixels_are_used(folder, tmp_path):
    images = read(folder / "a_fixed.npz").images
    assert images[0].camera == CAMERA
    with np.load(folder / "a_fixed.npz") as arrays:
        np.savez(tmp_path / "c.npz", unknown=np.ones((3, 96, 96), bool) * (np.arange(96) < 40), **arrays)
    (tmp_path / "pairs.csv").write_text("recording,current,goal,angle_deg\nc,2,0,20\n")
    assert read(tmp_path / "c.npz").images[0].unknown[:, :40].all()
    rows = measure(Recordings(tmp_path, tmp_path / "rows.csv", ("gicp",)))
    assert [(row["current"], row["goal"]) for row in rows] == [("2", "0")] * 2


def test_other_files_are_refused(tmp_path):
    np.savez(tmp_path / "x.npz", depth=np.ones((2, 4, 4)))
    with pytest.raises(ReorientError, match="is no recording"):
        measure(Recordings(tmp_path, tmp_path / "rows.csv", ("gicp",)))
    (tmp_path / "x.npz").unlink()
    with pytest.raises(ReorientError, match="no recordings in"):
        measure(Recordings(tmp_path, tmp_path / "other.csv", ("gicp",)))


def test_a_refused_pair_counts_as_no_rotation(folder, tmp_path, monkeypatch):
    class Refusing:
        def estimate(self, current, goal, pivot_m=None, history=()):
            raise ReorientError("nothing here")

    monkeypatch.setattr(recordings, "load_estimator", lambda name: Refusing())
    rows = measure(Recordings(folder, tmp_path / "rows.csv", ("mine",)))
    assert {row["message"] for row in rows} == {"nothing here"}
    assert all(float(row["error_deg"]) == pytest.approx(float(row["angle_deg"]), abs=0.01) for row in rows)
    assert csv.DictReader((tmp_path / "rows.csv").open()).fieldnames == list(recordings.COLUMNS)
