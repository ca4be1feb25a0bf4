"""Depth of a mesh at a pose, by ray casting (Embree): no GPU, no OpenGL, no display.

The scene of an object is built once; for a pose the rays are transformed, not the object. Directions have z = 1, so
Embree's distance along a ray *is* the depth. Both sides of a triangle are visible. A world is a distribution of sizes
and positions of the object before the camera.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int
from numpy.random import Generator
from scipy.spatial import QhullError

from reorient.errors import unknown_name
from reorient.imaging import Camera
from reorient.world.in_hand import InHand
from reorient.world.meshes import bounding_radius, center

_HULL_ABOVE = 200  # vertices; the outline of a larger mesh is taken from its convex hull
_SLOPES = np.tan(np.pi * (np.arange(12) - 5.5) / 12)  # of 12 pairs of lines around a silhouette, none horizontal
_MARGIN_PX = 0.1  # far above the error of rays in single precision


@dataclass(frozen=True)
class Placement:
    """Size and position of an object before a camera. The object rotates about its origin."""

    scale_m: float
    """Metres per unit of the mesh."""
    center_m: Float[np.ndarray, "3"]
    """The object's origin, camera axes."""

    def nominal_pivot_m(self, rng: Generator) -> Float[np.ndarray, "3"]:
        """The rotation centre as a robot knows it, camera axes: up to 1 cm off along each axis."""
        return np.asarray(self.center_m + rng.uniform(-0.01, 0.01, 3))


@dataclass(frozen=True)
class World:
    """A camera and the distribution of the object's size and position, which start and goal share."""

    camera: Camera
    """The camera of both images."""
    radius_m: float | None
    """Radius of the bounding sphere; None: the size is drawn from ``diagonal_m``."""
    diagonal_m: tuple[float, float]
    """Range of the bounding box's diagonal, where ``radius_m`` is None."""
    distance_m: tuple[float, float]
    """Range of the origin's depth."""
    shift_m: float
    """Largest shift of the origin along camera x and y, either way."""
    quantum_m: float = 2.0 / 65535
    """Depth step of the 16-bit image (paper, "Simulator")."""
    in_hand: InHand | None = None
    """Where given, a gripper holds the object: pairs have these losses in place of the paper's rectangle."""

    def sometimes_in_hand(self, rng: Generator, share: float) -> "World":
        """This world, or for a share of the draws the preset ``in_hand`` before the camera of this one."""
        return replace(WORLDS["in_hand"], camera=self.camera) if share > 0 and rng.random() < share else self

    def place(self, rng: Generator, mesh: trimesh.Trimesh) -> Placement:
        """Draw the size and the position of a centred mesh."""
        if self.radius_m is not None:
            scale_m = self.radius_m / bounding_radius(mesh)
        else:
            scale_m = rng.uniform(*self.diagonal_m) / float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        x, y = rng.uniform(-self.shift_m, self.shift_m, 2)
        return Placement(scale_m, np.array([x, y, rng.uniform(*self.distance_m)]))


WORLDS = {
    # the simulator of the paper's release; the paper leaves these values out
    "paper": World(Camera(128, 128, 300.0, 300.0, 64.0, 64.0), None, (0.20, 0.25), (0.57, 0.62), 0.01),
    "benchmark": World(Camera(128, 128, 331.0, 331.0, 64.0, 64.0), 0.1, (0.0, 0.0), (0.59, 0.61), 0.01),
    "in_hand": World(
        Camera(128, 128, 331.0, 331.0, 64.0, 64.0), None, (0.10, 0.17), (0.55, 0.75), 0.015, in_hand=InHand()
    ),
}


def load_world(name: str) -> World:
    """A preset by name. Raises ReorientError for an unknown one."""
    if name not in WORLDS:
        raise unknown_name("world", name, list(WORLDS))
    return WORLDS[name]


class Renderer:
    """Casts rays at one mesh, centred on its bounding box."""

    def __init__(self, mesh: trimesh.Trimesh, every_pixel: bool = False) -> None:
        """``every_pixel``: cast a ray through each pixel, not only through those near the silhouette; same images."""
        self.mesh = center(mesh)
        self._every_pixel = every_pixel
        self._scene = EmbreeScene()
        self._triangles = TriangleMesh(self._scene, self.mesh.vertices[self.mesh.faces].astype(np.float32))
        vertices = self.mesh.vertices
        if len(vertices) > _HULL_ABOVE:
            try:
                vertices = self.mesh.convex_hull.vertices
            except QhullError:  # a flat mesh has no hull
                vertices = self.mesh.bounding_box.vertices
        self._outline = np.asarray(vertices, float)

    def depth(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> Float[np.ndarray, "height width"]:
        """Exact depth, float32 metres, 0 where no surface is hit."""
        pixels, origin, directions = self.rays(camera, R_camera_object, placement)
        depth_m = np.zeros((camera.height, camera.width), np.float32)
        if len(pixels):
            distance = self._scene.run(origin, directions, query="DISTANCE")
            distance[distance > 1e30] = 0
            depth_m.reshape(-1)[pixels] = distance * placement.scale_m
        return depth_m

    def depth_and_incidence(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> tuple[Float[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
        """Depth as of ``depth``, and |cos| of the angle of incidence (0 where nothing is hit)."""
        pixels, origin, directions = self.rays(camera, R_camera_object, placement)
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
        """Index of the face that each pixel's ray hits first; -1 where none."""
        face = np.full((camera.height, camera.width), -1, np.int32)
        pixels, origin, directions = self.rays(camera, R_camera_object, placement)
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
        """Whether the object itself hides each surface point from a projector; points and projector in camera axes."""
        surface = (points_m - placement.center_m) @ R_camera_object / placement.scale_m
        source = (projector_m - placement.center_m) @ R_camera_object / placement.scale_m
        towards = surface - source  # a point is lit if the ray from the projector hits nothing before it
        return np.asarray(self.distances(np.broadcast_to(source, towards.shape), towards) < 1 - 2e-3)

    def distances(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        """How far each ray goes until it first hits the object, over the length of its direction; very large where it
        misses. Both in the mesh's frame and unit."""
        rays = origins.astype(np.float32), directions.astype(np.float32)
        return np.asarray(self._scene.run(*rays, query="DISTANCE"))

    def rays(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Indices (row-major) of the pixels that may show the object; origin and direction of their rays, in the mesh's
        frame and unit."""
        outline_m = placement.scale_m * R_camera_object @ self._outline.T + placement.center_m[:, None]
        first_row, cells = _every_cell(camera) if self._every_pixel else _cells_within(camera, outline_m)
        rows = cells[-1] // camera.width + 1 if len(cells) else 0
        x = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(np.float32)
        y = ((np.arange(first_row, first_row + rows) + 0.5 - camera.cy) / camera.fy).astype(np.float32)
        R = R_camera_object.astype(np.float32)  # rows: the camera axes in the object's frame
        grid = (np.outer(R[1], y) + R[2][:, None])[:, :, None] + np.outer(R[0], x)[:, None]
        directions = np.take(grid.reshape(3, -1), cells, axis=1).T
        origin = (-placement.center_m @ R_camera_object / placement.scale_m).astype(np.float32)
        return first_row * camera.width + cells, np.broadcast_to(origin, directions.shape), directions


def _every_cell(camera: Camera) -> tuple[int, Int[np.ndarray, " k"]]:
    return 0, np.arange(camera.height * camera.width)


def _cells_within(camera: Camera, outline_m: Float[np.ndarray, "3 n"]) -> tuple[int, Int[np.ndarray, " k"]]:
    """The pixels in a polygon of 26 sides around the outline: its first row, and indices from the start of that row."""
    x, y, z = outline_m
    if z.min() < 1e-3:  # beside or around the camera: it may appear anywhere
        return _every_cell(camera)
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    top, bottom = np.clip([np.floor(v.min() - _MARGIN_PX), np.ceil(v.max() + _MARGIN_PX)], 0, camera.height).astype(int)
    across = np.multiply.outer(_SLOPES, v) + u  # column, at row 0, of the line through each vertex
    margin = _MARGIN_PX * np.sqrt(1 + _SLOPES**2)
    lines = np.multiply.outer(np.arange(top, bottom) + 0.5, _SLOPES)
    left = (across.min(axis=1) - margin - lines).max(axis=1, keepdims=True)
    right = (across.max(axis=1) + margin - lines).min(axis=1, keepdims=True)
    columns = np.arange(camera.width) + 0.5
    return int(top), np.flatnonzero((columns >= left) & (columns <= right))
