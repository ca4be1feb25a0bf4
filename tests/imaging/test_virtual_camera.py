"""The virtual camera: what it shows is where it was, and rotations come back in the real camera's axes."""

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.imaging.virtual_camera import (
    FILL,
    GAP_PX,
    SIZE_PX,
    aim,
    filled,
    join,
    network_input,
    outline,
    pivot_guess,
    rotated,
    slide,
)
from reorient.world.rendering import Placement, Renderer

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


def view_of(*images):
    """The virtual camera of some images of one camera, and their views."""
    camera = images[0].camera
    outlines = outline(np.stack([image.valid for image in images]), camera)
    virtual = aim(functools.reduce(join, outlines[:, None]))
    return virtual, [virtual.view(image.depth_m[None, None], camera)[0, 0] for image in images]


def points_of(view_m, virtual):
    """The points of a view, in the real camera's axes."""
    half = SIZE_PX / 2
    f = half / virtual.tangent[0]
    return DepthImage(view_m, Camera(SIZE_PX, SIZE_PX, f, f, half, half)).points() @ virtual.R_virtual_camera[0]


@pytest.mark.parametrize("center_m", SPHERES_M.values(), ids=SPHERES_M)
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
class TestView:
    def test_points_stay_on_the_sphere(self, camera, center_m):
        image = sphere_image(camera, center_m)
        virtual, (view_m,) = view_of(image)
        assert np.count_nonzero(view_m) > 0.3 * SIZE_PX**2
        # nearest neighbour moves a depth by at most half a pixel of the real camera, across the ray
        pixel_m = image.depth_m.max() / min(camera.fx, camera.fy)
        off_m = np.linalg.norm(points_of(view_m, virtual) - center_m, axis=1) - RADIUS_M
        assert np.abs(off_m).max() < 0.75 * pixel_m

    def test_points_stay_on_the_plane(self, camera, center_m):
        normal = np.array([0.3, -0.4, -1.0]) / np.linalg.norm([0.3, -0.4, -1.0])
        image = plane_image(camera, center_m, normal)
        virtual, (view_m,) = view_of(image)
        pixel_m = image.depth_m.max() / min(camera.fx, camera.fy)
        assert np.abs((points_of(view_m, virtual) - center_m) @ normal).max() < 0.5 * pixel_m

    def test_the_outlines_of_both_fill_the_view(self, camera, center_m):
        image, other = sphere_image(camera, center_m), sphere_image(camera, np.add(center_m, (0, 0.02, 0.05)))
        _, views_m = view_of(image, other)
        rows, columns = np.nonzero(np.any(views_m, axis=0))
        reach_px = max(rows.max() + 1 - 64, 64 - rows.min(), columns.max() + 1 - 64, 64 - columns.min())
        assert reach_px == pytest.approx(FILL * 64, abs=2)
        assert abs(rows.min() + rows.max() - 127) <= 4
        assert abs(columns.min() + columns.max() - 127) <= 4


def test_a_target_lies_in_the_middle():
    image = sphere_image(CAMERAS["off-centre"], SPHERES_M["aside"])
    pivot_m = np.add(SPHERES_M["aside"], (0.01, 0.02, 0.03))
    virtual = aim(outline(image.valid[None], image.camera), pivot_m[None])
    assert np.allclose((virtual.R_virtual_camera @ pivot_m)[0, :2], 0)


def test_aiming_straight_ahead_rotates_nothing():
    image = sphere_image(CAMERAS["f = 300"], SPHERES_M["ahead"])
    virtual = aim(outline(image.valid[None], image.camera), np.array([[0.0, 0.0, 0.6]]))
    assert np.array_equal(virtual.R_virtual_camera[0], np.eye(3))


def test_aiming_is_the_rotation_of_least_angle(rng):
    target = np.array([0, 0, 1.5]) + rng.normal(0, 0.5, (20, 3))
    box = np.tile(np.array([[-0.1, 0.1], [-0.1, 0.1]]), (20, 1, 1))
    R = aim(box, target).R_virtual_camera
    assert all(so3.is_rotation(R[i], 1e-12) for i in range(20))
    sight = target / np.linalg.norm(target, axis=1, keepdims=True)
    assert np.allclose(so3.angle(R), np.arccos(sight[:, 2]))


def test_every_real_camera_gives_the_same_network_input():
    inputs = []
    for camera in CAMERAS.values():
        images = [sphere_image(camera, SPHERES_M["aside"], radius_m) for radius_m in (0.06, 0.05)]
        virtual, (current_m, goal_m) = view_of(*images)
        inputs.append(network_input(np.stack([[current_m, goal_m]]), virtual.tangent)[0])
    for other in inputs[1:]:
        both = (inputs[0] > 0) & (other > 0)
        assert both.mean() > 0.93 * (inputs[0] > 0).mean()
        assert np.median(np.abs(inputs[0] - other)[both]) < 0.02


def test_network_input_is_free_of_unit_and_larger_where_nearer():
    virtual, (near_m, far_m) = view_of(*(sphere_image(CAMERAS["f = 300"], np.array([0, 0, z])) for z in (0.6, 0.65)))
    pair_m = np.stack([[near_m, far_m]])
    images = network_input(pair_m, virtual.tangent)
    assert np.allclose(network_input(pair_m * 3, virtual.tangent), images, atol=1e-4)
    assert images[0, 0][near_m > 0].mean() > 1 > images[0, 1][far_m > 0].mean()
    assert not images[0, 0][near_m == 0].any()


def test_a_rotation_seen_by_the_virtual_camera_comes_back_in_camera_axes(rng):
    virtual, _ = view_of(sphere_image(CAMERAS["off-centre"], SPHERES_M["aside"]))
    R_virtual_camera = virtual.R_virtual_camera[0]
    assert so3.angle(R_virtual_camera) > 0.1
    R_goal_current = so3.exp(np.array([0.2, -0.4, 0.3]))
    current = rng.normal(0, 0.05, (50, 3))
    seen_current, seen_goal = (points @ R_virtual_camera.T for points in (current, current @ R_goal_current.T))
    R_virtual = Rotation.align_vectors(seen_goal, seen_current)[0].as_matrix()
    assert np.allclose(virtual.to_camera(R_virtual[None])[0], R_goal_current, atol=1e-9)
    assert np.allclose(virtual.from_camera(R_goal_current[None])[0], R_virtual, atol=1e-9)
    inverse = R_virtual_camera @ R_virtual @ R_virtual_camera.T
    assert so3.angle_difference(inverse, R_goal_current) > 0.05
    assert so3.angle_difference(R_virtual, R_goal_current) > 0.02


class TestRotated:
    @pytest.fixture
    def pair(self, mesh):
        """Two views of a corner, 20 degrees apart, and the truth between them in virtual axes."""
        camera = CAMERAS["f = 300"]
        renderer, placement = Renderer(mesh), Placement(0.1, np.array([0.01, -0.02, 0.6]))
        R_start, R_goal_current = so3.exp(np.array([2.0, 0.5, -0.3])), so3.exp(np.array([0.2, -0.2, 0.2]))
        images = [
            DepthImage(renderer.depth(camera, R @ R_start, placement), camera) for R in (np.eye(3), R_goal_current)
        ]
        virtual, views_m = view_of(*images)
        pivot_m = virtual.R_virtual_camera @ placement.center_m
        return virtual, views_m, virtual.from_camera(R_goal_current[None]), pivot_m

    def overlap(self, a, b):
        return np.sum((a > 0) & (b > 0) & (np.abs(a - b) < 0.005)) / np.sum((a > 0) | (b > 0))

    def test_by_the_truth_it_equals_the_goal(self, pair):
        virtual, (current_m, goal_m), R, pivot_m = pair
        seen_m = rotated(current_m[None], virtual.tangent, R, pivot_m, pivot_m)[0]
        inverse_m = rotated(current_m[None], virtual.tangent, np.swapaxes(R, 1, 2), pivot_m, pivot_m)[0]
        assert self.overlap(seen_m, goal_m) > 0.75 > 0.5 > self.overlap(current_m, goal_m)
        assert self.overlap(inverse_m, goal_m) < 0.4

    def test_by_nothing_it_stays(self, pair):
        virtual, (current_m, _), _, pivot_m = pair
        seen_m = rotated(current_m[None], virtual.tangent, np.eye(3)[None], pivot_m, pivot_m)[0]
        assert self.overlap(seen_m, current_m) > 0.98

    def test_the_nearest_of_coinciding_points_shows(self):
        view_m = np.zeros((1, SIZE_PX, SIZE_PX), np.float32)
        view_m[0, 64, 64], view_m[0, 64, 100] = 0.5, 0.6
        quarter = so3.exp(np.array([[0.0, np.pi / 2, 0.0]]))
        middle = np.array([[0.0, 0.0, 0.55]])
        seen_m = rotated(view_m, np.array([0.2]), quarter, middle, middle)
        assert np.count_nonzero(seen_m) in (1, 2)
        assert seen_m.max() < 0.7

    def test_guessed_pivot_guess_are_near_the_pivot(self, pair):
        virtual, views_m, _, pivot_m = pair
        guesses_m = pivot_guess(np.stack(views_m), np.repeat(virtual.tangent, 2))
        assert np.linalg.norm(guesses_m - pivot_m, axis=1).max() < 0.04


def test_a_sphere_slides_onto_itself_moved():
    camera, shift_m = CAMERAS["f = 535"], np.array([0.006, -0.004, 0.01])
    center_m = SPHERES_M["ahead"]
    virtual, views_m = view_of(sphere_image(camera, center_m), sphere_image(camera, center_m + shift_m))
    found_m = slide(views_m[0][None], views_m[1][None], virtual.tangent)[0]
    assert virtual.R_virtual_camera[0].T @ found_m == pytest.approx(shift_m, abs=0.0015)


@pytest.mark.parametrize("lost", [np.s_[:, :50], np.s_[80:], np.s_[60:, 60:]])
def test_a_view_of_which_a_part_is_lost_slides_as_the_whole(lost):
    """The box around the rest has another middle, by up to a quarter of the sphere."""
    camera, shift_m = CAMERAS["f = 535"], np.array([0.006, -0.004, 0.01])
    center_m = SPHERES_M["ahead"]
    virtual, views_m = view_of(sphere_image(camera, center_m), sphere_image(camera, center_m + shift_m))
    views_m[1][lost] = 0
    found_m = slide(views_m[0][None], views_m[1][None], virtual.tangent)[0]
    assert virtual.R_virtual_camera[0].T @ found_m == pytest.approx(shift_m, abs=0.004)


def test_gaps_are_filled_from_their_sides_and_nothing_else_changes(rng):
    view = np.zeros((1, 2, 64, 64), np.float32)
    view[:, :, 16:48, 16:48] = 0.6 + 0.001 * np.arange(32)
    whole = view.copy()
    view[0, 0, 16:48, 28 : 28 + GAP_PX - 1] = 0  # a gap across the object
    view[0, 0, 20:44][rng.random((24, 64)) < 0.02] = 0
    view[0, 1, 20:44, 16 : 16 + GAP_PX + 8] = 0  # a wide piece of its side
    out = filled(view)
    assert np.array_equal(out[view > 0], view[view > 0])
    assert np.all(out[0, 0, 20:44, 18:46] > 0)
    assert np.abs(out - whole)[0, 0, 20:44, 18:46].max() < 0.02
    assert not out[0, 1, 31, 16:22].any()
    assert not out[whole == 0].any()


def test_nothing_slides_onto_nothing():
    empty, full = np.zeros((1, 8, 8), np.float32), np.ones((1, 8, 8), np.float32)
    assert not slide(empty, full, np.ones(1)).any()
    assert not slide(full, empty, np.ones(1)).any()


@pytest.mark.parametrize("pivot_m", [(0.0, 0.0, -0.6), (0.0, 0.1, 0.0), (np.nan, 0.0, 0.6)])
def test_a_pivot_behind_the_camera_is_refused(pivot_m):
    image = sphere_image(CAMERAS["f = 300"], SPHERES_M["ahead"])
    with pytest.raises(ReorientError, match=r"pivot .* expected three finite numbers, metres, in front"):
        aim(outline(image.valid[None], image.camera), np.array([pivot_m]))


def test_an_image_without_returns_is_refused():
    with pytest.raises(ReorientError, match="an image without returns: expected the object in it"):
        outline(np.zeros((1, 4, 4), bool), CAMERAS["f = 300"])
