"""Depth of a mesh in a pose, by ray casting (Embree): no GPU, no OpenGL, no display.

One scene per object, built once; to pose the object the rays are turned instead. Directions have z = 1, so Embree's
distance along a ray *is* the depth. Both sides of a triangle are seen. Worlds say how large the object is and where.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from reorient.errors import unknown_name
from reorient.imaging import Camera
from reorient.world.meshes import bounding_radius, center

_HULL_ABOVE = 200  # meshes with more vertices are framed by those of their convex hull
_SLOPES = np.tan(np.pi * (np.arange(12) - 5.5) / 12)  # of 12 pairs of lines around a silhouette, none of them level
_MARGIN_PX = 0.1  # far more than rays in single precision err by


@dataclass(frozen=True)
class Placement:
    """Size and place of an object before a camera; the object turns about its own origin, which lies there."""

    scale_m: float
    """Metres per unit of the mesh."""
    center_m: Float[np.ndarray, "3"]
    """The object's origin in camera axes."""

    def nominal_pivot_m(self, rng: Generator) -> Float[np.ndarray, "3"]:
        """What a robot knows of the centre it turns the object about: up to 1 cm wrong along each axis."""
        return self.center_m + rng.uniform(-0.01, 0.01, 3)


@dataclass(frozen=True)
class World:
    """p(object before the camera): which camera, how large the object, where its origin. Start and goal share it."""

    camera: Camera
    """The camera of both images."""
    radius_m: float | None
    """Radius of the bounding sphere; None: sized by ``diagonal_m``."""
    diagonal_m: tuple[float, float]
    """Range of the bounding box's diagonal, where ``radius_m`` is None."""
    distance_m: tuple[float, float]
    """Range of the origin's depth."""
    shift_m: float
    """Largest shift of the origin along camera x and y, either way."""
    quantum_m: float = 2.0 / 65535
    """Depth step of the 16-bit image (paper, "Simulator")."""

    def place(self, rng: Generator, mesh: trimesh.Trimesh) -> Placement:
        """Draw the size and the place of a centred mesh."""
        if self.radius_m is not None:
            scale_m = self.radius_m / bounding_radius(mesh)
        else:
            scale_m = rng.uniform(*self.diagonal_m) / float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        x, y = rng.uniform(-self.shift_m, self.shift_m, 2)
        return Placement(scale_m, np.array([x, y, rng.uniform(*self.distance_m)]))


WORLDS = {
    # the release's simulator: facts that the paper leaves out
    "paper": World(Camera(128, 128, 300.0, 300.0, 64.0, 64.0), None, (0.20, 0.25), (0.57, 0.62), 0.01),
    "benchmark": World(Camera(128, 128, 331.0, 331.0, 64.0, 64.0), 0.1, (0.0, 0.0), (0.59, 0.61), 0.01),
}


def load_world(name: str) -> World:
    """A preset by name. Raises ReorientError for an unknown one."""
    if name not in WORLDS:
        raise unknown_name("world", name, list(WORLDS))
    return WORLDS[name]


class Renderer:
    """Casts rays at one mesh, centred on its bounding box."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = center(mesh)
        self._scene = EmbreeScene()
        self._triangles = TriangleMesh(self._scene, self.mesh.vertices[self.mesh.faces].astype(np.float32))
        vertices = self.mesh.vertices
        if len(vertices) > _HULL_ABOVE:
            try:
                vertices = self.mesh.convex_hull.vertices
            except Exception:  # flat meshes have no hull: qhull raises its own errors
                vertices = trimesh.bounds.corners(self.mesh.bounds)
        self._outline = np.asarray(vertices, float)

    def depth(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> Float[np.ndarray, "height width"]:
        """Exact depth, float32 metres, 0 where no surface is hit."""
        pixels, origin, directions = self._rays(camera, R_camera_object, placement)
        depth_m = np.zeros((camera.height, camera.width), np.float32)
        if len(pixels):
            distance = self._scene.run(origin, directions, query="DISTANCE")
            distance[distance > 1e30] = 0
            depth_m.reshape(-1)[pixels] = distance * placement.scale_m
        return depth_m

    def depth_and_incidence(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> tuple[Float[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
        """Depth as above, and |cos| of the angle between the ray and the surface normal (0 where nothing is hit)."""
        pixels, origin, directions = self._rays(camera, R_camera_object, placement)
        depth_m = np.zeros((camera.height, camera.width), np.float32)
        cosine = np.zeros_like(depth_m)
        if len(pixels):
            hits = self._scene.run(origin, directions, output=1)
            hit = np.flatnonzero(hits["primID"] >= 0)
            normal, ray = hits["Ng"][hit].T, directions[hit].T
            length = np.linalg.norm(normal, axis=0) * np.linalg.norm(ray, axis=0)
            depth_m.reshape(-1)[pixels[hit]] = hits["tfar"][hit] * placement.scale_m
            cosine.reshape(-1)[pixels[hit]] = np.abs(np.sum(normal * ray, axis=0)) / np.where(length > 0, length, 1)
        return depth_m, cosine

    def faces(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> Int[np.ndarray, "height width"]:
        """Which face of the mesh each pixel's ray hits first; -1 where none."""
        face = np.full((camera.height, camera.width), -1, np.int32)
        pixels, origin, directions = self._rays(camera, R_camera_object, placement)
        if len(pixels):
            face.reshape(-1)[pixels] = self._scene.run(origin, directions, query="INTERSECT")
        return face

    def shadowed(
        self,
        points_m: Float[np.ndarray, "n 3"],
        projector_m: Float[np.ndarray, "3"],
        R_camera_object: Float[np.ndarray, "3 3"],
        placement: Placement,
    ) -> Bool[np.ndarray, " n"]:
        """Which surface points (camera axes) the object itself hides from a projector at ``projector_m``."""
        surface = (points_m - placement.center_m) @ R_camera_object / placement.scale_m
        source = (projector_m - placement.center_m) @ R_camera_object / placement.scale_m
        towards = surface - source  # from the projector: lit if the first hit is the point itself
        origin = np.broadcast_to(source.astype(np.float32), towards.shape)
        distance = self._scene.run(origin, towards.astype(np.float32), query="DISTANCE")
        return distance < 1 - 2e-3

    def _rays(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """The pixels (row by row) that may see the object, and their rays in the mesh's frame and unit."""
        outline_m = placement.scale_m * R_camera_object @ self._outline.T + placement.center_m[:, None]
        first_row, cells = _cells_within(camera, outline_m)
        rows = cells[-1] // camera.width + 1 if len(cells) else 0
        x = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(np.float32)
        y = ((np.arange(first_row, first_row + rows) + 0.5 - camera.cy) / camera.fy).astype(np.float32)
        R = R_camera_object.astype(np.float32)  # its rows are the camera axes in the object's frame
        grid = (np.outer(R[1], y) + R[2][:, None])[:, :, None] + np.outer(R[0], x)[:, None]
        directions = np.take(grid.reshape(3, -1), cells, axis=1).T
        origin = (-placement.center_m @ R_camera_object / placement.scale_m).astype(np.float32)
        return first_row * camera.width + cells, np.broadcast_to(origin, directions.shape), directions


def _cells_within(camera: Camera, outline_m: Float[np.ndarray, "3 n"]) -> tuple[int, Int[np.ndarray, " k"]]:
    """The first image row, and counted from its start the pixels, in a polygon of 26 sides around the outline."""
    x, y, z = outline_m
    if z.min() < 1e-3:  # beside or around the camera: it may be seen anywhere
        return 0, np.arange(camera.height * camera.width)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    top, bottom = np.clip([np.floor(v.min() - _MARGIN_PX), np.ceil(v.max() + _MARGIN_PX)], 0, camera.height).astype(int)
    across = np.multiply.outer(_SLOPES, v) + u  # u of the line through a vertex, in row 0
    margin = _MARGIN_PX * np.sqrt(1 + _SLOPES**2)
    lines = np.multiply.outer(np.arange(top, bottom) + 0.5, _SLOPES)
    left = (across.min(axis=1) - margin - lines).max(axis=1, keepdims=True)
    right = (across.max(axis=1) + margin - lines).min(axis=1, keepdims=True)
    columns = np.arange(camera.width) + 0.5
    return int(top), np.flatnonzero((columns >= left) & (columns <= right))
