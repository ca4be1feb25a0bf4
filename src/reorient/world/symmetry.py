"""Symmetry: the rotations that map a mesh to itself, and the rotation error modulo these rotations.

Lengths are divided by the RMS radius, the RMS distance of the surface from its centroid, so they have no unit. A mesh
may be open, flat or in separate parts: only its surface is used.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from reorient import so3
from reorient.world.meshes import check_surface
from reorient.world.surface_cloud import Rotations, SurfaceCloud

SYMMETRIC_BELOW = 0.05  # of the RMS radius
SMALLEST_RAD = np.radians(25)  # smaller rotations come near the identity for any mesh
_SAME_RAD = np.radians(8)  # two refined candidates within this angle are the same element
_LARGEST_GROUP = 60  # the icosahedral group; a finer prism is a solid of revolution within the tolerance
_SPINS_RAD = 2 * np.pi * (np.arange(1, 13) * (np.sqrt(5) - 1) / 2 % 1)  # no multiples of a rotation of a prism


@dataclass(frozen=True, eq=False)
class SymmetryGroup:
    """The rotations ``x -> g (x - center) + center`` that map a mesh to itself, in the mesh's own coordinates.

    With no axis the group is ``rotations``, closed under product and inverse. With an axis it is every
    ``rotations[i] @ spin`` with a spin about the axis; ``rotations`` is then the identity and, if the two ends are
    equal, a rotation by 180 degrees that swaps them. ``spherical`` means every rotation.
    """

    rotations: Float[np.ndarray, "n 3 3"]
    axes: Float[np.ndarray, "k 3"]
    spherical: bool
    center: Float[np.ndarray, "3"]
    residual: float
    """Least distance of a rotation of at least 25 degrees: 95th percentile over the RMS radius, at least 0.

    Below the tolerance the mesh is called symmetric. The group of a nearly round mesh can still be trivial.
    """


def rotation_group(mesh: trimesh.Trimesh, tolerance: float = SYMMETRIC_BELOW) -> SymmetryGroup:
    """The rotations about the surface's centroid (weighted by area) that map a mesh to itself within the tolerance.

    The distance of a rotation is the 95th percentile over 500 points of the rotated surface of the distance to 20,000
    points of the surface, minus that of the identity, over the RMS radius. Details smaller than the spacing of these
    points have no effect. Deterministic. Raises ReorientError for a mesh that is no surface.
    """
    surface = SurfaceCloud(check_surface(mesh))
    everywhere = so3.grid(40)
    if surface.coarse(everywhere).max() <= 3 * tolerance and surface.residuals(everywhere).max() <= tolerance:
        residual = max(0.0, float(surface.residuals(everywhere).min()))
        return SymmetryGroup(np.eye(3)[None], np.zeros((0, 3)), True, surface.center, residual)

    found, residuals = _candidates(surface, tolerance)
    best = residuals.min()
    found = found[residuals <= tolerance]
    axis = _axis_of_revolution(surface, found, tolerance) if len(found) else None
    if axis is None:
        group, axes = _finite_group(surface, found, tolerance), np.zeros((0, 3))
    else:
        sideways = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        flip = so3.exp(np.pi * sideways / np.linalg.norm(sideways))
        flips = surface.residuals(so3.exp(axis * _SPINS_RAD[:, None]) @ flip)
        group = np.stack([np.eye(3), flip] if flips.max() <= tolerance else [np.eye(3)])
        axes = axis[None]
    return SymmetryGroup(group, axes, False, surface.center, max(0.0, float(best)))


def mirror_residual(mesh: trimesh.Trimesh) -> float:
    """The least distance of the mirrored surface, rotated about the centroid, from the surface, as for a symmetry.

    Below ``SYMMETRIC_BELOW`` the mirrored object is the same object in another pose. Raises ReorientError for a mesh
    that is no surface.
    """
    surface = SurfaceCloud(check_surface(mesh))
    mirrored = so3.grid(4000) @ np.diag([-1.0, 1.0, 1.0])
    starts = np.concatenate([np.eye(3) - 2 * surface.principal[:, :, None] * surface.principal[:, None], mirrored])
    best = starts[np.argsort(surface.coarse(starts))[:48]]
    return max(0.0, float(surface.residuals(surface.refine(best, steps=8, exact=False)).min()))


def _candidates(surface: SurfaceCloud, tolerance: float) -> tuple[Rotations, Float[np.ndarray, " _"]]:
    """Rotations at local minima of the distance among those of at least 25 degrees, best first; their distances."""
    grid = so3.grid(4000)
    grid = grid[so3.angle(grid) > SMALLEST_RAD]
    grid = grid[np.argsort(surface.coarse(grid))]
    starts = _distinct(grid, np.radians(15), most=48)
    # Unless two moments are equal, an exact symmetry is a rotation by 180 degrees about a principal axis.
    starts = np.concatenate([so3.exp(np.pi * surface.principal), starts])
    R = np.concatenate([starts, surface.refine(starts, steps=8, exact=False, least_rad=SMALLEST_RAD)])
    R = R[np.argsort(surface.coarse(R))[:24]]
    residuals = surface.residuals(R)
    top = np.argsort(residuals)[: max(4, int(np.sum(residuals <= 2 * tolerance)))]
    finer = surface.refine(R[top], steps=4, exact=True, least_rad=SMALLEST_RAD)
    R, residuals = np.concatenate([R, finer]), np.concatenate([residuals, surface.residuals(finer)])
    order = np.argsort(residuals)
    return R[order], residuals[order]


def _axis_of_revolution(surface: SurfaceCloud, found: Rotations, tolerance: float) -> Float[np.ndarray, "3"] | None:
    """The unit axis about which every rotation maps the surface to itself, if there is one."""
    rotvecs = so3.log(found)
    axes = np.concatenate([surface.principal, rotvecs / np.linalg.norm(rotvecs, axis=1, keepdims=True)])
    best, best_residual = None, tolerance
    near = np.abs(axes @ axes.T) > np.cos(_SAME_RAD)
    first = ~np.any(np.tril(near, -1), axis=1)  # of each cluster of axes, the best
    for axis in axes[first][:12]:
        if surface.coarse(so3.exp(axis * _SPINS_RAD[:, None])).max() > 3 * tolerance:
            continue
        for _ in range(2):
            spins = so3.exp(axis * _SPINS_RAD[:, None])
            worst = float(surface.residuals(spins).max())
            if worst <= best_residual:
                best, best_residual = axis, worst
            # Refined one by one, the spins stay about one axis; the mean of their axes is better than the first one.
            skew = so3.log(surface.refine(spins, steps=2, exact=True))
            axis = np.linalg.eigh(skew.T @ skew)[1][:, -1]
    return best


def _finite_group(surface: SurfaceCloud, found: Rotations, tolerance: float) -> Rotations:
    """A closed set of rotations within the tolerance, extended by one found rotation after another where possible.

    A nearly round mesh (a bottle with a small spout) has rotations within the tolerance that are no symmetry. They are
    recognised by a distance that decreases when the angle decreases.
    """
    group = np.eye(3)[None]
    if len(found) == 0:
        return group
    found = _distinct(found, _SAME_RAD, most=10)
    rotvec = so3.log(found)
    less = so3.exp(rotvec * (1 - _SAME_RAD / np.linalg.norm(rotvec, axis=1, keepdims=True)))
    for R in found[surface.residuals(less) > surface.residuals(found)]:
        if len(_new(R[None], group)):
            larger = _generated(surface, np.concatenate([group, R[None]]), tolerance)
            group = group if larger is None else larger
    return group


def _generated(surface: SurfaceCloud, R: Rotations, tolerance: float) -> Rotations | None:
    """The group that rotations generate, the identity first; None if it leaves the tolerance or is too large."""
    while len(new := _new((R[:, None] @ R).reshape(-1, 3, 3), R)):
        # Each product is refined before it is multiplied again, or errors would add up along the products.
        new = _new(surface.refine(new, steps=3, exact=True), R)
        if len(new) == 0:
            break
        if len(R) + len(new) > _LARGEST_GROUP or surface.residuals(new).max() > tolerance:
            return None
        R = np.concatenate([R, new])
    n = len(R)
    table = _traces((R[:, None] @ R).reshape(-1, 3, 3), R).argmax(axis=1).reshape(n, n)
    every = np.arange(n)
    if np.any(np.sort(table, axis=0) != every[:, None]) or np.any(np.sort(table, axis=1) != every):
        return None
    for _ in range(4):  # the mean of R_ij R_j^T over j is nearer a homomorphism than R_i, quadratically
        R = np.stack([so3.mean(R[table[i]] @ np.swapaxes(R, 1, 2)) for i in every])
    return R if surface.residuals(R).max() <= tolerance else None


def _distinct(R: Rotations, radius_rad: float, most: int) -> Float[np.ndarray, "k 3 3"]:
    """The first of the rotations that are farther than the radius from all kept before."""
    return np.asarray(R[so3.non_maximum_suppression(R, -np.arange(float(len(R))), radius_rad, most)])


def _new(R: Rotations, known: Rotations) -> Rotations:
    """The rotations that are none of the known elements, each once."""
    return _distinct(R[_traces(R, known).max(axis=1) < 1 + 2 * np.cos(_SAME_RAD)], _SAME_RAD, _LARGEST_GROUP)


def _traces(R0: Float[np.ndarray, "n 3 3"], R1: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "n m"]:
    """trace(R0^T R1) of every pair, 1 + 2 cos of the angle between them."""
    return np.asarray(R0.reshape(-1, 9) @ R1.reshape(-1, 9).T)


def nearest_equivalent(
    group: SymmetryGroup,
    R_est: Float[np.ndarray, "3 3"],
    R_gt: Float[np.ndarray, "3 3"],
    R_camera_object: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "3 3"] | None:
    """Of the rotations that are equivalent to the true one, the nearest to the estimated one; None where they are a
    continuum. The arguments are those of ``symmetric_error``."""
    if group.spherical or len(group.axes):
        return None
    true = R_gt @ R_camera_object @ group.rotations @ R_camera_object.T
    return np.asarray(true[np.argmin(so3.angle_difference(true, R_est))])


def symmetric_error(
    group: SymmetryGroup,
    R_est: Float[np.ndarray, "3 3"],
    R_gt: Float[np.ndarray, "3 3"],
    R_camera_object: Float[np.ndarray, "3 3"],
) -> float:
    """Angle in [0, pi], radians, between the estimated goal orientation and the nearest equivalent of the true one.

    ``R_est`` and ``R_gt`` take the current orientation to the goal's by left multiplication, in camera axes;
    ``R_camera_object`` is the current orientation. The least over g in the group of the angle between
    ``R_est @ R_camera_object`` and ``R_gt @ R_camera_object @ g``; about an axis of revolution, the angle between the
    images of the axis.
    """
    if group.spherical:
        return 0.0
    estimated, true = R_est @ R_camera_object, R_gt @ R_camera_object @ group.rotations
    if len(group.axes) == 0:
        return float(so3.angle_difference(true, estimated).min())
    a, b = estimated @ group.axes[0], true @ group.axes[0]
    return float(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), b @ a).min())
