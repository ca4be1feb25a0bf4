"""Images of the cell: one ray-cast scene of table, arm, fingers and object for depth, colour and true masks."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy.random import Generator

from reorient import se3
from reorient.imaging import Camera, DepthImage
from reorient.perception.calibration import MountedCamera
from reorient.perception.frame import ColorImage
from reorient.stations.cell.arm import Part, merged
from reorient.world.rendering import Placement, Renderer
from reorient.world.sensing import Sensor, sense

# Photoneo PhoXi, looking down from 0.81 m with its image's top to the robot's front; a webcam beside it, tilted inwards
DEPTH_CAMERA = Camera(1032, 772, 1122.0, 1122.0, 512.0, 384.5)
COLOR_CAMERA = Camera(1280, 720, 930.0, 930.0, 640.0, 360.0)
PROJECTOR_M = (0.2, 0.0, 0.0)  # depth camera axes
_DOWN = np.array(
    [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
)  # R_world_camera: x to the right, y to the base
_TILT_RAD = 0.17
_LIGHTS = (
    (np.array([0.3, 0.5, 0.8]), 0.55),
    (np.array([-0.6, -0.5, 0.6]), 0.25),
)  # direction to the light, world axes, and its strength
_AMBIENT = 0.25
_NOTHING = 0.1  # brightness of the background
_RGB_NOISE = 4.0  # standard deviation, levels of 255
NAME = "object"


def structured_light(noise_m: float) -> Sensor:
    """The sensor model of the depth camera, with a projector farther away than that of a small camera."""
    return Sensor(dropout=0.005, noise_m=noise_m, grazing_cos=0.12, flying=0.1, projector_m=PROJECTOR_M)


def mounted_above(place_m: Float[np.ndarray, "3"], height_m: float = 0.81) -> tuple[MountedCamera, MountedCamera]:
    """Depth and colour camera above a position in the world."""
    depth = np.array([place_m[0], place_m[1], height_m])
    c, s = np.cos(_TILT_RAD), np.sin(_TILT_RAD)
    tilted = _DOWN @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return (
        MountedCamera(DEPTH_CAMERA, se3.transform(_DOWN, depth)),
        MountedCamera(COLOR_CAMERA, se3.transform(tilted, depth + np.array([0.0, -0.1, 0.0]))),
    )


def projector_of(depth: MountedCamera) -> MountedCamera:
    """The depth camera's projector as a camera, whose image shows the lit surface."""
    return MountedCamera(depth.camera, depth.T_world_camera @ se3.transform(np.eye(3), np.array(PROJECTOR_M)))


def observer(tool_m: Float[np.ndarray, "3"], size_px: int) -> MountedCamera:
    """A square camera at the robot's right front that shows the whole arm, for pictures of the cell."""
    eye = tool_m + np.array([0.55, -0.75, 0.5])
    forward = tool_m + np.array([-0.05, 0.0, 0.04]) - eye
    right = np.cross(forward, [0.0, 0.0, 1.0])
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    f, c = 2.0 * size_px, size_px / 2
    return MountedCamera(Camera(size_px, size_px, f, f, c, c), se3.transform(axes / np.linalg.norm(axes, axis=0), eye))


def window(mounted: MountedCamera, center_m: Float[np.ndarray, "3"], reach_m: float) -> Camera:
    """The window of a camera's image that shows a sphere of radius ``reach_m`` in the world."""
    x, y, z = se3.apply(mounted.T_camera_world, center_m)
    camera = mounted.camera
    pixel = camera.project(np.array([x, y, z]))
    half = np.array([camera.fx, camera.fy]) * reach_m / (z - reach_m)
    low = np.clip(np.floor(pixel - half), 0, (camera.width - 1, camera.height - 1)).astype(int)
    high = np.clip(np.ceil(pixel + half), low + 1, (camera.width, camera.height)).astype(int)
    return camera.cropped(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


class Scene:
    """The cell at one moment."""

    def __init__(self, parts: Sequence[Part]) -> None:
        mesh = merged(parts)
        counts = [len(part.mesh.faces) for part in parts]
        self._colours = np.repeat([part.rgb for part in parts], counts, axis=0)
        self._is_object = np.repeat([part.name == NAME for part in parts], counts)
        self._center_m = mesh.bounds.mean(axis=0)
        self._renderer = Renderer(mesh)

    def depth(self, rng: Generator, mounted: MountedCamera, camera: Camera, sensor: Sensor) -> DepthImage:
        """Image of the depth camera; ``camera``: the mounted one or a window of it."""
        return sense(rng, self._renderer, camera, *self._pose(mounted), sensor)

    def color(self, mounted: MountedCamera, camera: Camera, rng: Generator | None = None) -> ColorImage:
        """Image of the colour camera: Lambertian shading under two lights, with noise unless ``rng`` is None."""
        R, placement = self._pose(mounted)
        face = self._renderer.faces(camera, R, placement)
        normals = self._renderer.mesh.face_normals[face]
        away = np.sum(normals * (camera.rays() @ R), axis=-1, keepdims=True) > 0
        normals = np.where(away, -normals, normals)  # both sides of a triangle are visible
        light = _AMBIENT + sum(
            strength * np.maximum(normals @ (direction / np.linalg.norm(direction)), 0)
            for direction, strength in _LIGHTS
        )
        rgb = 255 * np.where(face[..., None] >= 0, self._colours[face] * light[..., None], _NOTHING)
        if rng is not None:
            rgb += _RGB_NOISE * rng.standard_normal(rgb.shape)
        return ColorImage(np.clip(rgb, 0, 255).astype(np.uint8), camera)

    def shows_object(self, mounted: MountedCamera, camera: Camera) -> Bool[np.ndarray, "h w"]:
        """The pixels whose ray hits the object first: the true mask, for scoring and for placing objects."""
        face = self._renderer.faces(camera, *self._pose(mounted))
        return np.asarray(self._is_object[face] & (face >= 0))

    def _pose(self, mounted: MountedCamera) -> tuple[Float[np.ndarray, "3 3"], Placement]:
        T = mounted.T_camera_world
        return T[:3, :3], Placement(1.0, se3.apply(T, self._center_m))
