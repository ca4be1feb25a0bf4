"""Groups of solids whose symmetry is in the books, and the error that divides it out."""

import functools
import warnings

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from solids import SHAPES, nearest_angle, posed

from reorient import so3
from reorient.errors import ReorientError
from reorient.world.symmetry import SYMMETRIC_BELOW, rotation_group, symmetric_error


@functools.cache
def group_of(name):
    return rotation_group(posed(name)[0])


def members(group):
    """The rotations of a group, with some of the spins if it has an axis."""
    spins = so3.exp(group.axes[:1] * np.arange(5)[:, None]) if len(group.axes) else np.eye(3)[None]
    return (group.rotations[:, None] @ spins).reshape(-1, 3, 3)


@pytest.mark.parametrize("name", SHAPES)
def test_group_of_a_known_solid(name):
    group = group_of(name)
    assert (len(group.rotations), len(group.axes), group.spherical) == (*SHAPES[name][1:], False)
    assert (group.residual < SYMMETRIC_BELOW) == (name != "irregular bracket")


@pytest.mark.parametrize("name", [n for n, (_, count, _) in SHAPES.items() if count > 1])
def test_rotations_are_a_group_and_map_the_solid_to_itself(name):
    mesh, _ = posed(name)
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
    mesh, _ = posed("irregular bracket")
    cloud, probes = (trimesh.sample.sample_surface(mesh, n, seed=n)[0] - mesh.centroid for n in (10_000, 100))
    axes = so3.sample_axes(np.random.default_rng(0), 600)
    R = np.concatenate(
        [so3.exp(axes * np.radians(25)), so3.exp(axes * np.pi)]
    )  # the distance is least at the smallest angle
    distance = cKDTree(cloud).query(probes @ np.swapaxes(R, 1, 2))[0]
    at_random = np.quantile(distance, 0.95, axis=1).min() / np.sqrt(np.mean(np.sum(cloud**2, axis=1)))
    assert 0.75 * at_random < group_of("irregular bracket").residual < 1.02 * at_random


def test_residual_and_group_do_not_depend_on_size():
    mesh = posed("L bracket")[0].copy().apply_scale(1e-3)
    group = rotation_group(mesh)
    assert np.allclose(group.residual, group_of("L bracket").residual, atol=1e-3)
    assert nearest_angle(group.rotations, group_of("L bracket").rotations).max() < np.radians(0.5)


@pytest.mark.parametrize("name", ["square prism", "L bracket", "bottle"])
def test_turning_the_mesh_conjugates_the_group(name):
    mesh, _ = posed(name)
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
    _, pose = posed("bottle")
    assert abs(group_of("bottle").axes[0] @ pose[:3, 2]) > np.cos(np.radians(0.5))


def test_same_mesh_same_group():
    again = rotation_group(posed("L bracket")[0])
    assert np.array_equal(again.rotations, group_of("L bracket").rotations)


@pytest.mark.parametrize("name", ["square prism", "tetrahedron", "L bracket", "cylinder", "bottle"])
def test_error_is_zero_for_what_looks_the_same(name):
    group = group_of(name)
    R_gt, R_camera_object = so3.sample_uniform(np.random.default_rng(1), 2)
    for g in members(group):
        R_est = R_gt @ R_camera_object @ g @ R_camera_object.T
        assert symmetric_error(group, R_est, R_gt, R_camera_object) < 1e-6
    # The same rotation in other axes, or on the other side, is another one.
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


def test_open_and_flat_meshes_do_not_crash_or_warn():
    triangle = trimesh.Trimesh([[0, 0, 0], [3, 0, 0], [0.4, 1, 0]], [[0, 1, 2]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for mesh in (posed("sheet")[0], posed("open bowl")[0], posed("box without a side")[0], triangle):
            assert np.isfinite(rotation_group(mesh).residual)


def test_what_is_no_surface_is_refused():
    with pytest.raises(ReorientError, match="no area"):
        rotation_group(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False))
    with pytest.raises(ReorientError, match="no faces"):
        rotation_group(trimesh.Trimesh())
