"""Solids whose symmetry is in the books, for the tests of symmetry and of the paper's filter."""

import functools

import manifold3d
import numpy as np
import trimesh

from reorient import so3

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
def posed(name):
    """The shape out of line with the axes and away from the origin, and how it got there."""
    mesh = SHAPES[name][0]()
    pose = np.eye(4)
    pose[:3, :3] = so3.sample_uniform(np.random.default_rng(sum(map(ord, name))), 1)[0]
    pose[:3, 3] = [1.0, 2.0, 3.0]
    return mesh.apply_transform(pose), pose


def nearest_angle(R, group):
    """The angle of each rotation from the nearest of the group."""
    return so3.angle_difference(group[:, None], R[None]).min(axis=0)
