"""From two depth arrays to a rotation: the whole Python interface in one page."""

import numpy as np

from reorient import Camera, DepthImage, load_estimator


def block(camera: Camera, angle_deg: float) -> np.ndarray:
    """Depth (h, w), metres, of two sides of a block at 0.6 m, rotated about the camera's vertical axis."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    x, y = np.meshgrid(u, v)
    # faces n . p = d around the centre (0, 0, 0.6): the nearest surface of a convex body is the farthest of its planes
    sides = [(-45 + angle_deg, 0.05), (45 + angle_deg, 0.03)]
    planes = []
    for angle_deg, distance in sides:
        n = np.array([np.sin(np.radians(angle_deg)), 0.0, -np.cos(np.radians(angle_deg))])
        planes.append((n[2] * 0.6 + distance) / (n[0] * x + n[2]))
    depth_m = np.maximum(*planes)
    return np.where((np.abs(y * depth_m) < 0.04 + 0.2 * x) & (depth_m < 0.64), depth_m, 0.0)


camera = Camera(width=128, height=128, fx=331.0, fy=331.0, cx=64.0, cy=64.0)
current = DepthImage(block(camera, angle_deg=0), camera)
goal = DepthImage(block(camera, angle_deg=12), camera)

estimate = load_estimator("default").estimate(current, goal)
print(f"rotation {np.degrees(estimate.angle_rad):.2f} deg")
print("quaternion wxyz", estimate.quat_wxyz.round(4))
print(f"inliers {estimate.evidence.inlier_ratio:.0%}")
