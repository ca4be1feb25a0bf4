"""The surface of a mesh as a point cloud, and how far a rotation takes the surface from itself.

Lengths are divided by the RMS radius, the RMS distance of the surface from its centroid, so they have no unit. A mesh
may be open, flat or in separate parts: only its surface is used.
"""

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from reorient import so3

_VOXELS = 48  # of the distance field along each axis

Rotations = Float[np.ndarray, "_ 3 3"]


def _sample(mesh: trimesh.Trimesh, n: int, seed: int) -> tuple[Float[np.ndarray, "{n} 3"], Int[np.ndarray, " {n}"]]:
    """n points on the surface, one in each n-th of the area, and the indices of their faces."""
    rng = np.random.default_rng(seed)
    cumulative = np.cumsum(mesh.area_faces)
    face = np.searchsorted(cumulative, (np.arange(n) + rng.uniform(0, 1, n)) / n * cumulative[-1])
    face = np.minimum(face, len(cumulative) - 1)
    uv = rng.uniform(0, 1, (n, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)
    corner = mesh.triangles[face]
    return corner[:, 0] + uv[:, :1] * (corner[:, 1] - corner[:, 0]) + uv[:, 1:] * (corner[:, 2] - corner[:, 0]), face


class SurfaceCloud:
    """A surface as a cloud of reference points and a set of probes, about its centroid, over the RMS radius.

    All methods take rotations of the surface about that centroid. The distance of a rotation is the distance of the
    rotated probes from the cloud. ``principal``: the axes of the surface's second moments as rows, the shortest extent
    first.
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
        # Two samples of one surface do not coincide: the distance of the identity is subtracted from every distance.
        self.floor, self.coarse_floor = 0.0, 0.0
        self.floor = float(self.residuals(np.eye(3)[None])[0])

        self.half = (
            1.02 * np.linalg.norm(corners, axis=2).max() / radius
        )  # of a box that holds the mesh at every rotation
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
        return np.asarray((i * _VOXELS + j) * _VOXELS + k)

    def coarse(self, R: Rotations) -> Float[np.ndarray, " _"]:
        """``residuals`` to about one voxel, in microseconds per rotation."""
        probes = self.probes[::4]
        x = np.swapaxes((probes @ R.reshape(-1, 3).T).reshape(len(probes), -1, 3), 0, 1)
        rank = int(0.95 * len(probes))
        return np.asarray(np.partition(self.field[self._voxel(x)], rank, axis=1)[:, rank] - self.coarse_floor)

    def distances(self, R: Rotations) -> Float[np.ndarray, "_ m"]:
        """Distance of each rotated probe from the cloud."""
        x = np.einsum("nij,mj->nmi", R, self.probes)
        return np.asarray(self.tree.query(x.reshape(-1, 3))[0].reshape(len(R), -1))

    def residuals(self, R: Rotations) -> Float[np.ndarray, " _"]:
        """95th-percentile distance of the rotated surface from the surface."""
        return np.asarray(np.quantile(self.distances(R), 0.95, axis=1) - self.floor)

    def refine(self, R: Rotations, steps: int, exact: bool, least_rad: float = 0.0) -> Rotations:
        """Gauss-Newton to the nearest minimum of the distance, among rotations of at least ``least_rad``.

        Coarse: the sum of fourth powers, whose minimum is near that of the 95th percentile. Exact: the sum of squares,
        whose minimum is a true symmetry to a fraction of a degree.
        """
        probes = self.probes[::4]
        for _ in range(steps):
            x = np.einsum("nij,mj->nmi", R, probes)
            flat = x.reshape(-1, 3)
            nearest = self.tree.query(flat)[1] if exact else self.nearest[self._voxel(flat)]
            off = x - self.cloud[nearest].reshape(x.shape)
            normal = self.normals[nearest].reshape(x.shape)
            length = np.linalg.norm(off, axis=2, keepdims=True)
            # Between samples of one face only the component along the normal is distance.
            direction = np.where(length < 2 * self.floor, normal, off / np.maximum(length, 1e-12))
            distance = np.sum(direction * off, axis=2)
            worst = np.quantile(np.abs(distance), 0.95, axis=1, keepdims=True)
            weight = (np.abs(distance) <= worst) * (1.0 if exact else (distance / np.maximum(worst, 1e-12)) ** 2)
            lever = np.cross(x, direction)
            A = np.swapaxes(lever * weight[..., None], 1, 2) @ lever
            b = np.einsum("nm,nmi->ni", weight * distance, lever)
            # A surface of revolution leaves one rotation undetermined, which damping keeps unchanged.
            A += (1e-2 * np.trace(A, axis1=1, axis2=2)[:, None, None] + 1e-9) * np.eye(3)
            step = -np.linalg.solve(A, b[..., None])[..., 0]
            step *= np.minimum(1, 0.2 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
            R = so3.exp(step) @ R
            if least_rad > 0:
                R = _at_least(R, least_rad)
        return R


def _at_least(R: Rotations, angle_rad: float) -> Rotations:
    """The rotations, those of a smaller angle extended to it about their own axis."""
    rotvec = so3.log(R)
    angle = np.linalg.norm(rotvec, axis=1, keepdims=True)
    return np.where((angle < angle_rad)[..., None], so3.exp(rotvec * (angle_rad / np.maximum(angle, 1e-9))), R)
