"""Scenes of meshes before a depth camera like a RealSense: raw frames, and the mesh that each pixel shows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from reorient import se3
from reorient.imaging import Camera, DepthImage
from reorient.world.meshes import scale_to_diagonal
from reorient.world.rendering import Placement, Renderer
from reorient.world.sensing import Sensor, sense

CAMERA = Camera(640, 480, 610.0, 610.0, 320.0, 240.0)
QUANTUM_M = 0.001  # of the 16-bit depth of a RealSense


@dataclass(frozen=True)
class Scene:
    """Meshes in world axes (z up, the table's top at z = 0) and the camera above them."""

    meshes: tuple[trimesh.Trimesh, ...]
    T_camera_world: Float[np.ndarray, "4 4"]

    def capture(self, rng: Generator, noise_m: float) -> tuple[DepthImage, Int[np.ndarray, "h w"]]:
        """A raw frame and the index of the mesh that each pixel shows; -1: none."""
        parts = [each.copy().apply_transform(self.T_camera_world) for each in self.meshes]
        mesh = trimesh.Trimesh(
            *trimesh.util.append_faces([p.vertices for p in parts], [p.faces for p in parts]), process=False
        )
        placement = Placement(1.0, mesh.bounds.mean(axis=0))
        renderer = Renderer(mesh, every_pixel=True)
        face = renderer.faces(CAMERA, np.eye(3), placement)
        owner = np.repeat(np.arange(len(self.meshes)), [len(each.faces) for each in self.meshes])[face]
        sensor = Sensor(False, 0.002, noise_m, grazing_cos=0.06, flying=0.2, projector_m=(0.055, 0.0, 0.0))
        image = sense(rng, renderer, CAMERA, np.eye(3), placement, sensor, QUANTUM_M)
        return image, np.where(face >= 0, owner, -1)


def camera_above(
    rng: Generator, elevation_rad: float, distance_m: float, target_m: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """T_camera_world of a camera at this angle above the table that looks at the target, off the middle by some cm."""
    azimuth = rng.uniform(0, 2 * np.pi)
    towards = -np.array([np.cos(azimuth) * np.cos(elevation_rad), np.sin(azimuth) * np.cos(elevation_rad), 0])
    towards[2] = -np.sin(elevation_rad)
    right = np.cross(towards, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R_world_camera = np.column_stack([right, np.cross(towards, right), towards])
    aim_m = target_m + np.append(rng.uniform(-0.04, 0.04, 2), 0.0)
    return se3.inverse(se3.transform(R_world_camera, aim_m - distance_m * towards))


def table(size_m: float = 3.0) -> trimesh.Trimesh:
    """The top of a table at z = 0."""
    half = size_m / 2
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    return trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)


def block(low: Sequence[float], high: Sequence[float]) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.box(bounds=[low, high])
    return mesh


def lying(mesh: trimesh.Trimesh, rng: Generator, diagonal_m: float) -> trimesh.Trimesh:
    """The mesh with this diagonal, lying at the origin on a random face of its convex hull."""
    mesh = scale_to_diagonal(mesh, diagonal_m)
    hull = mesh.convex_hull
    normal = hull.face_normals[rng.choice(len(hull.faces), p=hull.area_faces / hull.area_faces.sum())]
    mesh.apply_transform(trimesh.geometry.align_vectors(normal, [0, 0, -1]))
    mesh.apply_transform(spin(rng.uniform(0, 2 * np.pi)))
    middle = mesh.bounds.mean(axis=0)
    mesh.apply_translation([-middle[0], -middle[1], -mesh.bounds[0, 2]])
    return mesh


def spin(angle_rad: float, shift_m: Sequence[float] = (0.0, 0.0, 0.0)) -> Float[np.ndarray, "4 4"]:
    """A rotation about the table's normal, then a shift."""
    T = trimesh.transformations.rotation_matrix(angle_rad, [0, 0, 1])
    T[:3, 3] = shift_m
    return np.asarray(T)


def box_around(seen: Bool[np.ndarray, "h w"], margin_px: int) -> tuple[int, int, int, int]:
    """Left, top, width and height of a box around pixels."""
    rows, columns = np.nonzero(seen)
    left, top = int(columns.min()) - margin_px, int(rows.min()) - margin_px
    return left, top, int(columns.max()) + margin_px + 1 - left, int(rows.max()) + margin_px + 1 - top


def iou(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))
