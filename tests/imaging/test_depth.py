"""Cameras and depth images: checks, points, crops."""

from dataclasses import astuple

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage


@pytest.fixture
def image(camera, rng):
    """Returns in an ellipse off the middle, every depth different."""
    depth_m = rng.uniform(0.5, 0.7, (camera.height, camera.width)).astype(np.float32)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    outside = ((rows - 40) / 20) ** 2 + ((columns - 35) / 28) ** 2 > 1
    return DepthImage(np.where(outside, np.float32(0), depth_m), camera, stamp_s=12.5)


def rows_of(points):
    return {tuple(point) for point in np.round(points, 9)}


# --- checks ---------------------------------------------------------------------------------------------------------

FLAT = np.full((72, 96), 0.6, np.float32)


def spoilt(value):
    depth_m = FLAT.copy()
    depth_m[3, 4] = value
    return depth_m


@pytest.mark.parametrize(
    ("depth_m", "message"),
    [
        (np.full((72, 96), 600, np.uint16), "dtype uint16: expected floating-point metres"),
        (np.ones((72, 96), bool), "dtype bool: expected floating-point metres"),
        (FLAT.T, r"shape \(96, 72\): expected \(height, width\) = \(72, 96\)"),
        (FLAT[..., None], r"shape \(72, 96, 1\): expected \(height, width\)"),
        (spoilt(-0.1), "as low as -0.1 m: expected no negative value"),
        (0 * FLAT, "0 everywhere: expected returns from the object"),
        (1000 * FLAT, "depths are 600 to 600: this looks like millimetres"),
        (np.nan * FLAT, "0 everywhere: expected returns from the object"),
        ([[0.5], [0.5, 0.6]], r"depth is no image .* expected an array \(height, width\)"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_depth_image_refuses(depth_m, message, camera):
    with pytest.raises(ReorientError, match=message):
        DepthImage(depth_m, camera)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("camera", [None, (110.0, 104.0, 45.25, 33.5)])
def test_depth_image_refuses_missing_intrinsics(camera):
    with pytest.raises(ReorientError, match="missing intrinsics: expected a reorient"):
        DepthImage(FLAT, camera)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("stamp_s", ["now", np.nan])
def test_depth_image_refuses_a_stamp_that_is_no_time(stamp_s, camera):
    with pytest.raises(ReorientError, match="stamp .* expected finite seconds, or None"):
        DepthImage(FLAT, camera, stamp_s)


@pytest.mark.parametrize("no_return", [np.nan, np.inf, -np.inf])
def test_a_pixel_without_return_is_unknown(no_return, camera):
    image = DepthImage(spoilt(no_return), camera)
    assert np.argwhere(image.unknown).tolist() == [[3, 4]]
    assert image.depth_m[3, 4] == 0
    assert np.count_nonzero(image.valid) == FLAT.size - 1
    assert not DepthImage(spoilt(0.0), camera).unknown.any()  # not the object


@pytest.mark.parametrize("value", [1e-40, 1e-5, 1e38, 1e10, 2e3])
def test_a_pixel_beyond_any_range_is_unknown(value, camera):
    image = DepthImage(spoilt(value), camera)
    assert np.argwhere(image.unknown).tolist() == [[3, 4]]
    assert np.isfinite(image.points()).all()
    with pytest.raises(ReorientError, match="depths are .*expected metres"):
        DepthImage(np.full(FLAT.shape, value), camera)  # all of them: another unit


@pytest.mark.parametrize("factor", [1.0, 1000.0])
def test_the_unit_is_that_of_the_nearest_returns(factor, camera):
    """Most of a raw frame may be a far background; two stray returns are no object."""
    depth_m = np.full(FLAT.shape, 25.0 * factor)
    depth_m[3, 4:6] = 0.6
    with pytest.raises(ReorientError, match=r"depths are 0.6 to 2.*: this looks like millimetres"):
        DepthImage(depth_m, camera)
    depth_m[10:20, 10:20] = 0.6 * factor
    if factor == 1:
        assert np.array_equal(DepthImage(depth_m, camera).depth_m, depth_m.astype(np.float32))
    else:
        with pytest.raises(ReorientError, match="this looks like millimetres"):
            DepthImage(depth_m, camera)


def test_a_masked_pixel_is_unknown(camera):
    masked = np.ma.masked_array(FLAT, mask=np.zeros(FLAT.shape, bool))
    masked.mask[3, 4] = True
    for image in (DepthImage(masked, camera), DepthImage.from_uint16((masked * 1000).astype(np.uint16), camera)):
        assert np.argwhere(image.unknown).tolist() == [[3, 4]]


def test_an_unknown_pixel_has_no_depth(camera):
    unknown = np.zeros(FLAT.shape, bool)
    unknown[:, 40:50] = True
    image = DepthImage(spoilt(np.nan), camera, unknown=unknown)
    assert np.count_nonzero(image.unknown) == 721
    assert not image.depth_m[image.unknown].any()
    assert not unknown[3, 4]  # the caller's mask is unchanged


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("unknown", [np.zeros((96, 72), bool), np.zeros((72, 96)), "mask"])
def test_depth_image_refuses_unknown_pixels_that_are_no_mask(unknown, camera):
    with pytest.raises(ReorientError, match="unknown pixels of dtype .* expected booleans"):
        DepthImage(FLAT, camera, unknown=unknown)


def test_cropping_and_resizing_carry_unknown_pixels(camera):
    unknown = np.zeros(FLAT.shape, bool)
    unknown[10:20, 10:20] = True
    image = DepthImage(FLAT, camera, unknown=unknown)
    crop = image.cropped(-5, 4, 30, 30)
    assert crop.unknown[:, :5].all()
    assert crop.unknown[6:16, 15:25].all()
    assert np.count_nonzero(crop.unknown) == 5 * 30 + 100
    assert np.array_equal(image.resized(192, 144).unknown, unknown.repeat(2, axis=0).repeat(2, axis=1))


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_depth_of_any_float_is_kept_as_float32_of_its_own(dtype, camera):
    depth_m = FLAT.astype(dtype)
    image = DepthImage(depth_m, camera)
    depth_m[:] = 0
    assert image.depth_m.dtype == np.float32
    assert np.allclose(image.depth_m, 0.6, atol=1e-3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0, 72, 110.0, 104.0, 45.0, 33.0), "camera of 0 x 72 px: expected whole numbers, 1 to 65535"),
        ((96, -72, 110.0, 104.0, 45.0, 33.0), "camera of 96 x -72 px: expected whole numbers, 1 to 65535"),
        ((96, 72, 0.0, 104.0, 45.0, 33.0), "fx=0.0, .* expected finite pixels, fx, fy > 0"),
        ((96, 72, 110.0, -104.0, 45.0, 33.0), "fy=-104.0, .* expected finite pixels, fx, fy > 0"),
        ((96, 72, 110.0, 104.0, np.nan, 33.0), "cx=nan, .* expected finite pixels"),
        ((96, 72, np.inf, 104.0, 45.0, 33.0), "fx=inf, .* expected finite pixels"),
        ((96, 72, None, 104.0, 45.0, 33.0), "fx=None, .* expected finite pixels"),
        ((96, 72, "110", 104.0, 45.0, 33.0), "fx=110, .* expected finite pixels"),
        ((96, 72, [110.0, 104.0], 104.0, 45.0, 33.0), "expected finite pixels"),
        ((None, 72, 110.0, 104.0, 45.0, 33.0), "camera of None x 72 px: expected whole numbers"),
        ((np.nan, 72, 110.0, 104.0, 45.0, 33.0), "camera of nan x 72 px: expected whole numbers"),
        ((np.inf, 72, 110.0, 104.0, 45.0, 33.0), "camera of inf x 72 px: expected whole numbers"),
        ((70000, 72, 110.0, 104.0, 45.0, 33.0), "camera of 70000 x 72 px: expected whole numbers"),
        ((10**5000, 72, 110.0, 104.0, 45.0, 33.0), "camera of a number of thousands of digits x 72 px: expected whole"),
        ((96, 72, 1e-308, 104.0, 45.0, 33.0), "fx=1e-308, .* expected finite pixels"),
        ((96, 72, 110.0, 1e300, 45.0, 33.0), "fy=1e.300, .* expected finite pixels"),
        ((96, 72, 110.0, 104.0, 45.0, -1e300), "cy=-1e.300: expected finite pixels"),
        ((96, 72.5, 110.0, 104.0, 45.0, 33.0), "camera of 96 x 72.5 px: expected whole numbers"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_camera_refuses(values, message):
    with pytest.raises(ReorientError, match=message):
        Camera(*values)


K = np.array([[110.0, 0.0, 45.0], [0.0, 104.0, 33.0], [0.0, 0.0, 1.0]])


def test_an_intrinsic_matrix_counts_pixel_centres_at_integers():
    """As OpenCV does: K takes a point to (column, row) of the pixel whose centre it hits."""
    camera = Camera.from_K(K, 96, 72)
    assert camera == Camera(96, 72, 110.0, 104.0, 45.5, 33.5)
    assert Camera.from_K(K.astype(int), 96, 72) == camera
    depth_m = np.zeros((72, 96))
    depth_m[7, 20] = 0.5
    [point] = DepthImage(depth_m, camera).points()
    assert np.allclose(K @ point / point[2], [20, 7, 1])


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (K[:2], "intrinsic matrix .* expected .*fx, 0, cx"),
        (K.T, "intrinsic matrix .* expected .*fx, 0, cx"),
        (np.add(K, [[0, 0.1, 0], [0, 0, 0], [0, 0, 0]]), "without skew"),
        (2 * K, "intrinsic matrix .* expected"),
        (np.full((3, 3), "a"), "intrinsic matrix .* expected"),
        (K * [[-1, 1, 1], [1, 1, 1], [1, 1, 1]], "fx=-110.0, .* expected finite pixels, fx, fy > 0"),
        (K * [[1, 1, np.nan], [1, 1, 1], [1, 1, 1]], "cx=nan, .* expected finite pixels"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_intrinsic_matrices_that_are_none_are_refused(matrix, message):
    with pytest.raises(ReorientError, match=message):
        Camera.from_K(matrix, 96, 72)


@pytest.mark.usefixtures("unchecked")
def test_numbers_of_any_type_are_kept_as_plain_ones():
    camera = Camera(np.int64(96), 72.0, *np.array([110.0, 104.0, 45.25, 33.5], np.float32))
    image = DepthImage(FLAT, camera, np.float32(12.5))
    assert [type(x) for x in astuple(camera)] == [int, int, float, float, float, float]
    assert type(image.stamp_s) is float


# --- points ---------------------------------------------------------------------------------------------------------


def test_projected_points_return_to_their_pixel_centres(image):
    rows, columns = np.nonzero(image.valid)
    assert np.allclose(image.camera.project(image.points()), np.column_stack([columns, rows]) + 0.5, atol=1e-9)
    assert np.allclose(image.points()[:, 2], image.depth_m[rows, columns])


def test_pixel_centres_lie_at_a_half(camera):
    depth_m = np.zeros((72, 96))
    depth_m[0, 0] = 0.5
    [point] = DepthImage(depth_m, camera).points()
    assert np.allclose(point, [0.5 * (0.5 - 45.25) / 110, 0.5 * (0.5 - 33.5) / 104, 0.5])


def test_points_behind_the_camera_have_no_pixel(camera):
    assert np.all(np.isnan(camera.project(np.array([[0.0, 0.0, 0.0], [0.1, 0.1, -1.0]]))))


# --- crops and sizes ------------------------------------------------------------------------------------------------


def test_points_of_a_crop_are_those_of_the_window(image):
    crop = image.cropped(10, 25, 40, 20)
    assert crop.depth_m.shape == (20, 40)
    u, v = image.camera.project(image.points()).T
    inside = (u > 10) & (u < 50) & (v > 25) & (v < 45)
    assert 0 < inside.sum() < len(inside)
    assert np.allclose(crop.points(), image.points()[inside])
    assert crop.stamp_s == image.stamp_s


@pytest.mark.parametrize("window", [(-20, -10, 140, 100), (-20, 30, 60, 80), (30, -10, 100, 50)])
def test_a_crop_beyond_the_border_has_no_returns_there(window, image):
    left, top, width, height = window
    crop = image.cropped(*window)
    assert crop.depth_m.shape == (height, width)
    assert rows_of(crop.points()) <= rows_of(image.points())
    padded = np.pad(image.depth_m, 100)
    assert np.array_equal(crop.depth_m, padded[100 + top : 100 + top + height, 100 + left : 100 + left + width])


def test_a_crop_without_returns_is_refused(image):
    for window in ((90, 0, 6, 5), (200, 200, 10, 10)):
        with pytest.raises(ReorientError, match="0 everywhere"):
            image.cropped(*window)


@pytest.mark.parametrize("size", [(48, 36), (96, 72), (60, 100), (192, 144)])
def test_a_resized_image_sees_the_same_points(size, image):
    resized = image.resized(*size)
    assert resized.depth_m.shape == size[::-1]
    assert set(resized.depth_m[resized.valid]) <= set(image.depth_m[image.valid])
    # each point falls into the original pixel that holds its depth; the right one, where it falls between two
    u, v = np.floor(image.camera.project(resized.points()) + 1e-6).astype(int).T
    assert np.allclose(image.depth_m[v, u], resized.points()[:, 2])


def test_resizing_keeps_the_field_of_view(camera):
    half = camera.resized(48, 144)
    corners = np.array([[0.0, 0.0], [96.0, 72.0]])
    for c, (width, height) in ((camera, (96, 72)), (half, (48, 144))):
        x = (corners / (96, 72) * (width, height) - (c.cx, c.cy)) / (c.fx, c.fy)
        assert np.allclose(x, (corners - (45.25, 33.5)) / (110, 104))


def test_a_window_without_size_is_refused(image):
    with pytest.raises(ReorientError, match="camera of -5 x 50 px"):
        image.cropped(10, 10, -5, 50)


def test_raw_units_become_metres_and_no_return_unknown(camera):
    raw = np.full(FLAT.shape, 2400, np.uint16)
    raw[0, 0], raw[0, 1] = 0, 65535
    image = DepthImage.from_uint16(raw, camera, scale_m=0.00025, stamp_s=3.0)
    assert np.argwhere(image.unknown).tolist() == [[0, 0], [0, 1]]
    assert np.allclose(image.depth_m[image.valid], 0.6)
    assert image.stamp_s == 3.0
    assert np.array_equal(DepthImage.from_uint16(raw[:, :, None], camera, 0.00025).depth_m, image.depth_m)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("raw", "scale_m", "message"),
    [(FLAT, 0.001, "raw depth of dtype float32: expected integers"), (FLAT.astype(int), 0, "depth scale 0: expected")],
)
def test_raw_units_are_integers_with_a_scale(raw, scale_m, message, camera):
    with pytest.raises(ReorientError, match=message):
        DepthImage.from_uint16(raw, camera, scale_m)


def test_points_return_the_depth_they_came_from(camera, rng):
    depth_m = np.where(rng.random(FLAT.shape) < 0.2, np.nan, rng.uniform(0.4, 0.8, FLAT.shape))
    points = camera.rays() * depth_m[..., None]
    points[0, 0] = 0
    expected = DepthImage(np.where(points[..., 2] > 0, depth_m, np.nan), camera)
    for given in (points, points.reshape(-1, 3)[::-1], points.astype(np.float32)):
        image = DepthImage.from_points(given, camera)
        assert np.allclose(image.depth_m, expected.depth_m, atol=1e-6)
        assert np.array_equal(image.unknown, expected.unknown)


def test_points_of_other_axes_are_refused(camera):
    points = camera.rays() * 0.6
    for wrong, message in (
        (points * [1, -1, 1], "px .median. from their own pixels: expected camera axes"),
        (points * [1, 1, -1], "none of 6912 points projects"),
        (np.random.default_rng(0).random((72, 96, 3)), "three colours is no depth"),
    ):
        with pytest.raises(ReorientError, match=message):
            DepthImage.from_points(wrong, camera)


class Intrinsic:
    """As open3d.camera.PinholeCameraIntrinsic."""

    width, height, intrinsic_matrix = 96, 72, K


class Tensor:
    """As open3d.t.geometry.Image of one channel."""

    def __init__(self, pixels):
        self.pixels = pixels

    def as_tensor(self):
        return self

    cpu = as_tensor

    def numpy(self):
        return self.pixels[:, :, None]


def test_images_of_open3d():
    raw = np.full(FLAT.shape, 600, np.uint16)
    raw[5, 6] = 0
    for given in (raw, Tensor(raw), (raw / 1000).astype(np.float32)):
        image = DepthImage.from_open3d(given, Intrinsic)
        assert image.camera == Camera(96, 72, 110.0, 104.0, 45.5, 33.5)
        assert np.argwhere(image.unknown).tolist() == [[5, 6]]
        assert np.allclose(image.depth_m[image.valid], 0.6)


class Frame:
    """As pyrealsense2.depth_frame, its own profile and intrinsics."""

    width, height, fx, fy, ppx, ppy, model = 96, 72, 110.0, 104.0, 45.0, 33.0, "distortion.inverse_brown_conrady"
    coeffs = (0.0,) * 5

    @property
    def profile(self):
        return self

    def as_video_stream_profile(self):
        return self

    get_intrinsics = as_video_stream_profile

    def get_data(self):
        raw = np.full((72, 96), 2400, np.uint16)
        raw[5, 6] = 0
        return raw

    def get_units(self):
        return 0.00025

    def get_timestamp(self):
        return 1500.0


def test_frames_of_realsense():
    image = DepthImage.from_realsense(Frame())
    assert image.camera == Camera(96, 72, 110.0, 104.0, 45.5, 33.5)
    assert np.argwhere(image.unknown).tolist() == [[5, 6]]
    assert np.allclose(image.depth_m[image.valid], 0.6)
    assert image.stamp_s == 1.5
    bent = Frame()
    bent.coeffs = (0.3, 0.0, 0.0, 0.0, 0.0)
    assert np.argwhere(DepthImage.from_realsense(bent).unknown).tolist() != [[5, 6]]
    bent.model = "distortion.ftheta"
    with pytest.raises(ReorientError, match="lens distortion .* of model 'distortion.ftheta': expected one of"):
        DepthImage.from_realsense(bent)
