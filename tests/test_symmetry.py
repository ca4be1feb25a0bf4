"""Groups of solids whose symmetry is in the books, the error that divides it out, and the paper's filter."""

import functools
import warnings

import manifold3d
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from reorient import so3
from reorient.errors import ReorientError
from reorient.symmetry import (
    SYMMETRIC_BELOW,
    has_symmetric_stable_pose,
    has_trimesh_axis,
    passes_paper_filter,
    rotation_group,
    stable_poses,
    symmetric_error,
)

TETRAHEDRON = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
BOTTLE = [[0, 0], [1, 0], [1, 2], [0.4, 2.5], [0.4, 3], [0, 3]]


def extruded(outline, height):
    solid = manifold3d.Manifold.extrude(manifold3d.CrossSection([outline]), height).to_mesh()
    return trimesh.Trimesh(solid.vert_properties[:, :3], solid.tri_verts)


def bracket():
    """Legs of unequal length and a post on one of them: no symmetry."""
    legs = extruded([[0, 0], [3, 0], [3, 0.6], [1, 0.6], [1, 2], [0, 2]], 0.8)
    post = trimesh.creation.cylinder(radius=0.3, height=1.5)
    return legs + post.apply_translation([2.4, 0.3, 0.8])


def part_of(mesh, keep):
    mesh.update_faces(keep(mesh))
    return mesh


SHAPES = {  # the mesh, the number of rotations, the number of axes
    "cube": (lambda: trimesh.creation.box((1, 1, 1)), 24, 0),
    "box": (lambda: trimesh.creation.box((1, 2, 3)), 4, 0),
    "square prism": (lambda: trimesh.creation.box((1, 1, 2)), 8, 0),
    "hexagonal prism": (lambda: trimesh.creation.cylinder(radius=1, height=1.5, sections=6), 12, 0),
    "square pyramid": (lambda: trimesh.creation.cone(radius=1, height=1.5, sections=4), 4, 0),
    "tetrahedron": (lambda: trimesh.convex.convex_hull(np.array(TETRAHEDRON, float)), 12, 0),
    "icosahedron": (trimesh.creation.icosahedron, 60, 0),
    "L bracket": (lambda: extruded([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], 1.0), 2, 0),
    "irregular bracket": (bracket, 1, 0),
    "cylinder": (lambda: trimesh.creation.cylinder(radius=1, height=2.5, sections=64), 2, 1),
    "cylinder of equal moments": (lambda: trimesh.creation.cylinder(radius=1, height=3**0.5, sections=64), 2, 1),
    "bottle": (lambda: trimesh.creation.revolve(np.array(BOTTLE), sections=48), 1, 1),
    "open bowl": (lambda: part_of(trimesh.creation.icosphere(3), lambda m: m.triangles_center[:, 2] < 0.3), 1, 1),
    "sheet": (lambda: trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]), 4, 0),
    "box without a side": (
        lambda: part_of(trimesh.creation.box((1, 2, 3)), lambda m: m.face_normals[:, 0] < 0.5),
        2,
        0,
    ),
}


@functools.cache
def turned(name):
    """The shape out of line with the axes and away from the origin, and how it got there."""
    mesh = SHAPES[name][0]()
    pose = np.eye(4)
    pose[:3, :3] = so3.sample_uniform(np.random.default_rng(sum(map(ord, name))), 1)[0]
    pose[:3, 3] = [1.0, 2.0, 3.0]
    return mesh.apply_transform(pose), pose


@functools.cache
def group_of(name):
    return rotation_group(turned(name)[0])


def members(group):
    """The rotations of a group, with some of the spins if it has an axis."""
    spins = so3.exp(group.axes[:1] * np.arange(5)[:, None]) if len(group.axes) else np.eye(3)[None]
    return (group.rotations[:, None] @ spins).reshape(-1, 3, 3)


def nearest_angle(R, group):
    return so3.angle_difference(group[:, None], R[None]).min(axis=0)


@pytest.mark.parametrize("name", SHAPES)
def test_group_of_a_known_solid(name):
    group = group_of(name)
    assert (len(group.rotations), len(group.axes), group.spherical) == (*SHAPES[name][1:], False)
    assert (group.residual < SYMMETRIC_BELOW) == (name != "irregular bracket")


@pytest.mark.parametrize("name", [n for n, (_, count, _) in SHAPES.items() if count > 1])
def test_rotations_are_a_group_and_map_the_solid_to_itself(name):
    mesh, _ = turned(name)
    group = group_of(name)
    R = members(group)
    assert np.allclose(R[0], np.eye(3), atol=1e-9)
    if len(group.axes) == 0:
        products = (R[:, None] @ R[None]).reshape(-1, 3, 3)
        assert nearest_angle(products, R).max() < 1e-6
        assert nearest_angle(np.swapaxes(R, 1, 2), R).max() < 1e-6
        assert so3.angle_difference(R[:, None], R[None])[~np.eye(len(R), dtype=bool)].min() > np.radians(30)
    vertices = np.asarray(mesh.vertices)
    images = (vertices - group.center) @ np.swapaxes(R, 1, 2) + group.center
    off = np.linalg.norm(images[:, :, None] - vertices, axis=-1).min(axis=2)
    chord = 2 * np.sin(np.pi / 64) if len(group.axes) else 0  # a spin moves the corners of the 64-gon
    assert off.max() < 0.02 * mesh.scale + chord


def test_sphere_is_spherical():
    group = rotation_group(trimesh.creation.icosphere(3).apply_translation([1, 0, 0]))
    assert group.spherical
    assert group.residual < 0.01
    assert np.allclose(group.center, [1, 0, 0], atol=1e-3)
    assert symmetric_error(group, *so3.sample_uniform(np.random.default_rng(0), 3)) == 0.0


def test_residual_tells_symmetric_from_irregular():
    assert group_of("L bracket").residual < 0.01
    assert group_of("cylinder").residual < 0.01
    assert group_of("irregular bracket").residual > 0.15


def test_residual_is_what_its_definition_says():
    mesh, _ = turned("irregular bracket")
    cloud, probes = (trimesh.sample.sample_surface(mesh, n, seed=n)[0] - mesh.centroid for n in (10_000, 100))
    axes = so3.sample_axes(np.random.default_rng(0), 600)
    R = np.concatenate([so3.exp(axes * np.radians(25)), so3.exp(axes * np.pi)])  # it is nearest where turned least
    distance = cKDTree(cloud).query(probes @ np.swapaxes(R, 1, 2))[0]
    at_random = np.quantile(distance, 0.95, axis=1).min() / np.sqrt(np.mean(np.sum(cloud**2, axis=1)))
    assert 0.75 * at_random < group_of("irregular bracket").residual < 1.02 * at_random


def test_residual_and_group_do_not_depend_on_size():
    mesh = turned("L bracket")[0].copy().apply_scale(1e-3)
    group = rotation_group(mesh)
    assert np.allclose(group.residual, group_of("L bracket").residual, atol=1e-3)
    assert nearest_angle(group.rotations, group_of("L bracket").rotations).max() < np.radians(0.5)


@pytest.mark.parametrize("name", ["square prism", "L bracket", "bottle"])
def test_turning_the_mesh_conjugates_the_group(name):
    mesh, _ = turned(name)
    before = group_of(name)
    pose = np.eye(4)
    R = pose[:3, :3] = so3.sample_uniform(np.random.default_rng(5), 1)[0]
    pose[:3, 3] = [-1.0, 0.5, 2.0]
    after = rotation_group(mesh.copy().apply_transform(pose))
    assert len(after.rotations) == len(before.rotations)
    assert nearest_angle(R @ before.rotations @ R.T, after.rotations).max() < np.radians(1)
    assert np.allclose(np.abs(np.sum(after.axes * (before.axes @ R.T), axis=1)), 1, atol=1e-3)
    assert np.allclose(after.center, R @ before.center + pose[:3, 3])


def test_axis_is_the_axis():
    _, pose = turned("bottle")
    assert abs(group_of("bottle").axes[0] @ pose[:3, 2]) > np.cos(np.radians(0.5))


def test_same_mesh_same_group():
    again = rotation_group(turned("L bracket")[0])
    assert np.array_equal(again.rotations, group_of("L bracket").rotations)


@pytest.mark.parametrize("name", ["square prism", "tetrahedron", "L bracket", "cylinder", "bottle"])
def test_error_is_zero_for_what_looks_the_same(name):
    group = group_of(name)
    R_gt, R_camera_object = so3.sample_uniform(np.random.default_rng(1), 2)
    for g in members(group):
        R_est = R_gt @ R_camera_object @ g @ R_camera_object.T
        assert symmetric_error(group, R_est, R_gt, R_camera_object) < 1e-6
    # The same turn in other axes, or on the other side, is another one.
    g = members(group)[-1]
    for wrong in (R_gt @ g, g @ R_gt, R_camera_object @ g @ R_camera_object.T @ R_gt):
        assert symmetric_error(group, wrong, R_gt, R_camera_object) > 0.1


@pytest.mark.parametrize("name", ["square prism", "tetrahedron", "cylinder", "bottle"])
def test_error_is_the_least_over_the_group(name):
    group = group_of(name)
    rng = np.random.default_rng(2)
    for R_est, R_gt, R_camera_object in so3.sample_uniform(rng, 15).reshape(5, 3, 3, 3):
        R = group.rotations
        if len(group.axes):
            spins = so3.exp(group.axes[0] * np.linspace(0, 2 * np.pi, 2000)[:, None])
            R = (R[:, None] @ spins).reshape(-1, 3, 3)
        least = so3.angle_difference(R_est @ R_camera_object, R_gt @ R_camera_object @ R).min()
        assert np.isclose(symmetric_error(group, R_est, R_gt, R_camera_object), least, atol=1e-5)


def test_error_of_a_shape_without_symmetry_is_the_angle():
    R_est, R_gt, R_camera_object = so3.sample_uniform(np.random.default_rng(3), 3)
    error = symmetric_error(group_of("irregular bracket"), R_est, R_gt, R_camera_object)
    assert np.isclose(error, so3.angle_difference(R_est, R_gt))


def test_tilting_a_cylinder_counts_and_spinning_it_does_not():
    group = group_of("cylinder")
    axis = group.axes[0]
    R_gt, R_camera_object = so3.sample_uniform(np.random.default_rng(4), 2)
    tilt = so3.exp(0.3 * np.cross(axis, so3.sample_axes(np.random.default_rng(5), 1)[0]))
    expected = so3.angle(tilt)
    for spin in so3.exp(axis * np.linspace(0, 6, 4)[:, None]):
        R_est = R_gt @ R_camera_object @ tilt @ spin @ R_camera_object.T
        assert np.isclose(symmetric_error(group, R_est, R_gt, R_camera_object), expected)


@pytest.mark.parametrize("name", ["cylinder", "cube", "bottle", "box", "L bracket"])
def test_filter_rejects_the_symmetric(name):
    assert not passes_paper_filter(turned(name)[0])


def test_filter_accepts_the_irregular_whole_or_open():
    mesh, _ = turned("irregular bracket")
    assert passes_paper_filter(mesh)
    assert passes_paper_filter(part_of(mesh.copy(), lambda m: np.arange(len(m.faces)) % 3 > 0))


def test_the_two_tests_of_the_filter_see_different_things():
    assert has_trimesh_axis(turned("bottle")[0])
    assert not has_trimesh_axis(turned("L bracket")[0])  # three moments of inertia, and yet it can be turned over
    assert has_symmetric_stable_pose(turned("L bracket")[0])


def test_box_rests_on_its_faces_and_a_sheet_on_either_side():
    poses = stable_poses(trimesh.creation.box((1, 2, 3)))
    assert len(poses) == 6
    assert all(so3.is_rotation(R) for R in poses)
    assert abs(poses[0][2, 0]) == pytest.approx(1)  # the widest footing is across x, which then points up or down
    assert len(stable_poses(turned("sheet")[0])) == 2


def test_stable_poses_are_those_of_trimesh():
    mesh, _ = turned("irregular bracket")
    theirs, _ = trimesh.poses.compute_stable_poses(mesh.convex_hull, center_mass=mesh.convex_hull.center_mass, seed=0)
    ours = stable_poses(mesh)  # the bracket's parts overlap, so it is as heavy as its hull
    assert len(ours) == len(theirs)
    assert nearest_angle(ours, theirs[:, :3, :3]).max() < 0.01


def test_open_and_flat_meshes_do_not_crash_or_warn():
    triangle = trimesh.Trimesh([[0, 0, 0], [3, 0, 0], [0.4, 1, 0]], [[0, 1, 2]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for mesh in (turned("sheet")[0], turned("open bowl")[0], turned("box without a side")[0], triangle):
            assert isinstance(passes_paper_filter(mesh), bool)
            assert np.isfinite(rotation_group(mesh).residual)


def test_what_is_no_surface_is_refused():
    with pytest.raises(ReorientError, match="no area"):
        rotation_group(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False))
    with pytest.raises(ReorientError, match="no faces"):
        passes_paper_filter(trimesh.Trimesh())
