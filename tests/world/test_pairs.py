"""A pair's truth is the rotation between its two images, on the left; its draws follow the paper."""

import numpy as np
import pytest
import trimesh

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.world.pairs import FEWEST_RETURNS, Pair, sample_pair, view_overlap
from reorient.world.rendering import Placement, Renderer, load_world
from reorient.world.sensing import Sensor, randomised

WORLD = load_world("benchmark")


@pytest.fixture(scope="module")
def renderer(mesh):
    return Renderer(mesh)


def test_the_goal_is_the_start_rotated_on_the_left_in_camera_axes(renderer, rng):
    pair = sample_pair(rng, renderer, WORLD, Sensor(), np.pi / 6, np.pi / 4)
    R_start, R = pair.R_camera_object, pair.R_goal_current

    def off_m(R_camera_object, image):
        return np.abs(renderer.depth(WORLD.camera, R_camera_object, pair.placement) - image.depth_m).max()

    assert off_m(R_start, pair.current) < WORLD.quantum_m
    assert off_m(R @ R_start, pair.goal) < WORLD.quantum_m
    for wrong in (R.T @ R_start, R_start @ R, R_start):
        assert off_m(wrong, pair.goal) > 0.1


def test_angles_are_uniform_within_their_range_and_images_have_returns(renderer, rng):
    pairs = [sample_pair(rng, renderer, WORLD, randomised(0.001), 0.2, 0.5) for _ in range(60)]
    angles_rad = np.array([so3.angle(pair.R_goal_current) for pair in pairs])
    assert angles_rad.min() >= 0.2
    assert angles_rad.max() <= 0.5
    assert angles_rad.mean() == pytest.approx(0.35, abs=0.05)
    assert min(image.valid.sum() for pair in pairs for image in (pair.current, pair.goal)) >= FEWEST_RETURNS


def test_only_the_start_bears_the_rectangle(renderer, rng):
    pair = sample_pair(rng, renderer, WORLD, Sensor(rectangle=True), 0.1, 0.2)
    whole = renderer.depth(WORLD.camera, pair.R_camera_object, pair.placement) > 0
    rotated = renderer.depth(WORLD.camera, pair.R_goal_current @ pair.R_camera_object, pair.placement) > 0
    assert np.any(whole & ~pair.current.valid)
    assert np.array_equal(pair.goal.valid, rotated)


def test_the_same_seed_gives_the_same_pair(renderer):
    def bytes_of(seed):
        pair = sample_pair(np.random.default_rng(seed), renderer, WORLD, randomised(0.001), 0.0, 0.5)
        return pair.current.depth_m.tobytes() + pair.goal.depth_m.tobytes() + pair.R_goal_current.tobytes()

    assert bytes_of(3) == bytes_of(3)
    assert bytes_of(3) != bytes_of(4)


def test_an_object_that_is_hardly_seen_is_refused(rng):
    needle = trimesh.creation.box((1.0, 1e-4, 1e-4))
    with pytest.raises(ReorientError, match="fewer than 100 returns from everywhere"):
        sample_pair(rng, Renderer(needle), WORLD, Sensor(), 0.0, 0.5)


def overlap_of(shape: trimesh.Trimesh, rotvec_rad: np.ndarray) -> float:
    """Of a small shape straight ahead and its rotation."""
    renderer, placement = Renderer(shape), Placement(0.05, np.array([0.0, 0.0, 0.6]))
    R = so3.exp(rotvec_rad)
    images = [DepthImage(renderer.depth(WORLD.camera, x, placement), WORLD.camera) for x in (np.eye(3), R)]
    return view_overlap(renderer, Pair(*images, R, np.eye(3), placement, placement.center_m))


def test_overlap_is_the_share_of_the_goal_s_surface_that_the_start_sees():
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    assert overlap_of(box, np.zeros(3)) == 1
    assert overlap_of(box, np.array([0.0, 0.0, np.pi])) == 1  # the same face, about the optical axis
    assert overlap_of(box, np.array([0.0, np.pi, 0.0])) == 0  # the other side
    quarter = overlap_of(box, np.array([0.0, np.pi / 4, 0.0]))  # two faces, each foreshortened; one was seen
    assert quarter == pytest.approx(0.5, abs=0.03)
    ball = trimesh.creation.icosphere(4)
    shares = [overlap_of(ball, np.array([0.0, np.radians(angle), 0.0])) for angle in (30, 90, 150)]
    # of an orthographic disc the crescent's edge is an ellipse of the semi-axis cos(angle): (1 + cos) / 2 is shared
    assert shares == pytest.approx([(1 + np.cos(np.radians(angle))) / 2 for angle in (30, 90, 150)], abs=0.06)
    assert all(
        overlap_of(ball, np.array([x, 0.0, 0.0])) == pytest.approx(overlap_of(ball, np.array([-x, 0, 0])), abs=0.02)
        for x in (0.5, 2.0)
    )
