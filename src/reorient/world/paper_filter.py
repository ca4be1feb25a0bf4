"""The paper's object filter: trimesh's axes of inertia, and rotations of the stable poses that change nothing.

It selects the objects that the paper would select. ``symmetry.rotation_group`` measures symmetry more accurately.
"""

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import QhullError

from reorient import so3
from reorient.world.meshes import check_surface
from reorient.world.surface_cloud import SurfaceCloud

PAPER_FILTER_BELOW = 0.02  # of the RMS radius; see has_symmetric_stable_pose


def passes_paper_filter(mesh: trimesh.Trimesh) -> bool:
    """Whether a mesh is non-symmetric by both tests of the paper ("Non-Symmetric Object Dataset Experiments").

    Raises ReorientError for a mesh that is no surface.
    """
    return not has_trimesh_axis(mesh) and not has_symmetric_stable_pose(mesh)


def has_trimesh_axis(mesh: trimesh.Trimesh) -> bool:
    """Whether trimesh finds a mesh ``radial`` or ``spherical``: two or three equal principal moments of inertia.

    The moments that trimesh computes for an open mesh depend on the origin, which is moved to its centroid here.
    """
    check_surface(mesh)
    if not mesh.is_volume:
        mesh = trimesh.Trimesh(mesh.vertices - mesh.centroid, mesh.faces, process=False)
    return not _is_flat(mesh) and mesh.symmetry is not None


def _is_flat(mesh: trimesh.Trimesh) -> bool:
    """Whether a mesh encloses no volume, and so has no centre of mass and no inertia."""
    volume = np.linalg.det(mesh.triangles - mesh.centroid).sum() / 6  # mesh.volume divides by it
    return bool(abs(volume) <= 1e-9 * mesh.scale**3)


def has_symmetric_stable_pose(mesh: trimesh.Trimesh, below: float = PAPER_FILTER_BELOW) -> bool:
    """Whether a rotation by 120 or 180 degrees about x, y or z of any stable pose maps the point cloud to itself.

    The clouds are samples of the surface, not renderings, so they do not depend on a camera. The axes pass through the
    centroid, z up and x, y as trimesh chooses them. The distance is the mean distance to the nearest point, minus that
    of two samples of one surface, over the RMS radius. It is below 0.002 for shapes that are symmetric by construction
    and about 0.1 for irregular ones. Of a hundred household objects it rejects 92% of those that ``rotation_group``
    calls symmetric (residual below 0.05) and 2% of the others.
    """
    surface = SurfaceCloud(check_surface(mesh))
    pose = stable_poses(mesh)[:60, None]  # round objects have a thousand
    rotations = so3.exp(np.concatenate([np.eye(3) * np.radians(120), np.eye(3) * np.radians(180)]))
    R = (np.swapaxes(pose, -1, -2) @ rotations @ pose).reshape(-1, 3, 3)
    R = R[np.argsort(surface.coarse(R))[:60]]
    means = surface.distances(R).mean(axis=1) - surface.distances(np.eye(3)[None]).mean()
    return bool(means.min() < below)


def stable_poses(mesh: trimesh.Trimesh) -> Float[np.ndarray, "k 3 3"]:
    """The orientations, from mesh to table axes (z up), in which a mesh rests on a plane, the largest face first.

    It rests on a face of its hull that is under its centre of mass. These are the poses of
    ``trimesh.poses.compute_stable_poses`` with sigma 0, which takes a hundred times as long and does not terminate if
    the centre of mass of an open mesh is outside its hull. For a mesh that encloses no volume the centre of mass of the
    hull is used; a flat mesh rests on either side.
    """
    down = _resting_normals(mesh)
    if len(down) == 0:
        down = np.array([-1, 1])[:, None] * SurfaceCloud(mesh).principal[0]
    z = -down / np.linalg.norm(down, axis=1, keepdims=True)
    x = np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], axis=1)
    x = np.where(np.linalg.norm(x, axis=1, keepdims=True) < 1e-9, [1.0, 0.0, 0.0], x)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _resting_normals(mesh: trimesh.Trimesh) -> Float[np.ndarray, "k 3"]:
    """Outward normals of the hull's faces that are under the centre of mass; none for a flat mesh."""
    try:
        hull = mesh.convex_hull
    except QhullError:
        return np.zeros((0, 3))
    if _is_flat(hull):
        return np.zeros((0, 3))
    center = mesh.center_mass if mesh.is_volume else hull.center_mass
    normal, corner = np.asarray(hull.face_normals), np.asarray(hull.triangles)
    foot = center + np.sum(normal * (corner[:, 0] - center), axis=1, keepdims=True) * normal
    edges = np.roll(corner, -1, axis=1) - corner
    sides = np.einsum("fi,fki->fk", normal, np.cross(edges, foot[:, None] - corner))
    down, face = np.unique(np.round(normal, 3), axis=0, return_inverse=True)
    stable = np.bincount(face, np.all(sides >= -1e-9 * mesh.scale**2, axis=1)) > 0
    return np.asarray(down[stable][np.argsort(-np.bincount(face, hull.area_faces)[stable])])
