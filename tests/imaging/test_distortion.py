"""Lens distortion is undone as OpenCV and librealsense define it."""

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.imaging import Camera
from reorient.imaging.distortion import Distortion
from reorient.imaging.files import read_depth, read_mask, write_camera

CAMERA = Camera(160, 120, 130.0, 125.0, 83.5, 57.0)
LENSES = {
    "brown": (0.1, -0.2, 0.001, 0.002, 0.05),
    "barrel": (-0.3, 0.1, 0.001, -0.002),
    "rational": (0.5, -2.4, 1e-4, -2e-4, 1.3, 0.4, -2.3, 1.2),
    "prism": (0.1, 0.1, 0.01, 0.01, 0.1, 0.0, 0.0, 0.0, 0.01, 0.02, 0.03, 0.04),
}
EQUIDISTANT = (0.1, -0.05, 0.01, 0.002)


@pytest.fixture
def directions(rng):
    return rng.uniform(-0.7, 0.7, (2, 300))


@pytest.mark.parametrize("lens", LENSES)
def test_brown_conrady_is_that_of_opencv(lens, directions):
    cv2 = pytest.importorskip("cv2")
    points = np.concatenate([directions, np.ones((1, 300))]).T
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(LENSES[lens]))[0][:, 0].T
    assert np.allclose(Distortion("brown", LENSES[lens]).distorted(*directions), expected, atol=1e-12)


def test_fisheye_is_that_of_opencv(directions):
    cv2 = pytest.importorskip("cv2")
    points = np.concatenate([directions, np.ones((1, 300))]).T
    expected = cv2.fisheye.projectPoints(points[None], np.zeros(3), np.zeros(3), np.eye(3), np.array(EQUIDISTANT))[0]
    assert np.allclose(Distortion("fisheye", EQUIDISTANT).distorted(*directions), expected[0].T, atol=1e-12)


def test_an_undistorted_image_is_that_of_opencv(rng):
    """cv2.remap by nearest neighbour rounds to fixed point: a pixel that falls between two may differ."""
    cv2 = pytest.importorskip("cv2")
    image = rng.uniform(0.4, 0.8, (120, 160)).astype(np.float32)
    K = np.array([[CAMERA.fx, 0, CAMERA.cx - 0.5], [0, CAMERA.fy, CAMERA.cy - 0.5], [0, 0, 1]])
    for lens in ("brown", "barrel"):
        maps = cv2.initUndistortRectifyMap(K, np.array(LENSES[lens]), None, K, (160, 120), cv2.CV_32FC1)
        expected = cv2.remap(image, *maps, cv2.INTER_NEAREST, borderValue=np.nan)
        undone = Distortion("brown", LENSES[lens]).undone(image, CAMERA, np.nan)
        assert np.mean((undone == expected) | (np.isnan(undone) & np.isnan(expected))) > 0.98


def test_known_values_of_every_model():
    """By hand from the formulas, so that they are also checked without OpenCV: x = 0.5, y = -0.25, r2 = 0.3125."""
    x, y, r2 = np.array([0.5]), np.array([-0.25]), 0.3125
    k1, k2, p1, p2 = 0.1, -0.2, 0.01, 0.02
    f = 1 + k1 * r2 + k2 * r2**2
    brown = (0.5 * f + 2 * p1 * -0.125 + p2 * (r2 + 0.5), -0.25 * f + p1 * (r2 + 0.125) + 2 * p2 * -0.125)
    assert np.ravel(Distortion("brown", (k1, k2, p1, p2)).distorted(x, y)) == pytest.approx(brown)
    a, b = 0.5 * f, -0.25 * f  # librealsense: the tangential terms at the radially distorted point
    modified = (a + 2 * p1 * a * b + p2 * (r2 + 2 * a * a), b + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b)
    assert np.ravel(Distortion("modified", (k1, k2, p1, p2)).distorted(x, y)) == pytest.approx(modified)
    theta = np.arctan(np.sqrt(r2))
    scale = theta * (1 + k1 * theta**2) / np.sqrt(r2)
    fisheye = Distortion("fisheye", (k1,)).distorted(x, y)
    assert np.ravel(fisheye) == pytest.approx((0.5 * scale, -0.25 * scale))


@pytest.mark.parametrize("model", ["brown", "modified", "fisheye"])
def test_depth_stays_on_its_ray(model):
    """A distorted image of a plane, rendered by intersecting the distorted rays, becomes the plane again."""
    coefficients = EQUIDISTANT if model == "fisheye" else (0.25, -0.05, 0.003, -0.002)
    lens = Distortion(model, coefficients)
    wide = Camera(1280, 960, 900.0, 900.0, 640.0, 480.0)  # a fine pinhole image of the plane, to be distorted
    rays = wide.rays()
    normal = np.array([0.3, -0.2, 1.0])
    plane = 0.6 / (rays @ normal)
    x, y = lens.distorted(rays[..., 0], rays[..., 1])
    column, row = np.floor(x * CAMERA.fx + CAMERA.cx), np.floor(y * CAMERA.fy + CAMERA.cy)
    seen = (column >= 0) & (column < 160) & (row >= 0) & (row < 120)
    distorted = np.full((120, 160), np.nan)
    distorted[row[seen].astype(int), column[seen].astype(int)] = plane[seen]
    undone = lens.undone(distorted, CAMERA, np.nan)
    exact = 0.6 / (CAMERA.rays() @ normal)
    known = np.isfinite(undone)
    assert known.mean() > 0.6
    step = 0.6 * 0.4 / 130  # the plane's change over a pixel
    assert np.abs(undone - exact)[known].max() < 4 * step  # a distorted pixel covers up to three undistorted ones
    assert np.median(np.abs(undone - exact)[known]) < 0.5 * step
    assert np.nanmedian(np.abs(distorted - exact)) > step  # and it was distorted


def test_nothing_folds_back_into_the_image():
    """Beyond the largest radius of the polynomial there is no source: every source is used in one place."""
    lens = Distortion("brown", (-0.5, 0.0, 0.0, 0.0))
    wide = Camera(200, 200, 40.0, 40.0, 100.0, 100.0)
    row, column, inside = lens.source(wide)
    assert 0.02 < inside.mean() < 0.9
    rays = wide.rays()[inside]
    assert np.hypot(rays[:, 0], rays[:, 1]).max() <= np.sqrt(1 / 1.5) + 0.01  # where r (1 - r2 / 2) is largest
    assert np.all(np.sign(column[inside] + 0.5 - 100) == np.sign(rays[:, 0]))
    assert np.all(np.sign(row[inside] + 0.5 - 100) == np.sign(rays[:, 1]))


def test_a_depth_file_and_its_mask_are_undistorted_alike(tmp_path, caplog):
    raw = np.full((120, 160), 600, np.uint16)
    raw[20:50, 100:150] = 800
    raw[70:90, 10:40] = 65535
    np.save(tmp_path / "depth.npy", raw)
    np.save(tmp_path / "no_return.npy", raw == 65535)
    np.save(tmp_path / "mask.npy", raw == 800)
    camera = tmp_path / "camera.json"
    camera.write_text(
        '{"width": 160, "height": 120, "K": [130, 0, 83, 0, 125, 56.5, 0, 0, 1], "D": [-0.3, 0.1, 0.001, -0.002, 0]}'
    )
    image, mask = read_depth(tmp_path / "depth.npy", camera), read_mask(tmp_path / "mask.npy", camera)
    assert "lens distortion of" in caplog.text
    assert np.array_equal(mask, np.isclose(image.depth_m, 0.8))
    assert not np.array_equal(mask, raw == 800)
    assert np.array_equal(image.unknown, read_mask(tmp_path / "no_return.npy", camera))
    write_camera(tmp_path / "plain.json", CAMERA)
    assert np.array_equal(read_mask(tmp_path / "mask.npy", tmp_path / "plain.json"), raw == 800)


def test_coefficients_beyond_a_model_are_refused():
    with pytest.raises(ReorientError, match="expected at most 12 for the model 'brown' .a tilted sensor"):
        Distortion("brown", (0.1,) * 14)
    with pytest.raises(ReorientError, match="expected finite coefficients"):
        Distortion("fisheye", (np.inf,))
    assert not Distortion("brown", (0.0,) * 14)
    assert Distortion("fisheye")  # equidistant even with zeros
