import base64
import io

import numpy as np
import pytest
import trimesh
from PIL import Image

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.reporting.mesh_pictures import shade_mesh
from reorient.reporting.pictures import (
    BACKGROUND,
    depth_range,
    framed,
    montage,
    png_data_uri,
    shade,
    show_mask,
    write_gif,
)

CAMERA = Camera(64, 64, 150.0, 150.0, 32.0, 32.0)


def plane(normal: tuple[float, float, float], distance_m: float = 0.5) -> DepthImage:
    """A plane through (0, 0, distance), seen in a window that leaves a border without returns."""
    n = np.array(normal)
    depth_m = n[2] * distance_m / (CAMERA.rays() @ n)
    depth_m[:12] = depth_m[-12:] = depth_m[:, :12] = depth_m[:, -12:] = 0
    return DepthImage(depth_m.astype(np.float32), CAMERA)


def brightness(image: DepthImage) -> float:
    return float(np.asarray(shade(image, 64, (0.1, 1.0)), float)[28:36, 28:36].mean())


def test_light_comes_from_above_and_from_the_left():
    above, below = brightness(plane((0.0, -0.7, -1.0))), brightness(plane((0.0, 0.7, -1.0)))
    left, right = brightness(plane((-0.7, 0.0, -1.0))), brightness(plane((0.7, 0.0, -1.0)))
    assert above > 1.05 * left
    assert left > 1.1 * right
    assert right > 1.05 * below


def test_a_depth_edge_does_not_shade_the_surfaces_beside_it():
    depth_m = np.where(np.arange(64) < 32, 0.5, 0.7) * np.ones((64, 1))
    depth_m[:8] = depth_m[-8:] = 0
    pixels = np.asarray(shade(DepthImage(depth_m.astype(np.float32), CAMERA), 64), int)[32]
    assert np.ptp(pixels[20:32], axis=0).max() <= 3
    assert np.ptp(pixels[32:44], axis=0).max() <= 3
    assert np.abs(pixels[31] - pixels[32]).max() > 40  # the tint tells them apart


def test_near_is_warm_and_the_range_makes_pictures_comparable():
    near, far = (np.asarray(shade(plane((0, 0, -1), z), 64, (0.4, 0.8)), int)[32, 32] for z in (0.41, 0.79))
    assert near[0] > near[2] + 30
    assert far[2] > far[0] + 30


@pytest.mark.parametrize("size_px", [48, 96, 300])
def test_picture_is_square_and_dark_where_nothing_returns(camera: Camera, size_px: int):
    depth_m = np.zeros((72, 96), np.float32)
    depth_m[30:50, 60:80] = 0.5
    picture = shade(DepthImage(depth_m, camera), size_px)
    pixels = np.asarray(picture, int)
    assert pixels.shape == (size_px, size_px, 3)
    lit = np.abs(pixels - BACKGROUND).max(axis=2) > 40
    rows, columns = np.nonzero(lit)
    unit = size_px / 96  # 96 columns wide, 12 empty rows above and below
    assert [rows.min() / unit, (rows.max() + 1) / unit] == pytest.approx([42, 62], abs=1.6 / unit + 0.5)
    assert [columns.min() / unit, (columns.max() + 1) / unit] == pytest.approx([60, 80], abs=1.6 / unit + 0.5)
    assert (pixels[0, 0] == BACKGROUND).all()


def test_mesh_stands_upright_by_default():
    plate, mast = trimesh.creation.box((1, 1, 0.2)), trimesh.creation.box((0.1, 0.1, 1.6))
    mast.apply_translation((0, 0, 0.8))
    pixels = np.asarray(shade_mesh(trimesh.util.concatenate([plate, mast]), size_px=96), int)
    rows, _ = np.nonzero(np.abs(pixels - BACKGROUND).max(axis=2) > 40)
    assert rows.mean() > (rows.min() + rows.max()) / 2 + 5
    rotated = np.asarray(shade_mesh(plate, so3.exp(np.array([0.5, 0.0, 0.0])), 96), int)
    assert np.abs(rotated - pixels).mean() > 5


def test_framed_images_of_one_camera_share_a_window_that_keeps_every_return(camera: Camera):
    images = []
    for rows, columns in ((slice(5, 20), slice(40, 50)), (slice(30, 71), slice(60, 80))):
        depth_m = np.zeros((72, 96), np.float32)
        depth_m[rows, columns] = 0.5
        images.append(DepthImage(depth_m, camera))
    other = plane((0, 0, -1))
    *both, alone = framed([*images, other])
    assert both[0].camera == both[1].camera
    assert both[0].camera.width == both[0].camera.height >= 66
    assert alone.camera.width < 60
    for before, after in zip([*images, other], [*both, alone], strict=True):
        np.testing.assert_allclose(after.points(), before.points(), atol=1e-12)


def test_depth_range_leaves_out_the_outermost_percent():
    image = plane((0, 0, -1), 0.5)
    image.depth_m[32, 32] = 3.0
    assert depth_range([image, plane((0, 0, -1), 0.6)]) == pytest.approx((0.5, 0.6))


def test_a_mask_is_green_where_something_returned_and_orange_where_nothing_did():
    depth_m = np.full((60, 80), 0.8, np.float32)
    depth_m[20:40, 30:40], depth_m[20:40, 40:50] = 0.6, 0.0
    mask = np.zeros(depth_m.shape, bool)
    mask[20:40, 30:50] = True
    image = DepthImage(depth_m, Camera(80, 60, 100.0, 100.0, 40.0, 30.0))
    picture = np.asarray(show_mask(image, mask, 120), int)
    assert picture.shape == (120, 120, 3)
    left, right, corner = picture[60, 40], picture[60, 80], picture[3, 3]
    assert left[1] > left[0] + 20
    assert right[0] > right[1] > right[2] + 50
    assert np.ptp(corner) == 0


def test_montage_goes_row_by_row():
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200)]
    pictures = [Image.new("RGB", (64, 40), colour) for colour in colours]
    sheet = montage(pictures, 2, ["a", "b", "c"])
    left, top = 64 + 2, 40 + 21 + 2
    assert sheet.size == (left + 64, top + 21 + 40)
    assert [sheet.getpixel(at) for at in ((5, 25), (left + 5, 25), (5, top + 25))] == colours
    assert sheet.getpixel((left + 5, top + 25)) == BACKGROUND
    assert np.asarray(sheet.crop((20, 0, 44, 21))).max() > 150  # the label
    assert montage(pictures, 5).size == (3 * 64 + 2 * 2, 40)


@pytest.mark.parametrize(
    ("sizes", "columns", "labels", "message"),
    [
        ([], 1, None, "0 pictures, 1 columns"),
        ([8], 0, None, "1 pictures, 0 columns"),
        ([8], 1, [], "0 labels: expected .* a label for each picture"),
        ([8, 9], 2, None, r"sizes .* expected one size"),
    ],
)
def test_montage_refuses(sizes, columns, labels, message):
    with pytest.raises(ReorientError, match=message):
        montage([Image.new("RGB", (size, size)) for size in sizes], columns, labels)


def test_gif_has_every_frame_its_time_and_colours(tmp_path):
    frames = [Image.new("RGB", (40, 30), (30, 90, 200)) for _ in range(7)]
    for index, frame in enumerate(frames):
        frame.paste((220, 40, 10), (5 * index, 0, 5 * index + 5, 30))
    write_gif(tmp_path / "a.gif", frames, 120, 2000)
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]
    with Image.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (7, (40, 30), 0)
        for index, frame in enumerate(frames):
            gif.seek(index)
            assert gif.info["duration"] == (2000 if index == 6 else 120)
            assert np.abs(np.subtract(gif.convert("RGB"), frame, dtype=int)).max() <= 8
    with pytest.raises(ReorientError, match="at least one"):
        write_gif(tmp_path / "b.gif", [], 100, 100)
    with pytest.raises(ReorientError, match="existing folder"):
        write_gif(tmp_path / "none" / "b.gif", frames, 100, 100)


def test_png_data_uri_holds_the_picture():
    picture = shade(plane((0, 0, -1)), 64)
    head, _, data = png_data_uri(picture).partition(",")
    assert head == "data:image/png;base64"
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))), np.asarray(picture))
