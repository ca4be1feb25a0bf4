"""Depth images a second on one core: ours, and trimesh's ray interface on the same Embree, side by side.
And pairs as the paper's training draws them: two images, rectangle and dropouts, quantisation, checks.

    python benchmarks/renderer.py

Prints one row an object; the ratio is what carries over to other machines.
"""

import time
from collections.abc import Callable

import numpy as np
import trimesh

from reorient import so3
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Placement, Renderer, load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")
PLACEMENT = Placement(0.1, np.array([0.0, 0.0, 0.6]))


def per_second(render: Callable[[np.ndarray], object], poses: np.ndarray) -> float:
    """Best of three rounds."""
    best = 0.0
    for _ in range(3):
        begin = time.perf_counter()
        for R in poses:
            render(R)
        best = max(best, len(poses) / (time.perf_counter() - begin))
    return best


def with_trimesh(mesh: trimesh.Trimesh) -> Callable[[np.ndarray], np.ndarray]:
    """Rays turned instead of the mesh here too, so that its scene is built once."""
    rays = WORLD.camera.rays().reshape(-1, 3)

    def render(R: np.ndarray) -> np.ndarray:
        directions = rays @ R
        origin = -PLACEMENT.center_m @ R / PLACEMENT.scale_m
        points, ray, _ = mesh.ray.intersects_location(
            np.broadcast_to(origin, directions.shape), directions, multiple_hits=False
        )
        depth_m = np.zeros(len(rays))
        depth_m[ray] = (points @ R.T)[:, 2] * PLACEMENT.scale_m + PLACEMENT.center_m[2]
        return depth_m.reshape(WORLD.camera.height, WORLD.camera.width)

    return render


def main() -> None:
    """Three objects, from few faces to many; the middle one is the reference of 400 faces."""
    poses = so3.sample_uniform(np.random.default_rng(0), 200)
    print("object             faces  filled  ours/s  trimesh/s  ratio  largest difference  pairs/s")
    paper, rng = load_world("paper"), np.random.default_rng(0)
    solids = {
        "box": trimesh.creation.box((1.2, 1.0, 0.8)),
        "torus": trimesh.creation.torus(0.7, 0.3, major_sections=20, minor_sections=10),
        "fine torus": trimesh.creation.torus(0.7, 0.3, major_sections=200, minor_sections=200),
    }
    for name, solid in solids.items():
        renderer = Renderer(solid.apply_scale(1 / np.linalg.norm(solid.vertices, axis=1).max()))
        theirs = with_trimesh(renderer.mesh)

        def ours(R: np.ndarray, renderer: Renderer = renderer) -> np.ndarray:
            return renderer.depth(WORLD.camera, R, PLACEMENT)

        def pair(_: np.ndarray, renderer: Renderer = renderer) -> None:
            sample_pair(rng, renderer, paper, randomised(), 0, np.pi / 6)

        images = [(ours(R), theirs(R)) for R in poses[:10]]
        both = [(a > 0) & (b > 0) for a, b in images]
        difference = max(np.abs(a - b)[k].max() for (a, b), k in zip(images, both, strict=True))
        filled = np.mean([a > 0 for a, _ in images])
        a, b, c = (per_second(f, poses) for f in (ours, theirs, pair))
        faces = len(solid.faces)
        row = f"{name:16s} {faces:7d}  {filled:5.0%}  {a:6.0f}  {b:9.0f}  {a / b:5.1f}"
        print(f"{row}  {1e6 * difference:15.1f} um  {c:7.0f}")


if __name__ == "__main__":
    main()
