"""Pictures of meshes."""

import numpy as np
import trimesh
from jaxtyping import Float
from PIL import Image

from reorient import so3
from reorient.imaging import DepthImage
from reorient.reporting.pictures import shade
from reorient.world.rendering import Placement, Renderer, load_world


def shade_mesh(
    mesh: trimesh.Trimesh, R_camera_object: Float[np.ndarray, "3 3"] | None = None, size_px: int = 256
) -> Image.Image:
    """A shaded view of a mesh, rendered exactly in the benchmark world; default: obliquely from above, z up."""
    if R_camera_object is None:
        R_camera_object = so3.exp(np.radians([118.0, 0.0, 0.0])) @ so3.exp(np.radians([0.0, 0.0, -125.0]))
    renderer = Renderer(mesh)
    world = load_world("benchmark")
    radius_m = float(np.linalg.norm(renderer.mesh.vertices, axis=1).max())
    placement = Placement(
        world.radius_m / radius_m if world.radius_m else 1.0, np.array([0.0, 0.0, np.mean(world.distance_m)])
    )
    camera = world.camera.resized(2 * size_px, 2 * size_px)
    return shade(DepthImage(renderer.depth(camera, R_camera_object, placement), camera), size_px)
