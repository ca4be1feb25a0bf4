"""Depth images and intrinsics go to disk and come back; what cannot be read is said in one line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.imaging.files import read_camera, read_depth, read_mask, write_camera, write_depth
from reorient.runs.files import replacing


@pytest.fixture
def image(camera, rng):
    depth_m = rng.uniform(0.5, 0.7, (camera.height, camera.width))
    return DepthImage(np.where(rng.random(depth_m.shape) < 0.6, 0, depth_m), camera, stamp_s=1234.5)


def refusal(read, *arguments, **options):
    """The message, which is one line that names a cause."""
    with pytest.raises(ReorientError) as caught:
        read(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert "expected" in message
    return message


# --- there and back -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".npz", ".tif", ".tiff", ".NPZ"])
def test_exact_formats_return_depth_camera_and_stamp(suffix, tmp_path, image):
    path = tmp_path / f"depth{suffix}"
    write_depth(path, image)
    back = read_depth(path)
    assert np.array_equal(back.depth_m, image.depth_m)
    assert back.camera == image.camera
    assert back.stamp_s == image.stamp_s


def test_npy_needs_the_camera_and_returns_the_depth(tmp_path, image):
    path = tmp_path / "depth.npy"
    write_depth(path, image)
    assert np.array_equal(read_depth(path, image.camera).depth_m, image.depth_m)
    assert "missing intrinsics for" in refusal(read_depth, path)


@pytest.mark.parametrize("suffix", [".png", ".npz", ".npy", ".tif"])
def test_unknown_pixels_are_read_back(suffix, tmp_path, image):
    unknown = np.zeros(image.depth_m.shape, bool)
    unknown[20:30, 40:60] = True
    write_depth(tmp_path / f"depth{suffix}", replace(image, unknown=unknown))
    back = read_depth(tmp_path / f"depth{suffix}", image.camera)
    assert np.array_equal(back.unknown, unknown)
    assert np.allclose(back.depth_m, np.where(unknown, 0, image.depth_m), atol=0.0006)


@pytest.mark.parametrize("scale_m", [0.001, 0.0001, 2 / 65535])
def test_png_returns_depth_to_half_a_unit_of_the_scale_it_states(scale_m, tmp_path, image):
    path = tmp_path / "depth.png"
    write_depth(path, image, scale_m)
    back = read_depth(path)
    assert np.abs(back.depth_m - image.depth_m).max() <= 0.5001 * scale_m
    assert back.camera == image.camera
    assert back.stamp_s == image.stamp_s
    with Image.open(path) as picture:
        assert np.asarray(picture).dtype == np.uint16


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_16_bit_files_of_others_are_millimetres(suffix, tmp_path, image):
    path = tmp_path / f"depth{suffix}"
    Image.fromarray(np.rint(image.depth_m * 1000).astype(np.uint16)).save(path)
    assert np.abs(read_depth(path, image.camera).depth_m - image.depth_m).max() <= 0.0005001


def test_a_given_scale_and_camera_override_the_files(tmp_path, image):
    path = tmp_path / "depth.png"
    write_depth(path, image)
    camera = Camera(96, 72, 50.0, 50.0, 48.0, 36.0)
    back = read_depth(path, camera, scale_m=0.002)
    assert np.abs(back.depth_m - 2 * image.depth_m).max() <= 0.001001
    assert back.camera == camera


@pytest.mark.usefixtures("unchecked")
def test_integer_arrays_are_read_at_a_given_scale(tmp_path, image):
    path = tmp_path / "depth.npy"
    np.save(path, np.rint(image.depth_m * 1e4).astype(np.uint16))
    assert np.allclose(read_depth(path, image.camera, scale_m=1e-4).depth_m, image.depth_m, atol=1e-4)
    assert "dtype uint16: expected floating-point metres" in refusal(read_depth, path, image.camera)


# --- intrinsics -----------------------------------------------------------------------------------------------------

SIZE = {"width": 640, "height": 480}
OPEN3D = SIZE | {"intrinsic_matrix": [535.4, 0, 0, 0, 539.2, 0, 320.1, 247.6, 1]}
REALSENSE = SIZE | {"fx": 535.4, "fy": 539.2, "ppx": 320.1, "ppy": 247.6, "model": "brown", "coeffs": [0.0] * 5}


def written(tmp_path, data):
    path = tmp_path / "camera.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return path


@pytest.mark.parametrize("data", [OPEN3D, REALSENSE], ids=["Open3D", "RealSense"])
def test_pixel_centres_of_others_move_by_half_a_pixel(data, tmp_path):
    assert read_camera(written(tmp_path, data)) == Camera(640, 480, 535.4, 539.2, 320.6, 248.1)


def test_our_own_style_comes_back_unchanged(tmp_path, camera):
    path = tmp_path / "camera.json"
    write_camera(path, camera)
    assert read_camera(path) == camera
    assert json.loads(path.read_text())["pixel_centers_at"] == 0.5


@pytest.mark.parametrize(
    ("stated", "cx"), [({}, 320.1), ({"pixel_centers_at": 0.5}, 320.1), ({"pixel_centers_at": 0}, 320.6)]
)
def test_our_own_style_says_where_pixel_centres_are(stated, cx, tmp_path):
    data = SIZE | {"fx": 535.4, "fy": 539.2, "cx": 320.1, "cy": 247.6} | stated
    assert read_camera(written(tmp_path, data)).cx == pytest.approx(cx)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (REALSENSE | {"coeffs": [0.1, 0, 0, 0, 0]}, "has lens distortion .* expected a rectified image"),
        (SIZE | {"fx": 535.4, "fy": 539.2, "cx": 320.0}, "missing intrinsics .*'cy'"),
        (SIZE | {"intrinsic_matrix": [1.0, 2.0]}, "missing intrinsics"),
        (SIZE | {"fx": None, "fy": 1, "cx": 1, "cy": 1}, "missing intrinsics"),
        ({"fx": 535.4, "fy": 539.2, "cx": 320.0, "cy": 240.0}, "missing intrinsics .*'width'"),
        (OPEN3D | {"width": float("inf")}, "missing intrinsics"),
        (OPEN3D | {"width": 0}, "camera of 0 x 480 px"),
        (OPEN3D | {"width": 128.5}, "128.5 x 480 px: expected whole numbers"),
        ([1, 2, 3], "expected a JSON object"),
        (json.dumps(OPEN3D)[:60], "is not JSON"),
        ("", "is not JSON"),
        ("\x89PNG", "is not JSON"),
    ],
)
def test_camera_files_are_refused(data, message, tmp_path):
    with pytest.raises(ReorientError, match=message):
        read_camera(written(tmp_path, data))


# --- what cannot be read --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".png", ".npy", ".npz", ".tif"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_truncated_files_are_refused(suffix, share, tmp_path, image):
    path = tmp_path / f"depth{suffix}"
    write_depth(path, image)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    assert "cannot read depth image" in refusal(read_depth, path, image.camera)


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "1"])
def test_pictures_that_are_no_depth_are_refused(mode, tmp_path, camera):
    path = tmp_path / "photo.png"
    Image.new(mode, (96, 72)).save(path)
    assert f"is a {mode} picture: expected 16-bit depth" in refusal(read_depth, path, camera)


def test_millimetres_are_refused(tmp_path, image):
    path = tmp_path / "depth.npy"
    np.save(path, image.depth_m * 1000)
    assert "looks like millimetres" in refusal(read_depth, path, image.camera)


@pytest.mark.parametrize(
    ("name", "message"),
    [("nowhere.png", "no depth image at"), (".", "is a folder: expected a file"), ("depth.jpg", "one of .png")],
)
def test_missing_and_unknown_files_are_refused(name, message, tmp_path, camera):
    (tmp_path / "depth.jpg").write_bytes(b"")
    assert message in refusal(read_depth, tmp_path / name, camera)


@pytest.mark.parametrize("scale_m", [0.0, -0.001, np.nan, np.inf])
def test_scales_that_are_none_are_refused(scale_m, tmp_path, image):
    path = tmp_path / "depth.png"
    write_depth(path, image)
    assert "metres per unit, above 0" in refusal(read_depth, path, scale_m=scale_m)
    assert "metres per unit, above 0" in refusal(write_depth, path, image, scale_m)


@pytest.mark.parametrize("scale_m", [None, 0.001])
@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((72, 96, 3)), "has shape (72, 96, 3): expected one channel"),
        (np.zeros(5), "has shape (5,): expected one channel"),
        (np.full((72, 96), "a"), "holds no depth"),
        (np.full((72, 96), {}), "cannot read depth image"),
        (np.full((72, 96), 1j), "holds no depth"),
        (np.full((72, 96), True), "holds no depth"),
    ],
    ids=lambda array: f"{array.dtype}{array.shape}" if isinstance(array, np.ndarray) else "",
)
def test_arrays_that_are_no_image_are_refused(array, message, scale_m, tmp_path, camera):
    path = tmp_path / "depth.npy"
    np.save(path, array, allow_pickle=True)
    assert message in refusal(read_depth, path, camera, scale_m=scale_m)


def test_archives_that_hold_something_else_are_refused(tmp_path, camera, image):
    np.savez(tmp_path / "other.npz", v=np.zeros(3), f=np.zeros(3))
    assert "holds v, f: expected an array depth_m" in refusal(read_depth, tmp_path / "other.npz", camera)
    np.savez(tmp_path / "list.npz", depth_m=image.depth_m, stated="[]")
    assert "holds no depth" in refusal(read_depth, tmp_path / "list.npz", camera)
    (tmp_path / "list.npz").rename(tmp_path / "archive.npy")
    assert "holds no depth" in refusal(read_depth, tmp_path / "archive.npy", camera)


def test_masks_are_true_where_not_zero(tmp_path, rng):
    mask = rng.random((72, 96)) < 0.5
    np.save(tmp_path / "mask.npy", mask)
    Image.fromarray(mask.astype(np.uint8) * 255).save(tmp_path / "mask.png")
    for path in (tmp_path / "mask.npy", tmp_path / "mask.png"):
        assert np.array_equal(read_mask(path), mask)
        path.write_bytes(path.read_bytes()[:30])
        assert "cannot read mask" in refusal(read_mask, path)
    assert "no mask at" in refusal(read_mask, tmp_path / "nowhere.png")


@pytest.mark.parametrize(
    ("mode", "value", "suffix"),
    [
        *((mode, value, ".png") for mode, value in (("1", 1), ("L", 1), ("I;16", 256), ("LA", (1, 0)), ("P", 3))),
        *(("RGB", value, ".png") for value in ((1, 0, 0), (0, 0, 4))),
        ("RGBA", (0, 2, 0, 255), ".png"),
        ("F", 0.3, ".tif"),
    ],
)
def test_any_colour_that_is_not_zero_is_the_object(mode, value, suffix, tmp_path):
    """Also where the picture has an alpha channel; what is opaque alone is none."""
    picture = Image.new(mode, (4, 3), (0, 0, 0, 255) if mode == "RGBA" else 0)
    if mode == "P":
        picture.putpalette([0, 0, 0] * 3 + [0, 0, 1])
    picture.putpixel((1, 2), value)
    picture.save(tmp_path / f"mask{suffix}")
    assert np.argwhere(read_mask(tmp_path / f"mask{suffix}")).tolist() == [[2, 1]]


# --- whole or absent ------------------------------------------------------------------------------------------------


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, image):
    path = tmp_path / "depth.png"
    write_depth(path, image)
    before = path.read_bytes()
    assert "does not fit 16 bits" in refusal(write_depth, path, image, 1e-6)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "note.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:  # noqa: PT012 - the block is what is tested
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_places_that_cannot_be_written_are_refused(tmp_path, image):
    assert "expected an existing folder" in refusal(write_depth, tmp_path / "nowhere" / "depth.png", image)
    (tmp_path / "folder.png").mkdir()
    assert "it is a folder, expected a file name" in refusal(write_depth, tmp_path / "folder.png", image)
    assert "cannot write depth as 'depth.jpg': expected one of" in refusal(write_depth, tmp_path / "depth.jpg", image)


def test_millimetres_as_floats_are_refused_and_the_given_scale_explained(tmp_path, image):
    np.save(tmp_path / "depth.npy", image.depth_m * 1000)
    said = refusal(read_depth, tmp_path / "depth.npy", image.camera, scale_m=0.001)
    assert "looks like millimetres" in said
    assert "a scale is for integers, but" in said


def test_a_scale_is_for_integers_only(tmp_path, camera):
    depth_m = np.full((camera.height, camera.width), 0.6, np.float32)
    np.save(tmp_path / "float.npy", depth_m)
    np.save(tmp_path / "integer.npy", (10000 * depth_m).astype(np.uint16))
    for name in ("float.npy", "integer.npy"):
        np.testing.assert_allclose(read_depth(tmp_path / name, camera, scale_m=0.0001).depth_m, 0.6, atol=1e-4)


def test_intrinsic_matrix_by_rows_too(tmp_path):
    flat, rows = [110, 0, 0, 0, 104, 0, 45, 33, 1], [[110, 0, 45], [0, 104, 33], [0, 0, 1]]
    cameras = []
    for matrix in (flat, rows):
        (tmp_path / "camera.json").write_text(json.dumps({"width": 96, "height": 72, "intrinsic_matrix": matrix}))
        cameras.append(read_camera(tmp_path / "camera.json"))
    assert cameras[0] == cameras[1] == Camera(96, 72, 110.0, 104.0, 45.5, 33.5)
    (tmp_path / "camera.json").write_text(json.dumps({"width": 9, "height": 7, "intrinsic_matrix": [1, 2, 0] * 3}))
    with pytest.raises(ReorientError, match="expected .fx 0 0 0 fy 0 cx cy 1"):
        read_camera(tmp_path / "camera.json")
