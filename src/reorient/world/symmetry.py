"""Symmetry: which rotations map a mesh to itself, and the error that divides them out.

Lengths are divided by the RMS radius, the RMS distance of the surface from its centroid, so they have no unit. A mesh
may be open, flat or in loose parts: only its surface is used.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from reorient import so3
from reorient.world.meshes import check_surface

SYMMETRIC_BELOW = 0.05  # of the RMS radius
SMALLEST_TURN_RAD = np.radians(25)  # a turn below this comes near the identity for any mesh
_SAME_RAD = np.radians(8)  # two refined candidates this near are one element
_LARGEST_GROUP = 60  # the icosahedron's; a finer prism is a solid of revolution to the tolerance
_VOXELS = 48
_SPINS_RAD = 2 * np.pi * (np.arange(1, 13) * (np.sqrt(5) - 1) / 2 % 1)  # multiples of no turn of a prism

Rotations = Float[np.ndarray, "_ 3 3"]


@dataclass(frozen=True, eq=False)
class SymmetryGroup:
    """The rotations ``x -> g (x - center) + center`` that map a mesh to itself, in the mesh's own coordinates.

    With no axis the group is ``rotations``, closed under product and inverse. With an axis it is every
    ``rotations[i] @ spin`` with a spin about the axis; ``rotations`` is then the identity and, if the two ends look
    alike, a half turn that swaps them. ``spherical`` means every rotation.
    """

    rotations: Float[np.ndarray, "n 3 3"]
    axes: Float[np.ndarray, "k 3"]
    spherical: bool
    center: Float[np.ndarray, "3"]
    residual: float
    """How near the best turn of at least 25 degrees comes: 95th-percentile distance over the RMS radius, at best 0.

    Below the tolerance the mesh is called symmetric. The group can still be trivial, if the mesh is nearly round.
    """


# --- the surface as points ------------------------------------------------------------------------------------------


def _sample(mesh: trimesh.Trimesh, n: int, seed: int) -> tuple[Float[np.ndarray, "{n} 3"], Int[np.ndarray, " {n}"]]:
    """n points on the surface, one in each n-th of the area, and their faces."""
    rng = np.random.default_rng(seed)
    cumulative = np.cumsum(mesh.area_faces)
    face = np.searchsorted(cumulative, (np.arange(n) + rng.uniform(0, 1, n)) / n * cumulative[-1])
    face = np.minimum(face, len(cumulative) - 1)
    uv = rng.uniform(0, 1, (n, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)
    corner = mesh.triangles[face]
    return corner[:, 0] + uv[:, :1] * (corner[:, 1] - corner[:, 0]) + uv[:, 1:] * (corner[:, 2] - corner[:, 0]), face


class Surface:
    """A mesh as a cloud to measure against and probes to turn, centred on its centroid, in RMS radii.

    Rotations, as all of its methods take them, turn the mesh about that centroid. ``principal`` has the axes of the
    surface's second moments as rows, the shortest extent first.
    """

    def __init__(self, mesh: trimesh.Trimesh, n_cloud: int = 20_000, n_probes: int = 500) -> None:
        weight = mesh.area_faces / mesh.area_faces.sum()
        self.center: np.ndarray = weight @ mesh.triangles_center
        corners = mesh.triangles - self.center
        middles = corners.mean(axis=1)
        moment = np.einsum("f,fki,fkj->ij", weight, corners, corners) + 9 * (middles.T * weight) @ middles
        self.principal = np.linalg.eigh(moment)[1].T
        radius = np.sqrt(np.trace(moment) / 12)

        cloud, face = _sample(mesh, n_cloud, seed=0)
        self.cloud = (cloud - self.center) / radius
        self.probes = (_sample(mesh, n_probes, seed=1)[0] - self.center) / radius
        normals = np.cross(corners[face, 1] - corners[face, 0], corners[face, 2] - corners[face, 0])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        self.tree = cKDTree(self.cloud)
        # Two clouds of one surface do not coincide: what the identity scores is the zero of every distance.
        self.floor, self.coarse_floor = 0.0, 0.0
        self.floor = float(self.residuals(np.eye(3)[None])[0])

        self.half = 1.02 * np.linalg.norm(corners, axis=2).max() / radius  # of a box that holds every turn of the mesh
        shape = (_VOXELS,) * 3
        index = np.zeros(_VOXELS**3, np.int64)
        empty = np.ones(_VOXELS**3, bool)
        voxel = self._voxel(self.cloud)
        index[voxel], empty[voxel] = np.arange(n_cloud), False
        distance, source = distance_transform_edt(empty.reshape(shape), return_indices=True)
        self.field = (distance * (2 * self.half / _VOXELS)).astype(np.float32).ravel()
        self.nearest = index[np.ravel_multi_index(tuple(source.reshape(3, -1)), shape)]
        self.coarse_floor = float(self.coarse(np.eye(3)[None])[0])

    def _voxel(self, x: np.ndarray) -> np.ndarray:
        i, j, k = np.moveaxis(((x + self.half) * (_VOXELS / (2 * self.half))).astype(np.int32), -1, 0)
        return (i * _VOXELS + j) * _VOXELS + k

    def coarse(self, R: Rotations) -> Float[np.ndarray, " _"]:
        """The residuals to about a voxel, in microseconds a rotation."""
        probes = self.probes[::4]
        x = np.swapaxes((probes @ R.reshape(-1, 3).T).reshape(len(probes), -1, 3), 0, 1)
        rank = int(0.95 * len(probes))
        return np.partition(self.field[self._voxel(x)], rank, axis=1)[:, rank] - self.coarse_floor

    def distances(self, R: Rotations) -> Float[np.ndarray, "_ m"]:
        """Distance of each turned probe from the cloud."""
        x = np.einsum("nij,mj->nmi", R, self.probes)
        return self.tree.query(x.reshape(-1, 3))[0].reshape(len(R), -1)

    def residuals(self, R: Rotations) -> Float[np.ndarray, " _"]:
        """95th-percentile distance of the turned mesh from the mesh."""
        return np.quantile(self.distances(R), 0.95, axis=1) - self.floor

    def refine(self, R: Rotations, steps: int, exact: bool, least_turn_rad: float = 0.0) -> Rotations:
        """Gauss-Newton towards the nearest least distance, among turns of at least ``least_turn_rad``.

        While coarse the fourth powers are summed, which tends to the least 95th percentile; when exact the squares,
        which find a true symmetry to a fraction of a degree.
        """
        probes = self.probes[::4]
        for _ in range(steps):
            x = np.einsum("nij,mj->nmi", R, probes)
            flat = x.reshape(-1, 3)
            nearest = self.tree.query(flat)[1] if exact else self.nearest[self._voxel(flat)]
            off = x - self.cloud[nearest].reshape(x.shape)
            normal = self.normals[nearest].reshape(x.shape)
            length = np.linalg.norm(off, axis=2, keepdims=True)
            # Between samples of one face only the part along the normal is distance.
            direction = np.where(length < 2 * self.floor, normal, off / np.maximum(length, 1e-12))
            distance = np.sum(direction * off, axis=2)
            worst = np.quantile(np.abs(distance), 0.95, axis=1, keepdims=True)
            weight = (np.abs(distance) <= worst) * (1.0 if exact else (distance / np.maximum(worst, 1e-12)) ** 2)
            lever = np.cross(x, direction)
            A = np.swapaxes(lever * weight[..., None], 1, 2) @ lever
            b = np.einsum("nm,nmi->ni", weight * distance, lever)
            # A surface of revolution leaves one turn free: damping keeps it where it is.
            A += (1e-2 * np.trace(A, axis1=1, axis2=2)[:, None, None] + 1e-9) * np.eye(3)
            turn = -np.linalg.solve(A, b[..., None])[..., 0]
            turn *= np.minimum(1, 0.2 / np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-12))
            R = so3.exp(turn) @ R
            if least_turn_rad > 0:
                R = _at_least(R, least_turn_rad)
        return R


def _at_least(R: Rotations, angle_rad: float) -> Rotations:
    """The rotations, those of a smaller angle turned on about their own axis."""
    rotvec = so3.log(R)
    angle = np.linalg.norm(rotvec, axis=1, keepdims=True)
    return np.where((angle < angle_rad)[..., None], so3.exp(rotvec * (angle_rad / np.maximum(angle, 1e-9))), R)


def _traces(R0: Float[np.ndarray, "n 3 3"], R1: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "n m"]:
    """trace(R0^T R1) of every pair, 1 + 2 cos of the angle between them."""
    return R0.reshape(-1, 9) @ R1.reshape(-1, 9).T


def _distinct(R: Rotations, radius_rad: float, most: int) -> Float[np.ndarray, "k 3 3"]:
    """The first of the rotations that are further than the radius from all chosen before."""
    free = np.ones(len(R), bool)
    chosen: list[int] = []
    while free.any() and len(chosen) < most:
        chosen.append(int(np.argmax(free)))
        free &= _traces(R, R[chosen[-1:]])[:, 0] < 1 + 2 * np.cos(radius_rad)
        free[chosen[-1]] = False
    return R[chosen]


def _new(R: Rotations, known: Rotations) -> Rotations:
    """Those of the rotations that are none of the known, once each."""
    return _distinct(R[_traces(R, known).max(axis=1) < 1 + 2 * np.cos(_SAME_RAD)], _SAME_RAD, _LARGEST_GROUP)


# --- the group ------------------------------------------------------------------------------------------------------


def rotation_group(mesh: trimesh.Trimesh, tolerance: float = SYMMETRIC_BELOW) -> SymmetryGroup:
    """The rotations about the surface's centroid (weighted by area) that map a mesh to itself within the tolerance.

    The distance of a rotation is the 95th percentile over 500 points of the turned surface of the distance to 20,000
    points of the surface, less the same for the identity, over the RMS radius: details smaller than the spacing of
    such points do not count. Deterministic. Raises ReorientError for what is no surface.
    """
    surface = Surface(check_surface(mesh))
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
        half_turn = so3.exp(np.pi * sideways / np.linalg.norm(sideways))
        flips = surface.residuals(so3.exp(axis * _SPINS_RAD[:, None]) @ half_turn)
        group = np.stack([np.eye(3), half_turn] if flips.max() <= tolerance else [np.eye(3)])
        axes = axis[None]
    return SymmetryGroup(group, axes, False, surface.center, max(0.0, float(best)))


def _candidates(surface: Surface, tolerance: float) -> tuple[Rotations, Float[np.ndarray, " _"]]:
    """The least distances over turns of at least 25 degrees, best first, and what they are."""
    grid = so3.grid(4000)
    grid = grid[so3.angle(grid) > SMALLEST_TURN_RAD]
    starts = _distinct(grid[np.argsort(surface.coarse(grid))], np.radians(15), most=48)
    # Unless two moments are equal, an exact symmetry is a half turn about a principal axis.
    starts = np.concatenate([so3.exp(np.pi * surface.principal), starts])
    R = np.concatenate([starts, surface.refine(starts, steps=8, exact=False, least_turn_rad=SMALLEST_TURN_RAD)])
    R = R[np.argsort(surface.coarse(R))[:24]]
    residuals = surface.residuals(R)
    top = np.argsort(residuals)[: max(4, int(np.sum(residuals <= 2 * tolerance)))]
    finer = surface.refine(R[top], steps=4, exact=True, least_turn_rad=SMALLEST_TURN_RAD)
    R, residuals = np.concatenate([R, finer]), np.concatenate([residuals, surface.residuals(finer)])
    order = np.argsort(residuals)
    return R[order], residuals[order]


def _axis_of_revolution(surface: Surface, found: Rotations, tolerance: float) -> Float[np.ndarray, "3"] | None:
    """The unit axis about which every turn maps the surface to itself, if there is one."""
    rotvecs = so3.log(found)
    axes = np.concatenate([surface.principal, rotvecs / np.linalg.norm(rotvecs, axis=1, keepdims=True)])
    best, best_residual = None, tolerance
    near = np.abs(axes @ axes.T) > np.cos(_SAME_RAD)
    first = ~np.any(np.tril(near, -1), axis=1)  # of each bundle of like axes, its best
    for axis in axes[first][:12]:
        if surface.coarse(so3.exp(axis * _SPINS_RAD[:, None])).max() > 3 * tolerance:
            continue
        for _ in range(2):
            spins = so3.exp(axis * _SPINS_RAD[:, None])
            worst = float(surface.residuals(spins).max())
            if worst <= best_residual:
                best, best_residual = axis, worst
            # Refined apart, the spins stay about one axis: the mean of theirs is better than the one they began with.
            skew = so3.log(surface.refine(spins, steps=2, exact=True))
            axis = np.linalg.eigh(skew.T @ skew)[1][:, -1]
    return best


def _finite_group(surface: Surface, found: Rotations, tolerance: float) -> Rotations:
    """A closed set of rotations within the tolerance, grown by one found rotation after another where that works.

    Nearly round things (a bottle with a small spout) have turns within the tolerance that are no symmetry, only near
    the identity; they give themselves away by coming nearer still when turned less.
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


def _generated(surface: Surface, R: Rotations, tolerance: float) -> Rotations | None:
    """The group that rotations generate, the identity first; None where none is within the tolerance."""
    while len(new := _new((R[:, None] @ R).reshape(-1, 3, 3), R)):
        # Each is put on its own symmetry before it is multiplied on, or errors would add up along the products.
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


def symmetric_error(
    group: SymmetryGroup,
    R_est: Float[np.ndarray, "3 3"],
    R_gt: Float[np.ndarray, "3 3"],
    R_camera_object: Float[np.ndarray, "3 3"],
) -> float:
    """Angle in radians, in [0, pi], from the estimated goal orientation to the nearest that looks like the true one.

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
