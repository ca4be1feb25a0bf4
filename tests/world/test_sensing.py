"""What the sensor model takes from exact depth, and what it leaves alone."""

import numpy as np
import pytest
import trimesh
from scipy import ndimage
from scipy.spatial import ConvexHull

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera
from reorient.world.rendering import Placement, Renderer
from reorient.world.sensing import FLYING_REACH_M, RECTANGLE_PX, Sensor, randomised, sense, thin_rectangle

CAMERA = Camera(160, 120, 200.0, 200.0, 80.0, 60.0)
PLACEMENT = Placement(0.1, np.array([0.0, 0.0, 0.6]))
R = so3.exp(np.array([0.4, -0.7, 0.2]))


def quad(width, height, z):
    x, y = width / 2, height / 2
    return trimesh.Trimesh([[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]], [[0, 1, 2], [0, 2, 3]], process=False)


@pytest.fixture(scope="module")
def corner(mesh):
    return Renderer(mesh)


@pytest.fixture(scope="module")
def plate():
    return Renderer(quad(4, 3, 0))


# a square 5 cm in front of the origin and a plate 5 cm behind it, in metres
NEAR_M, FAR_M, SIDE_M = 0.55, 0.65, 0.06
STEP = Placement(1.0, np.array([0.0, 0.0, 0.6]))


@pytest.fixture(scope="module")
def step():
    return Renderer(trimesh.util.concatenate([quad(SIDE_M, SIDE_M, -0.05), quad(0.4, 0.3, 0.05)]))


def lost(renderer, R_camera_object, placement, sensor, rng, occluded=False):
    """The pixels that the sensor loses, and those that there were."""
    seen = renderer.depth(CAMERA, R_camera_object, placement) > 0
    sensed = sense(rng, renderer, CAMERA, R_camera_object, placement, sensor, occluded=occluded)
    assert not np.any(sensed.valid & ~seen)
    return seen & ~sensed.valid, seen


# --- exact ----------------------------------------------------------------------------------------------------------


def test_the_default_sensor_is_exact(corner, rng):
    exact_m = corner.depth(CAMERA, R, PLACEMENT)
    for occluded in (False, True):
        sensed = sense(rng, corner, CAMERA, R, PLACEMENT, Sensor(), occluded=occluded)
        assert np.array_equal(sensed.depth_m, exact_m)
        assert sensed.camera == CAMERA


def test_quantisation_rounds_to_whole_steps(corner, rng):
    quantum_m = 0.001
    sensed = sense(rng, corner, CAMERA, R, PLACEMENT, Sensor(), quantum_m)
    steps = sensed.depth_m.astype(float) / quantum_m
    assert np.allclose(steps, np.rint(steps), atol=1e-4)
    assert np.abs(sensed.depth_m - corner.depth(CAMERA, R, PLACEMENT)).max() <= quantum_m / 2 + 1e-7


def test_what_is_out_of_view_cannot_be_sensed(corner, rng):
    with pytest.raises(ReorientError, match="depth is 0 everywhere"):
        sense(rng, corner, CAMERA, R, Placement(0.1, np.array([5.0, 0.0, 0.6])), randomised(0.001))


@pytest.mark.parametrize("noise_m", [0.0, 0.001])
def test_the_same_seed_gives_the_same_bytes(noise_m, corner):
    def bytes_of(seed):
        image = sense(np.random.default_rng(seed), corner, CAMERA, R, PLACEMENT, randomised(noise_m), occluded=True)
        return image.depth_m.tobytes()

    assert bytes_of(1) == bytes_of(1)
    assert bytes_of(1) != bytes_of(2)


# --- the paper's part -----------------------------------------------------------------------------------------------


def test_dropout_loses_its_share_and_changes_no_depth(plate, rng):
    gone, seen = lost(plate, np.eye(3), PLACEMENT, Sensor(dropout=0.05), rng)
    assert gone.sum() / seen.sum() == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / seen.sum()))
    sensed = sense(rng, plate, CAMERA, np.eye(3), PLACEMENT, Sensor(dropout=0.05))
    assert np.allclose(sensed.depth_m[sensed.valid], 0.6)


def width_px(pixels):
    """The least extent of some pixels over all directions, between pixel centres: across a side of their hull."""
    hull = ConvexHull(np.argwhere(pixels))
    return float(-(hull.points @ hull.equations[:, :2].T + hull.equations[:, 2]).min(axis=0).max())


def test_only_the_occluded_image_bears_the_rectangle(corner, rng):
    for _ in range(30):
        gone, _ = lost(corner, R, PLACEMENT, Sensor(rectangle=True), rng, occluded=True)
        assert gone.any()
        gone, _ = lost(corner, R, PLACEMENT, Sensor(rectangle=True), rng)
        assert not gone.any()


def test_the_rectangle_is_thin_whole_and_on_the_object(corner, rng):
    seen = corner.depth(CAMERA.resized(320, 240), R, PLACEMENT) > 0
    (thinnest, thickest), (shortest, _) = (np.array(limits) * 320 / 128 for limits in RECTANGLE_PX)
    widths = []
    for _ in range(25):
        rectangle = thin_rectangle(rng, seen)
        widths.append(width_px(rectangle))
        assert np.any(rectangle & seen)
        assert ndimage.label(rectangle)[1] == 1
        assert rectangle.sum() > 0.3 * thinnest * shortest
    # between pixel centres a strip is up to a pixel's diagonal narrower than it is
    assert max(widths) <= thickest + 1e-9
    assert min(widths) >= thinnest - 1.5
    assert max(widths) - min(widths) > 0.5 * (thickest - thinnest)


# --- noise ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale_px", [0.7, 1.0, 2.0])
def test_noise_has_its_deviation_and_is_smooth_over_its_scale(scale_px, plate, rng):
    errors_m = []
    for _ in range(5):
        sensor = Sensor(noise_m=0.002, noise_scale_px=scale_px)
        errors_m.append(sense(rng, plate, CAMERA, np.eye(3), PLACEMENT, sensor).depth_m[15:105, 20:140] - 0.6)
    error_m = np.array(errors_m, float)
    assert np.all(np.abs(error_m) < 0.02)
    assert error_m.std() == pytest.approx(0.002, rel=0.05)
    assert error_m.mean() == pytest.approx(0, abs=0.0002)
    for neighbour in (error_m[:, 1:] * error_m[:, :-1], error_m[:, :, 1:] * error_m[:, :, :-1]):
        # white noise after a Gaussian of radius s: exp(-d^2 / 4 s^2) at distance d
        assert neighbour.mean() / 0.002**2 == pytest.approx(np.exp(-1 / (4 * scale_px**2)), abs=0.06)


# --- structured light -----------------------------------------------------------------------------------------------


def test_returns_are_lost_at_grazing_incidence_only(rng):
    ball = Renderer(trimesh.creation.icosphere(subdivisions=3))
    _, cosine = ball.depth_and_incidence(CAMERA, R, PLACEMENT)
    gone, seen = lost(ball, R, PLACEMENT, Sensor(grazing_cos=0.3), rng)
    assert np.all(gone[seen & (cosine < 0.3)])
    assert not np.any(gone[cosine > 0.6])
    between = seen & (cosine > 0.3) & (cosine < 0.6)
    assert 0.3 < gone[between].mean() < 0.7


def test_nothing_is_lost_face_on(plate, rng):
    gone, seen = lost(plate, np.eye(3), PLACEMENT, Sensor(grazing_cos=0.3), rng)
    assert seen.any()
    assert not gone.any()


@pytest.mark.parametrize("side", [-1, 1])
def test_a_shadow_lies_on_the_side_away_from_the_projector(side, step, rng):
    offset_m = 0.12
    gone, _ = lost(step, np.eye(3), STEP, Sensor(projector_m=(side * offset_m, 0.0, 0.0)), rng)
    # on the far plate the square's shadow and its image are equally large, offset * (far / near - 1) apart
    width_px = offset_m * (FAR_M / NEAR_M - 1) * CAMERA.fx / FAR_M
    height_px = SIDE_M * CAMERA.fy / NEAR_M
    rows, columns = np.nonzero(gone)
    assert gone.sum() == pytest.approx(width_px * height_px, abs=1.0 * height_px)
    assert np.ptp(rows) + 1 == pytest.approx(height_px, abs=1.5)
    edge_px = CAMERA.cx - side * SIDE_M / 2 * CAMERA.fx / NEAR_M
    assert np.all(side * (columns + 0.5 - edge_px) < 0.6)
    assert np.all(side * (columns + 0.5 - edge_px) > -width_px - 0.6)


def test_a_projector_in_the_cameras_place_casts_no_shadow(step, corner, rng):
    sensor = Sensor(projector_m=(0.0, 0.0, 0.0))
    assert not lost(step, np.eye(3), STEP, sensor, rng)[0].any()
    assert not lost(corner, R, PLACEMENT, sensor, rng)[0].any()


def test_flying_pixels_float_behind_edges_between_the_surfaces(step, rng):
    exact_m = step.depth(CAMERA, np.eye(3), STEP)
    for share in (0.3, 1.0):
        sensed = sense(rng, step, CAMERA, np.eye(3), STEP, Sensor(flying=share))
        assert np.array_equal(sensed.valid, exact_m > 0)
        flown = np.abs(sensed.depth_m - exact_m) > 1e-6
        edge = np.isclose(exact_m, NEAR_M) & (ndimage.maximum_filter(exact_m, 3) > NEAR_M + 0.01)
        outline = (exact_m > 0) & (ndimage.minimum_filter(exact_m, 3, mode="nearest") == 0)
        assert not np.any(flown & ~edge & ~outline)
        assert flown[edge].mean() == pytest.approx(share, abs=0.15)
        assert np.all((sensed.depth_m > NEAR_M)[flown & edge])
        assert np.all((sensed.depth_m < FAR_M)[flown & edge])
        assert np.all((sensed.depth_m - exact_m)[flown & outline] > 0)
        assert np.all((sensed.depth_m - exact_m)[flown & outline] < FLYING_REACH_M)


def test_a_slope_is_no_edge(plate, rng):
    tilted = so3.exp(np.array([0.0, 0.6, 0.0]))
    exact_m = plate.depth(CAMERA, tilted, PLACEMENT)
    sensed = sense(rng, plate, CAMERA, tilted, PLACEMENT, Sensor(flying=1.0))
    inner = ndimage.binary_erosion(exact_m > 0, np.ones((3, 3)))
    assert inner.sum() > 5000
    assert np.array_equal(sensed.depth_m[inner], exact_m[inner])


def test_randomised_adds_structured_light_to_the_papers_part():
    assert randomised() == Sensor(rectangle=True, dropout=0.01)
    rich = randomised(0.001)
    assert (rich.rectangle, rich.dropout, rich.noise_m) == (True, 0.01, 0.001)
    assert rich.projector_m is not None
    assert min(rich.grazing_cos, rich.flying) > 0
