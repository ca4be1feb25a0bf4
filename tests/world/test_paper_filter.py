"""The paper's filter on solids whose symmetry is in the books, and the poses it tests them in."""

import warnings

import numpy as np
import pytest
import trimesh
from solids import nearest_angle, part_of, posed

from reorient import so3
from reorient.errors import ReorientError
from reorient.world.paper_filter import has_symmetric_stable_pose, has_trimesh_axis, passes_paper_filter, stable_poses


@pytest.mark.parametrize("name", ["cylinder", "cube", "bottle", "box", "L bracket"])
def test_filter_rejects_the_symmetric(name):
    assert not passes_paper_filter(posed(name)[0])


def test_filter_accepts_the_irregular_whole_or_open():
    mesh, _ = posed("irregular bracket")
    assert passes_paper_filter(mesh)
    assert passes_paper_filter(part_of(mesh.copy(), lambda m: np.arange(len(m.faces)) % 3 > 0))


def test_the_two_tests_of_the_filter_see_different_things():
    assert has_trimesh_axis(posed("bottle")[0])
    assert not has_trimesh_axis(posed("L bracket")[0])  # three moments of inertia, and yet it has a symmetry
    assert has_symmetric_stable_pose(posed("L bracket")[0])


def test_box_rests_on_its_faces_and_a_sheet_on_either_side():
    poses = stable_poses(trimesh.creation.box((1, 2, 3)))
    assert len(poses) == 6
    assert all(so3.is_rotation(R) for R in poses)
    assert abs(poses[0][2, 0]) == pytest.approx(1)  # the widest footing is across x, which then points up or down
    assert len(stable_poses(posed("sheet")[0])) == 2


def test_stable_poses_are_those_of_trimesh():
    mesh, _ = posed("irregular bracket")
    theirs, _ = trimesh.poses.compute_stable_poses(mesh.convex_hull, center_mass=mesh.convex_hull.center_mass, seed=0)
    ours = stable_poses(mesh)  # the bracket's parts overlap, so it is as heavy as its hull
    assert len(ours) == len(theirs)
    assert nearest_angle(ours, theirs[:, :3, :3]).max() < 0.01


def test_open_and_flat_meshes_do_not_crash_or_warn():
    triangle = trimesh.Trimesh([[0, 0, 0], [3, 0, 0], [0.4, 1, 0]], [[0, 1, 2]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for mesh in (posed("sheet")[0], posed("open bowl")[0], posed("box without a side")[0], triangle):
            assert isinstance(passes_paper_filter(mesh), bool)


def test_what_is_no_surface_is_refused():
    with pytest.raises(ReorientError, match="no faces"):
        passes_paper_filter(trimesh.Trimesh())
