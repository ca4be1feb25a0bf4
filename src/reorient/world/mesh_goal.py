"""Goals rendered from a mesh: exact depth, and exact motions between the views."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage, Goal, GoalView
from reorient.se3 import Transform
from reorient.world.meshes import load_mesh
from reorient.world.rendering import Placement, Renderer

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
_NEAREST_M = 0.05  # of any part of the object to the camera
_FEWEST_PX = 100  # across all of the object; fewer show no shape


def mesh_goal(
    path: str | Path,
    T_camera_object: Transform,
    camera: Camera,
    unit_m: float,
    rotations: Sequence[Float[np.ndarray, "3 3"]],
) -> Goal:
    """The goal of a mesh, as of ``Goal.from_mesh``; ``rotations``: R_view_goal of the further views.

    They are about the centre of the object's bounding box, which stays in its place.
    """
    T = np.asarray(T_camera_object, float)
    if T.shape != (4, 4) or not so3.is_rotation(T[:3, :3]) or not np.allclose(T[3], [0, 0, 0, 1]):
        raise ReorientError("T_camera_object: expected a rigid (4, 4) transform, metres")
    if not (np.isfinite(unit_m) and unit_m > 0):
        raise ReorientError(f"unit of {unit_m} m: expected metres per unit of the mesh, above 0 (0.001 for mm)")
    mesh = load_mesh(path)
    used = np.asarray(mesh.vertices, float)[np.unique(mesh.faces)]
    middle, extents = (used.min(axis=0) + used.max(axis=0)) / 2, np.ptp(used, axis=0)
    radius, R = float(np.linalg.norm(used - middle, axis=1).max()), T[:3, :3]

    def refusal(unit_m: float) -> str:
        return _does_not_fit(camera, se3.apply(T, middle * unit_m), radius * unit_m)

    if reason := refusal(unit_m):
        fits = [f"{name} ({_size(extents, x)})" for name, x in UNITS_M.items() if not refusal(x)]
        question = f"; is the unit {' or '.join(fits)}?" if fits else ""
        raise ReorientError(f"{path}: the object measures {_size(extents, unit_m)}, {reason}{question}")
    placement = Placement(unit_m, se3.apply(T, middle * unit_m))
    return rendered_goal(Renderer(mesh), placement, R, camera, rotations)


def rendered_goal(
    renderer: Renderer,
    placement: Placement,
    R_camera_object: Float[np.ndarray, "3 3"],
    camera: Camera,
    rotations: Sequence[Float[np.ndarray, "3 3"]],
) -> Goal:
    """The goal of a mesh in a pose, with further views after ``rotations``, R_view_goal, about its centre."""
    center_m = placement.center_m

    def image(R_view_goal: Float[np.ndarray, "3 3"]) -> DepthImage:
        return DepthImage(renderer.depth(camera, R_view_goal @ R_camera_object, placement), camera)

    views = [GoalView(image(R_vg), R_vg.T, center_m - R_vg.T @ center_m) for R_vg in rotations]
    return Goal(image(np.eye(3)), tuple(views))


def _does_not_fit(camera: Camera, center_m: Float[np.ndarray, "3"], radius_m: float) -> str:
    """Why a ball cannot be seen as a whole; empty where it can."""
    x, y, z = center_m
    if z - radius_m < _NEAREST_M:
        return f"which does not fit before the camera at a distance of {z:.2f} m"
    if np.pi * radius_m**2 * camera.fx * camera.fy / z**2 < _FEWEST_PX:
        return f"which is less than {_FEWEST_PX} pixels at a distance of {z:.2f} m"
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    ru, rv = camera.fx * radius_m / z, camera.fy * radius_m / z
    if u - ru < 0 or v - rv < 0 or u + ru > camera.width or v + rv > camera.height:
        return f"which is partly beyond the frame at ({x:.2f}, {y:.2f}, {z:.2f}) m: expected the object inside it"
    return ""


def _size(extents: Float[np.ndarray, "3"], unit_m: float) -> str:
    sizes_mm = sorted(1000 * unit_m * extents, reverse=True)
    return f"{' x '.join(f'{x:.0f}' if x >= 10 else f'{x:.2g}' for x in sizes_mm)} mm"
