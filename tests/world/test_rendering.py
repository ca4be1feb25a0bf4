"""Rendered depth against closed forms, to less than half a step of the 16-bit image."""

import numpy as np
import pytest
import trimesh

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.world.meshes import center
from reorient.world.rendering import WORLDS, Placement, Renderer, load_world

HALF_STEP_M = 2.0 / 65535 / 2
CENTER_M = np.array([0.02, -0.015, 0.6])
PLACEMENT = Placement(0.1, CENTER_M)
ROTATIONS = so3.sample_uniform(np.random.default_rng(2), 4)


def convex_depth(mesh, camera, R_camera_object, placement):
    """Closed form: a ray meets a convex polyhedron where it has entered all its half spaces and left none."""
    triangles = (mesh.triangles * placement.scale_m) @ R_camera_object.T + placement.center_m
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    along = camera.rays() @ normals.T
    with np.errstate(divide="ignore"):  # rays along a face neither enter nor leave by it
        distance = np.sum(normals * triangles[:, 0], axis=1) / along
    entered = np.where(along < 0, distance, -np.inf).max(axis=-1)
    left = np.where(along > 0, distance, np.inf).min(axis=-1)
    return np.where(entered < left, entered, 0)


BODIES = {
    "box": trimesh.creation.box((1.0, 0.6, 0.8)),
    "ball": trimesh.creation.icosphere(subdivisions=3),  # 642 vertices: framed by its hull
    "prism": trimesh.creation.cylinder(0.5, 1.4, sections=7),
}


@pytest.mark.parametrize("R_camera_object", [np.eye(3), *ROTATIONS])
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_depth_of_a_convex_body(body, R_camera_object, camera):
    body = center(body)
    depth_m = Renderer(body).depth(camera, R_camera_object, PLACEMENT)
    expected_m = convex_depth(body, camera, R_camera_object, PLACEMENT)
    assert np.array_equal(depth_m > 0, expected_m > 0)
    assert np.abs(depth_m - expected_m).max() < HALF_STEP_M
    assert depth_m.dtype == np.float32


def test_depth_of_a_box_face_is_its_distance(camera):
    depth_m = Renderer(trimesh.creation.box((1, 1, 1))).depth(camera, np.eye(3), PLACEMENT)
    u, v = camera.project(np.array([[-0.03, -0.065, 0.55], [0.07, 0.035, 0.55]])).round().astype(int).T
    assert np.allclose(depth_m[v[0] : v[1], u[0] : u[1]], 0.55, atol=HALF_STEP_M / 10)


def test_depth_of_a_sphere(camera):
    """The chords of a fine ball leave the sphere by less than a step; from inside, so it is never nearer."""
    ball = trimesh.creation.icosphere(subdivisions=6)
    sagitta_m = 0.1 * (1 - np.linalg.norm(ball.triangles_center, axis=1).min())
    depth_m = Renderer(ball).depth(camera, ROTATIONS[0], PLACEMENT)
    d = camera.rays()
    a, b, c = np.sum(d * d, axis=-1), d @ CENTER_M, CENTER_M @ CENTER_M - 0.1**2
    root = b**2 - a * c
    facing = root > 0.25 * root.max()  # incidence below 60 degrees: the chord is at most twice as deep as it is high
    too_far_m = (depth_m - (b - np.sqrt(np.maximum(root, 0))) / a)[facing]
    assert sagitta_m < HALF_STEP_M / 2
    assert too_far_m.min() > -HALF_STEP_M / 10
    assert too_far_m.max() < HALF_STEP_M


def test_depth_and_incidence_of_a_tilted_plane(camera):
    """Also: both sides of a surface are visible."""
    quad = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]], [[0, 1, 2], [0, 2, 3]], process=False)
    inverted = quad.copy()
    inverted.invert()
    for quad_seen in (quad, inverted):
        for R in ROTATIONS:
            normal = R[:, 2]
            d = camera.rays()
            expected_m = (normal @ CENTER_M) / (d @ normal)
            at = (d * expected_m[..., None] - CENTER_M) @ R / 0.1  # in the quad's frame and unit
            inside = np.abs(at[..., :2]).max(axis=-1) < 1
            depth_m, cosine = Renderer(quad_seen).depth_and_incidence(camera, R, PLACEMENT)
            assert np.array_equal(depth_m > 0, inside)
            assert np.allclose(depth_m[inside], expected_m[inside], atol=HALF_STEP_M / 10)
            assert np.allclose(cosine[inside], np.abs(d @ normal / np.linalg.norm(d, axis=-1))[inside], atol=1e-5)
            assert np.all(cosine[~inside] == 0)


def test_both_sides_of_a_triangle_are_seen(camera):
    vertices = [[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]
    front, back = (
        Renderer(trimesh.Trimesh(vertices, [face], process=False)).depth(camera, np.eye(3), PLACEMENT)
        for face in ([0, 1, 2], [2, 1, 0])
    )
    assert front.any()
    assert np.array_equal(front, back)


def test_a_flat_mesh_of_many_vertices_is_seen_whole(camera):
    """It has no convex hull to take the outline from."""
    flat = trimesh.creation.box((1.5, 1.0, 0.0)).subdivide().subdivide().subdivide()
    assert len(flat.vertices) > 200
    for R in ROTATIONS:
        fewer, every = (Renderer(flat, every_pixel=x).depth(camera, R, PLACEMENT) for x in (False, True))
        assert np.count_nonzero(every) > 100
        assert np.array_equal(fewer, every)


@pytest.mark.parametrize("R_camera_object", ROTATIONS)
def test_incidence_comes_with_the_same_depth(R_camera_object, mesh, camera):
    renderer = Renderer(mesh)
    depth_m, cosine = renderer.depth_and_incidence(camera, R_camera_object, PLACEMENT)
    assert np.allclose(depth_m, renderer.depth(camera, R_camera_object, PLACEMENT), atol=1e-7)
    assert np.array_equal(cosine > 0, depth_m > 0)
    assert cosine.max() <= 1 + 1e-6


# --- pose -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("R_camera_object", ROTATIONS)
def test_rotating_the_object_is_rotating_its_vertices(R_camera_object, mesh, camera):
    posed = Renderer(mesh).depth(camera, R_camera_object, PLACEMENT)

    def with_rotated_vertices(R):
        rotated = center(mesh)
        rotated.vertices = rotated.vertices @ R.T
        middle = rotated.bounds.mean(axis=0)  # the renderer centres the mesh anew
        return Renderer(rotated).depth(camera, np.eye(3), Placement(0.1, CENTER_M + 0.1 * middle))

    assert np.count_nonzero((posed > 0) != (with_rotated_vertices(R_camera_object) > 0)) <= 2
    both = (posed > 0) & (with_rotated_vertices(R_camera_object) > 0)
    far_off = np.abs(posed - with_rotated_vertices(R_camera_object))[both] > HALF_STEP_M
    assert far_off.sum() <= 2  # a ray along an edge may pass on either side of it
    assert np.count_nonzero((posed > 0) != (with_rotated_vertices(R_camera_object.T) > 0)) > 50


@pytest.mark.parametrize("R_camera_object", ROTATIONS)
def test_projected_surface_points_lie_on_or_behind_what_is_seen(R_camera_object, mesh, camera):
    camera = camera.resized(960, 720)
    depth_m = Renderer(mesh).depth(camera, R_camera_object, PLACEMENT)
    points_m = center(mesh).sample(2000, seed=0) * 0.1 @ R_camera_object.T + CENTER_M
    u, v = np.floor(camera.project(points_m)).astype(int).T
    hit = depth_m[v, u] > 0
    behind_m = (points_m[:, 2] - depth_m[v, u])[hit]
    assert hit.mean() > 0.98  # all but for pixels that the outline cuts
    assert np.mean(behind_m > -0.002) > 0.98
    assert 0.2 < np.mean(np.abs(behind_m) < 0.002) < 0.8


def test_size_and_distance_scale_depth_alike(mesh, camera):
    renderer = Renderer(mesh)
    near = renderer.depth(camera, ROTATIONS[0], Placement(0.1, CENTER_M))
    far = renderer.depth(camera, ROTATIONS[0], Placement(0.25, 2.5 * CENTER_M))
    assert np.allclose(far, 2.5 * near, atol=HALF_STEP_M)


# --- the window -----------------------------------------------------------------------------------------------------

SHIFTS_M = {
    "inside": (0.0, 0.0, 0.6),
    "left": (-0.27, 0.02, 0.6),
    "right below": (0.3, 0.21, 0.6),
    "above": (0.0, -0.2, 0.6),
    "larger than the image": (0.01, 0.02, 0.13),
    "around the camera": (0.03, 0.02, 0.02),
    "outside": (0.9, 0.0, 0.6),
    "behind": (0.0, 0.0, -0.6),
}


@pytest.mark.parametrize("center_m", SHIFTS_M.values(), ids=SHIFTS_M)
def test_an_image_is_the_crop_of_a_larger_one(center_m, mesh, camera):
    renderer, placement = Renderer(mesh), Placement(0.1, np.array(center_m))
    larger = camera.cropped(-150, -100, 400, 300)
    large = renderer.depth(larger, ROTATIONS[1], placement)
    assert np.array_equal(renderer.depth(camera, ROTATIONS[1], placement), large[100:172, 150:246])


@pytest.mark.parametrize("center_m", SHIFTS_M.values(), ids=SHIFTS_M)
@pytest.mark.parametrize("body", ["mesh", *BODIES])
def test_rays_left_out_would_have_hit_nothing(body, center_m, mesh, camera):
    """To the bit: the same images as from rays through every pixel."""
    placement = Placement(0.1, np.array(center_m))

    def images(renderer):
        return [
            image
            for R in so3.sample_uniform(np.random.default_rng(3), 10)
            for image in (
                renderer.depth(camera, R, placement),
                *renderer.depth_and_incidence(camera, R, placement),
                renderer.depth(camera.resized(37, 400), R, placement),
            )
        ]

    fewer, every = (images(Renderer(BODIES.get(body, mesh), every_pixel=x)) for x in (False, True))
    assert all(np.array_equal(a, b) for a, b in zip(fewer, every, strict=True))


def test_every_pixel_is_every_pixel(mesh, camera):
    pixels, _, _ = Renderer(mesh, every_pixel=True).rays(camera, ROTATIONS[0], PLACEMENT)
    assert np.array_equal(pixels, np.arange(camera.height * camera.width))


def test_few_rays_are_left_out_in_vain(mesh, camera):
    renderer = Renderer(mesh.convex_hull)
    for R in ROTATIONS:
        pixels, _, _ = renderer.rays(camera, R, PLACEMENT)
        assert len(pixels) < 1.15 * np.count_nonzero(renderer.depth(camera, R, PLACEMENT))


@pytest.mark.parametrize(
    ("where", "seen"),
    [("left", True), ("larger than the image", True), ("outside", False), ("behind", False)],
)
def test_what_is_seen_of_an_object_at_the_border(where, seen, mesh, camera):
    depth_m = Renderer(mesh).depth(camera, ROTATIONS[1], Placement(0.1, np.array(SHIFTS_M[where])))
    assert depth_m.any() == seen


# --- worlds ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WORLDS)
def test_worlds_place_objects_within_their_ranges_and_in_view(name, mesh, rng):
    world, renderer = load_world(name), Renderer(mesh)
    for R in so3.sample_uniform(rng, 20):
        placement = world.place(rng, renderer.mesh)
        diagonal_m = placement.scale_m * np.linalg.norm(renderer.mesh.extents)
        radius_m = placement.scale_m * np.linalg.norm(renderer.mesh.vertices, axis=1).max()
        if world.radius_m is None:
            assert world.diagonal_m[0] <= diagonal_m <= world.diagonal_m[1]
        else:
            assert radius_m == pytest.approx(world.radius_m)
        off_m = np.abs(placement.center_m - [0, 0, np.mean(world.distance_m)])
        assert np.all(off_m <= [world.shift_m, world.shift_m, np.ptp(world.distance_m) / 2 + 1e-12])
        image = DepthImage(renderer.depth(world.camera, R, placement), world.camera)
        assert not np.any(image.valid[[0, -1]])
        assert not np.any(image.valid[:, [0, -1]])


def test_unknown_worlds_are_named():
    with pytest.raises(ReorientError, match=r"'benchmrk': expected one of paper, .*did you mean 'benchmark'"):
        load_world("benchmrk")


def test_a_camera_far_from_square_sees_the_same(mesh):
    """Rows and columns are not confused: the transposed camera sees the transposed object."""
    wide, tall = Camera(120, 40, 90.0, 110.0, 70.5, 18.25), Camera(40, 120, 110.0, 90.0, 18.25, 70.5)
    swap = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # x and y exchanged; -z keeps it a rotation
    flat = trimesh.Trimesh([[-1, -0.2, 0], [1, -0.1, 0], [0.3, 0.5, 0.0]], [[0, 1, 2]], process=False)
    seen = Renderer(flat).depth(wide, np.eye(3), Placement(0.1, np.array([0.02, -0.01, 0.6])))
    swapped = Renderer(flat).depth(tall, swap, Placement(0.1, np.array([-0.01, 0.02, 0.6])))
    assert seen.any()
    assert np.allclose(seen, swapped.T, atol=1e-6)
