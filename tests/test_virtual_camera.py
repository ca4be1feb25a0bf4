"""The virtual camera: what it shows is where it was, and rotations come back in the real camera's axes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reorient import so3
from reorient.depth import Camera, DepthImage, aim
from reorient.errors import ReorientError

RADIUS_M = 0.1
CAMERAS = {
    "f = 300": Camera(128, 128, 300.0, 300.0, 64.0, 64.0),
    "f = 535": Camera(640, 480, 535.0, 535.0, 320.0, 240.0),
    "f = 1122": Camera(1032, 772, 1122.0, 1119.0, 511.0, 388.0),
    "off-centre": Camera(400, 300, 535.0, 520.0, 90.5, 230.0),
}
SPHERES_M = {"ahead": np.array([0.0, 0.0, 0.6]), "aside": np.array([0.08, -0.05, 0.7])}


def sphere_image(camera, center_m, radius_m=RADIUS_M):
    """Closed form: along the ray s (x, y, 1) the sphere is met where |s d - c| = r."""
    d = camera.rays()
    a, b, c = np.sum(d * d, axis=-1), d @ center_m, center_m @ center_m - radius_m**2
    root = b**2 - a * c
    return DepthImage(np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0), camera)


def plane_image(camera, center_m, normal):
    """Closed form: a disc of radius 0.1 m."""
    d = camera.rays()
    depth_m = (normal @ center_m) / (d @ normal)
    return DepthImage(
        np.where(np.linalg.norm(d * depth_m[..., None] - center_m, axis=-1) < RADIUS_M, depth_m, 0), camera
    )


def seen_in_camera(virtual, image):
    """The virtual view's points, in the real camera's axes."""
    return virtual.view(image).points() @ virtual.R_virtual_camera


@pytest.mark.parametrize("center_m", SPHERES_M.values(), ids=SPHERES_M)
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
class TestView:
    def test_points_stay_on_the_sphere(self, camera, center_m):
        image = sphere_image(camera, center_m)
        virtual = aim(image, image)
        assert virtual.view(image).valid.sum() > 0.3 * virtual.camera.width**2
        # nearest neighbour moves a depth by at most half a pixel of the real camera, across the ray
        pixel_m = image.depth_m.max() / min(camera.fx, camera.fy)
        off_m = np.linalg.norm(seen_in_camera(virtual, image) - center_m, axis=1) - RADIUS_M
        assert np.abs(off_m).max() < 0.75 * pixel_m

    def test_points_stay_on_the_plane(self, camera, center_m):
        normal = np.array([0.3, -0.4, -1.0]) / np.linalg.norm([0.3, -0.4, -1.0])
        image = plane_image(camera, center_m, normal)
        virtual = aim(image, image)
        pixel_m = image.depth_m.max() / min(camera.fx, camera.fy)
        assert np.abs((seen_in_camera(virtual, image) - center_m) @ normal).max() < 0.5 * pixel_m

    def test_the_object_fills_the_middle(self, camera, center_m):
        image, other = sphere_image(camera, center_m), sphere_image(camera, np.add(center_m, (0, 0.02, 0.05)))
        virtual = aim(image, other, size_px=96, fill=0.8)
        assert virtual.camera.width == virtual.camera.height == 96
        points = np.concatenate([image.points(), other.points()]) @ virtual.R_virtual_camera.T
        reach_px = np.abs(virtual.camera.project(points) - 48).max(axis=0)
        assert reach_px.max() == pytest.approx(0.8 * 48)
        assert reach_px.min() > 0.6 * 48


def test_a_pivot_lies_in_the_middle():
    image = sphere_image(CAMERAS["off-centre"], SPHERES_M["aside"])
    pivot_m = np.add(SPHERES_M["aside"], (0.01, 0.02, 0.03))
    virtual = aim(image, image, pivot_m)
    assert np.allclose(virtual.camera.project(virtual.R_virtual_camera @ pivot_m), 64)


def test_looking_straight_ahead_turns_nothing():
    image = sphere_image(CAMERAS["f = 300"], SPHERES_M["ahead"])
    assert np.array_equal(aim(image, image, np.array([0.0, 0.0, 0.6])).R_virtual_camera, np.eye(3))


def test_two_real_cameras_give_one_view():
    views = []
    for camera in CAMERAS.values():
        image = sphere_image(camera, SPHERES_M["aside"])
        views.append(aim(image, image, SPHERES_M["aside"], fill=0.8).view(image))
    depths_m = [view.depth_m[64, 64] for view in views]
    assert np.ptp(depths_m) < 2e-4
    assert np.ptp([view.camera.fx for view in views]) < 0.02 * views[0].camera.fx


def test_a_rotation_seen_by_the_virtual_camera_comes_back_in_camera_axes(rng):
    image = sphere_image(CAMERAS["off-centre"], SPHERES_M["aside"])
    virtual = aim(image, image)
    assert so3.angle(virtual.R_virtual_camera) > 0.1
    R_goal_current = so3.exp(np.array([0.2, -0.4, 0.3]))
    current = rng.normal(0, 0.05, (50, 3))
    seen_current, seen_goal = (points @ virtual.R_virtual_camera.T for points in (current, current @ R_goal_current.T))
    R_virtual = Rotation.align_vectors(seen_goal, seen_current)[0].as_matrix()
    assert np.allclose(virtual.to_camera(R_virtual), R_goal_current, atol=1e-9)
    inverse = virtual.R_virtual_camera @ R_virtual @ virtual.R_virtual_camera.T
    assert so3.angle_difference(inverse, R_goal_current) > 0.05
    assert so3.angle_difference(R_virtual, R_goal_current) > 0.02


@pytest.mark.parametrize("pivot_m", [(0.0, 0.0, -0.6), (0.0, 0.1, 0.0), (np.nan, 0.0, 0.6)])
def test_a_pivot_behind_the_camera_is_refused(pivot_m):
    image = sphere_image(CAMERAS["f = 300"], SPHERES_M["ahead"])
    with pytest.raises(ReorientError, match=r"pivot .* expected three finite numbers, metres in camera axes, in front"):
        aim(image, image, np.array(pivot_m))
