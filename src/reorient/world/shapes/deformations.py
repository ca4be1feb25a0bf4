"""Random deformations of a solid and details on its surface."""

import numpy as np
from manifold3d import Manifold
from numpy.random import Generator

from reorient import so3
from reorient.world.shapes.solids import box, extents, fit, limb, primitive, rod, tilt


def lumpy(rng: Generator, solid: Manifold, strength: float, waves: int = 8, edge: float = 0.1) -> Manifold:
    """A smooth random warp.

    ``strength``: about the largest strain (above 1 the surface would fold); ``edge``: edge length over the size.
    """
    size = float(extents(solid).max())
    wave = so3.sample_axes(rng, waves) * 2 * np.pi / (size * rng.uniform(0.3, 1.5, (waves, 1)))
    shift = so3.sample_axes(rng, waves) * strength / (np.linalg.norm(wave, axis=1, keepdims=True) * np.sqrt(waves))
    phase = rng.uniform(0, 2 * np.pi, waves)
    return solid.refine_to_length(edge * size).warp_batch(lambda x: x + np.sin(x @ wave.T + phase) @ shift)


def bent(rng: Generator, solid: Manifold) -> Manifold:
    """Twisted, tapered and curved along its longest axis."""
    size = extents(solid)
    solid = fit(solid, size)
    axis = int(np.argmax(size))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    twist, taper, curve = rng.normal(0, 0.5), rng.uniform(-0.4, 0.4), rng.normal(0, 0.3)

    def warp(x: np.ndarray) -> np.ndarray:
        s = x[:, axis] / size[axis]
        cos, sin, grow = np.cos(twist * s), np.sin(twist * s), 1 + taper * s
        y = x.copy()
        y[:, a] = grow * (cos * x[:, a] - sin * x[:, b]) + curve * size[axis] * s**2
        y[:, b] = grow * (sin * x[:, a] + cos * x[:, b])
        return y

    return solid.refine_to_length(0.1 * float(size.max())).warp_batch(warp)


def surface_points(rng: Generator, solid: Manifold, n: int) -> tuple[np.ndarray, np.ndarray]:
    """n points uniform on the surface and their outward normals, each (n, 3)."""
    mesh = solid.to_mesh64()
    corners = np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts).astype(np.int64)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    face = rng.choice(len(area), n, p=area / area.sum())
    weight = rng.dirichlet(np.ones(3), n)
    return np.einsum("nk,nkd->nd", weight, corners[face]), normal[face] / area[face, None]


def detailed(rng: Generator, solid: Manifold, n: int) -> Manifold:
    """With n bosses, knobs, pegs, fins, notches or holes of visible size on the surface, which break symmetries."""
    size = float(np.sort(extents(solid))[1:].mean())
    points, normals = surface_points(rng, solid, n)
    for point, normal in zip(points, normals, strict=True):
        r = size * rng.uniform(0.06, 0.16)
        kind = rng.integers(6)
        if kind == 0:
            solid += tilt(primitive(rng, r * rng.uniform(0.8, 2.4, 3)), normal, point)
        elif kind == 1:
            solid += rod(point - normal * r, point + normal * r * rng.uniform(0.8, 3), r * rng.uniform(0.3, 0.8))
        elif kind == 2:
            solid += limb([point, point + normal * r * rng.uniform(1, 2.5)], r * np.array([0.4, rng.uniform(0.5, 1.1)]))
        elif kind == 3:
            solid += tilt(box((r * 0.35, r * 3, r * 2.2)), normal, point)
        elif kind == 4:
            solid -= tilt(primitive(rng, r * rng.uniform(1.2, 2.8, 3)), normal, point)
        else:
            solid -= rod(point + normal * r, point - normal * size, r * rng.uniform(0.6, 1.2))
    return solid


def randomly_rotated(rng: Generator, solid: Manifold) -> Manifold:
    """Rotated by a uniform random rotation."""
    return solid.transform(np.column_stack([so3.sample_uniform(rng, 1)[0], np.zeros(3)]))
