"""Goals from a mesh: where the mesh is, from which sides it is seen, and wrong units by name."""

import numpy as np
import pytest
import trimesh

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, Goal
from reorient.imaging.viewpoints import spread_rotations
from reorient.registration.coverage import coverage
from reorient.se3 import apply, transform

CAMERA = Camera(96, 96, 220.0, 220.0, 48.0, 48.0)
R_POSE = so3.exp(np.array([0.4, -0.8, 0.3]))


@pytest.fixture(scope="module")
def part(mesh, tmp_path_factory):
    """The corner, 60 mm high, in millimetres, away from its file's origin."""
    path = tmp_path_factory.mktemp("mesh") / "part.stl"
    moved = mesh.copy()
    moved.apply_scale(50.0)
    moved.apply_translation((100.0, -20.0, 5.0))
    moved.export(path)
    return path, moved


@pytest.fixture(scope="module")
def pose(part):
    """The pose that has the middle of the part at 0.5 m."""
    middle_m = part[1].bounds.mean(axis=0) / 1000
    return transform(R_POSE, np.array([0.01, 0.0, 0.5]) - R_POSE @ middle_m)


def off_surface_m(points_m, part, T):
    """Largest distance of points (camera axes) from the mesh."""
    local_mm = apply(np.linalg.inv(T), points_m) * 1000
    nearest_mm = np.full(len(local_mm), np.inf)
    for triangle in part[1].triangles:
        on_mm = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(local_mm), 3, 3)), local_mm)
        nearest_mm = np.minimum(nearest_mm, np.linalg.norm(on_mm - local_mm, axis=1))
    return float(nearest_mm.max()) / 1000


def test_all_views_show_the_mesh_where_it_shall_be(part, pose):
    goal = Goal.from_mesh(part[0], pose, CAMERA, views=3)
    assert off_surface_m(goal.image.points(), part, pose) < 2e-5
    assert len(goal.views) == 3
    for view in goal.views:
        in_goal_pose_m = view.image.points() @ view.R_goal_view.T + view.t_goal_view_m
        assert off_surface_m(in_goal_pose_m, part, pose) < 2e-5
        assert off_surface_m(view.image.points(), part, pose) > 5e-3  # the inverse would show here
    assert np.allclose(goal.image.points().mean(axis=0), [0.01, 0.0, 0.5], atol=0.03)


def test_the_default_views_cover_all_sides(part, pose):
    shares = [coverage(Goal.from_mesh(part[0], pose, CAMERA, views=n)) for n in (0, 5)]
    assert [each.mean for each in shares] == sorted(each.mean for each in shares)
    assert shares[0].mean < 0.5
    assert shares[-1].mean > 0.95
    assert shares[-1].starts == 1.0


@pytest.mark.parametrize(
    ("unit_m", "expected"),
    [(1.0, r"is the unit mm \(60 x 45 x 35 mm\)"), (1e-6, "is the unit mm"), (0.0254, "1524 x"), (0.0, "above 0")],
)
def test_a_wrong_unit_is_refused_by_name(part, pose, unit_m, expected):
    with pytest.raises(ReorientError, match=expected) as caught:
        Goal.from_mesh(part[0], pose, CAMERA, unit_m=unit_m)
    assert "\n" not in str(caught.value)


def test_wrong_transforms_and_files_are_refused(part, pose, tmp_path):
    with pytest.raises(ReorientError, match="rigid"):
        Goal.from_mesh(part[0], pose * 2, CAMERA)
    with pytest.raises(ReorientError, match="no mesh file"):
        Goal.from_mesh(tmp_path / "absent.stl", pose, CAMERA)
    with pytest.raises(ReorientError, match="beyond the frame"):
        Goal.from_mesh(part[0], transform(np.eye(3), np.array([0.2, 0, 0])) @ pose, CAMERA)
    with pytest.raises(ReorientError, match="does not fit before"):
        Goal.from_mesh(part[0], transform(np.eye(3), np.array([0, 0, -1.0])) @ pose, CAMERA)


# --- viewpoints -----------------------------------------------------------------------------------------------------


def directions(rotations):
    return np.array([[0, 0, 1], *(R.T[:, 2] for R in rotations)])


def test_five_views_and_the_present_one_look_along_six_directions():
    z = directions(spread_rotations(5))
    cosines = np.sort(z @ z.T, axis=1)
    assert np.allclose(cosines, np.array([-1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), atol=1e-9)


def test_only_reachable_rotations_are_chosen_and_they_spread_as_far_as_they_can():
    near = spread_rotations(4, lambda R: float(so3.angle(R)) < np.radians(61))
    assert len(near) == 4
    assert all(float(so3.angle(R)) < np.radians(61) for R in near)
    assert max(float(so3.angle(R)) for R in near) > np.radians(59)
    assert spread_rotations(3, lambda R: False) == []
    assert spread_rotations(0) == []
