"""Isolation of an object in raw frames: what is kept, what is unknown, and what is refused with its cure."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage, Isolation, isolate
from reorient.imaging.files import write_depth
from reorient.imaging.refusals import require_isolated
from reorient.imaging.summary import Summary, pair_warnings
from reorient.world.rendering import Placement, Renderer

CAMERA = Camera(240, 180, 230.0, 230.0, 120.0, 90.0)
R_CAMERA_WORLD = so3.exp(np.radians([130.0, 0.0, 0.0]))  # from 50 degrees above the table
MIDDLE_M = np.array([0.0, 0.0, 0.5])  # where the camera sees the table's origin


def block(low, high):
    return trimesh.creation.box(bounds=[low, high])


TABLE = block((-1.0, -1.0, -0.02), (1.0, 1.0, 0.0))
WALL = block((-1.0, 0.25, 0.0), (1.0, 0.3, 1.0))
PART = trimesh.util.concatenate(
    [block((-0.05, -0.02, 0.0), (0.03, 0.02, 0.05)), block((0.03, -0.02, 0.0), (0.06, 0.05, 0.03))]
)
LOW = block((-0.05, -0.04, 0.0), (0.06, 0.03, 0.006))
FLOATING = PART.copy().apply_translation([0.0, 0.0, 0.05])
FINGER = block((-0.012, -0.09, 0.04), (0.008, -0.06, 0.3))  # before the floating part, from above


def view(*meshes, noise_m=0.0, seed=0):
    """A raw frame of meshes on the table, and the mesh that each pixel shows."""
    mesh = trimesh.util.concatenate(list(meshes))
    placement = Placement(1.0, R_CAMERA_WORLD @ mesh.bounds.mean(axis=0) + MIDDLE_M)
    renderer = Renderer(mesh, every_pixel=True)
    face = renderer.faces(CAMERA, R_CAMERA_WORLD, placement)
    owner = np.repeat(np.arange(len(meshes)), [len(each.faces) for each in meshes])[face]
    depth_m = renderer.depth(CAMERA, R_CAMERA_WORLD, placement)
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(depth_m.shape), 1.0)
    depth_m = np.where(depth_m > 0, depth_m + noise_m * noise / noise.std(), 0).astype(np.float32)
    return DepthImage(depth_m, CAMERA, stamp_s=12.5), np.where(face >= 0, owner, -1)


def box_around(seen, margin):
    rows, columns = np.nonzero(seen)
    left, top = int(columns.min()) - margin, int(rows.min()) - margin
    return left, top, int(columns.max()) + margin + 1 - left, int(rows.max()) + margin + 1 - top


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


def refusal(image, mask=None, **fields):
    """The line that refuses a frame, which must be accepted when touching is allowed."""
    with pytest.raises(ReorientError) as caught:
        isolate(image, mask, **fields)
    assert "\n" not in str(caught.value)
    assert "--allow-touching" in str(caught.value)
    assert isolate(image, mask, **fields, allow_touching=True).valid.any()
    return str(caught.value)


# --- what is kept ---------------------------------------------------------------------------------------------------


def test_box_range_sphere_and_mask_keep_what_satisfies_all():
    image, owner = view(FLOATING)
    seen = owner == 0
    kept = isolate(image, seen, box_px=box_around(seen, 5), near_m=0.1, far_m=2.0, around_m=(0, 0, 0.4), radius_m=0.4)
    assert np.array_equal(kept.valid, seen)
    assert np.array_equal(kept.depth_m, image.depth_m)
    assert (kept.camera, kept.stamp_s) == (image.camera, image.stamp_s)
    columns = np.arange(240)[None] + np.zeros((180, 1))
    middle_m = np.median(image.points(), axis=0)
    limits = {
        "mask": columns < 118,
        "box": columns < 125,
        "range": (image.depth_m >= 0.425) & (image.depth_m <= 0.45),
        "sphere": np.linalg.norm(CAMERA.rays() * image.depth_m[..., None] - middle_m, axis=-1) <= 0.05,
    }
    fields = {"box_px": (-10, -10, 135, 500), "near_m": 0.425, "far_m": 0.45}
    fields |= {"around_m": tuple(middle_m), "radius_m": 0.05, "allow_touching": True}
    expected = seen & np.logical_and.reduce(list(limits.values()))
    kept = isolate(image, limits["mask"], **fields)
    assert all((seen & ~limit).any() for limit in limits.values())
    assert iou(kept.valid, expected) > 0.97  # without specks
    assert not (kept.valid & ~expected).any()


def test_without_options_nothing_changes():
    image, _ = view(FLOATING)
    stray = image.depth_m.copy()
    stray[3, 4] = 1.0
    kept = Isolation()(replace(image, depth_m=stray))
    assert np.array_equal(kept.depth_m, stray)
    assert not kept.unknown.any()
    out_of_range = DepthImage(np.where(image.valid, image.depth_m, np.inf).astype(np.float32), CAMERA)
    assert not Isolation()(out_of_range).unknown.any()


@pytest.mark.parametrize("noise_m", [0.0, 0.001, 0.002])
@pytest.mark.parametrize("mesh", [PART, LOW])
def test_the_plane_is_removed_and_an_object_from_6_mm_height_stays(mesh, noise_m):
    image, owner = view(mesh, TABLE, noise_m=noise_m)
    for fields in ({}, {"box_px": box_around(owner == 0, 15)}):
        assert iou(isolate(image, remove_plane=True, **fields).valid, owner == 0) > (0.9 if noise_m else 0.93)


@pytest.mark.parametrize("height_m", [0.004, 0.006])
def test_low_parts_of_a_higher_object_are_not_removed_with_the_plane(height_m):
    tower, base = block((-0.05, -0.02, 0.0), (-0.01, 0.02, 0.05)), block((-0.01, -0.012, 0.0), (0.07, 0.012, height_m))
    image, owner = view(trimesh.util.concatenate([tower, base]), TABLE, noise_m=0.0012)
    kept = isolate(image, remove_plane=True).valid
    assert np.count_nonzero(kept & (owner == 0)) > 0.95 * np.count_nonzero(owner == 0)
    assert np.count_nonzero(kept & (owner != 0)) < 0.05 * np.count_nonzero(owner == 0)


def test_a_wall_is_removed_with_the_table_and_the_result_is_reproducible():
    image, owner = view(PART, TABLE, WALL, noise_m=0.001)
    kept = isolate(image, remove_plane=True)
    assert iou(kept.valid, owner == 0) > 0.93
    assert np.array_equal(isolate(image, remove_plane=True).depth_m, kept.depth_m)


def test_the_sides_of_an_object_are_no_planes_to_remove():
    image, owner = view(FLOATING)
    assert np.array_equal(isolate(image, remove_plane=True).valid, owner == 0)


def test_what_the_empty_frame_shows_is_removed(tmp_path):
    image, owner = view(FLOATING, TABLE, WALL, FINGER, noise_m=0.0015)
    empty, _ = view(TABLE, WALL, FINGER, noise_m=0.0015, seed=1)
    kept = isolate(image, background=empty)
    assert iou(kept.valid, owner == 0) > 0.95
    write_depth(tmp_path / "empty.npz", empty)
    assert np.array_equal(isolate(image, background=tmp_path / "empty.npz").depth_m, kept.depth_m)
    with pytest.raises(ReorientError, match="no returns differ from the background"):
        isolate(image, background=image)
    with pytest.raises(ReorientError, match="background of shape"):
        isolate(image, background=empty.cropped(0, 0, 100, 100))


def test_an_object_that_a_finger_cuts_stays_whole():
    image, owner = view(FLOATING, FINGER)
    kept = isolate(image, owner == 0)
    assert np.array_equal(kept.valid, owner == 0)
    parted = kept.valid & (np.arange(240) < np.median(np.nonzero(owner == 1)[1]))
    assert 0.1 < parted.sum() / kept.valid.sum() < 0.9  # the finger is in the middle


def test_stray_returns_and_farther_things_are_removed():
    image, owner = view(PART, TABLE, block((0.12, 0.0, 0.0), (0.14, 0.02, 0.03)))
    depth_m = image.depth_m.copy()
    depth_m[10, 10] = 0.2
    kept = isolate(replace(image, depth_m=depth_m), remove_plane=True)
    assert iou(kept.valid, owner == 0) > 0.93


def test_small_pieces_close_to_the_object_belong_to_it_and_others_do_not():
    """Leaves on thin stems that returned nothing: each less than a thirtieth of the object."""
    leaves = [block((0.045, y, 0.05), (0.053, y + 0.008, 0.053)) for y in (-0.02, -0.005, 0.01)]
    far = block((0.045, 0.06, 0.05), (0.053, 0.068, 0.053))
    body = block((-0.05, -0.03, 0.0), (0.038, 0.03, 0.05))
    image, owner = view(body, *leaves, far, TABLE, noise_m=0.001)
    kept = isolate(image, remove_plane=True).valid
    for index in (1, 2, 3):
        assert 8 <= np.count_nonzero(owner == index) < 0.03 * np.count_nonzero(owner == 0)
        assert kept[owner == index].mean() > 0.8
    assert np.count_nonzero(owner == 4) >= 8
    assert not kept[owner == 4].any()


# --- the three states -----------------------------------------------------------------------------------------------


def test_lost_returns_inside_and_beside_the_object_are_unknown_and_background_is_not():
    image, owner = view(FLOATING)
    seen = owner == 0
    rows, columns = np.nonzero(seen)
    row, column = int(np.median(rows)), int(np.median(columns))
    hole = np.zeros_like(seen)
    hole[row - 2 : row + 3, column - 2 : column + 3] = True
    depth_m = np.where(seen, image.depth_m, 1.2).astype(np.float32)  # a far background
    beside = ndimage.binary_dilation(seen, iterations=6) & ~seen & (np.arange(240) < columns.min() + 5)
    elsewhere = np.zeros_like(seen)
    elsewhere[5:9, 5:9] = True
    depth_m[hole | beside | elsewhere] = 0
    kept = isolate(DepthImage(depth_m, CAMERA), far_m=0.8)
    assert np.array_equal(kept.valid, seen & ~hole)
    assert np.array_equal(kept.unknown, hole | beside)
    for missing in (0.0, np.nan, np.inf):  # background out of range
        raw = DepthImage(np.where(seen & ~hole, image.depth_m, missing).astype(np.float32), CAMERA)
        assert np.array_equal(isolate(raw, far_m=0.8).unknown, hole)


def test_a_finger_before_the_object_is_unknown_and_the_table_before_it_is_not():
    image, owner = view(FLOATING, FINGER, TABLE)
    kept = isolate(image, owner == 0)
    finger = owner == 1
    near = ndimage.binary_dilation(owner == 0, iterations=6)
    assert kept.unknown[finger & near].mean() > 0.95
    assert kept.unknown[owner == 2].mean() < 0.02
    standing, owner = view(PART, TABLE)
    assert not isolate(standing, owner == 0).unknown.any()


@pytest.mark.parametrize("way", ["plane", "background"])
def test_a_part_that_is_lost_with_the_table_is_unknown(way):
    """A base lower than what noise lets distinguish from the table, beside a tower: not reported as empty."""
    tower, base = block((-0.05, -0.02, 0.0), (-0.01, 0.02, 0.05)), block((-0.01, -0.012, 0.0), (0.06, 0.012, 0.0018))
    image, owner = view(trimesh.util.concatenate([tower, base]), TABLE, noise_m=0.0018)
    empty, _ = view(TABLE, noise_m=0.0014, seed=1)
    kept = isolate(image, remove_plane=True) if way == "plane" else isolate(image, background=empty)
    lost = (owner == 0) & ~kept.valid
    assert np.count_nonzero(lost) > 100
    assert kept.unknown[lost].mean() > 0.5
    assert np.count_nonzero(kept.unknown & (owner == 1)) < 0.05 * np.count_nonzero(owner == 0)


def test_pixels_of_the_mask_without_return_are_unknown():
    image, owner = view(FLOATING)
    lost = (owner == 0) & (np.arange(240) > np.percentile(np.nonzero(owner == 0)[1], 70))
    kept = isolate(DepthImage(np.where(lost, 0, image.depth_m), CAMERA), owner == 0)
    assert np.array_equal(kept.unknown, lost)


def test_where_a_frame_distinguishes_unknown_from_empty_the_unknown_pixels_stay():
    image, _ = view(FLOATING)
    unknown = np.zeros((180, 240), bool)
    unknown[:40] = True  # reaches the end of the frame, and is more than the object
    assert isolate(replace(image, unknown=unknown & ~image.valid), far_m=0.9).unknown[:10].all()


# --- what is refused ------------------------------------------------------------------------------------------------


def test_a_table_in_the_box_is_refused_and_removing_the_plane_is_the_cure():
    image, owner = view(PART, TABLE, noise_m=0.001)
    with pytest.raises(ReorientError, match="lie on a plane that continues beyond them .*: add --remove-plane"):
        isolate(image, far_m=0.9)
    for fields in ({"box_px": box_around(owner == 0, 20)}, {"box_px": box_around(owner == 0, 3)}):
        assert "--remove-plane" in refusal(image, **fields)


def test_a_table_cut_by_the_depth_range_or_a_sphere_is_refused():
    image, owner = view(PART, TABLE)
    far_m = float(image.depth_m[owner == 0].max()) + 0.01
    assert "lie on a plane that continues beyond them" in refusal(image, far_m=far_m)
    middle_m = tuple(np.median(CAMERA.rays()[owner == 0] * image.depth_m[owner == 0][:, None], axis=0))
    assert "lie on a plane that continues beyond them" in refusal(image, around_m=middle_m, radius_m=0.08)
    assert iou(isolate(image, around_m=middle_m, radius_m=0.12, remove_plane=True).valid, owner == 0) > 0.93


def test_a_gripper_and_an_object_cut_by_the_box_are_refused():
    image, owner = view(FLOATING, block((-0.01, -0.01, 0.09), (0.01, 0.01, 0.4)))
    assert "along" in refusal(image, box_px=box_around(owner == 0, 4))
    left, top, width, height = box_around(owner == 0, 0)
    assert "choose wider limits" in refusal(view(FLOATING)[0], box_px=(left, top, width - 15, height))


def test_two_objects_are_refused():
    image, owner = view(FLOATING, FLOATING.copy().apply_translation([0.16, 0.0, 0.0]), TABLE)
    assert "two objects are left" in refusal(image, remove_plane=True)
    kept = isolate(image, remove_plane=True, box_px=box_around(owner == 0, 5))
    assert iou(kept.valid, owner == 0) > 0.95
    assert isolate(image, remove_plane=True, allow_touching=True).valid[owner == 1].mean() > 0.9


def test_a_plank_under_its_exact_mask_is_accepted_and_a_mask_of_the_table_is_not():
    image, owner = view(LOW, TABLE, noise_m=0.001)
    assert np.array_equal(isolate(image, owner == 0).valid, owner == 0)
    assert "lie on a plane" in refusal(image, ndimage.binary_dilation(owner == 0, iterations=25))


def test_a_mask_of_everything_is_refused():
    image, _ = view(FLOATING)
    with pytest.raises(
        ReorientError, match="the mask covers 100% of the frame: expected non-zero pixels on the object"
    ):
        isolate(image, np.ones((180, 240), bool))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mask": np.ones((96, 72), bool)}, r"mask of shape \(96, 72\): expected \(180, 240\)"),
        ({"mask": np.zeros((180, 240), bool)}, "the mask is empty"),
        ({"box_px": (0, 0, 0, 5)}, "box of 0 x 5 px: expected left, top, width, height"),
        ({"box_px": (0, 0, 5)}, r"box \(0, 0, 5\): expected left, top, width, height in whole pixels"),
        ({"box_px": (0.5, 0, 5, 5)}, "expected left, top, width, height in whole pixels"),
        ({"box_px": (-40, -40, 30, 30)}, "no returns inside the box"),
        ({"near_m": 0.8}, r"no returns in the depth range: depths are 0\.\d\d-0\.\d\d m; --near is 0.8"),
        ({"far_m": 0.1}, r"no returns in the depth range: depths are 0\.\d\d-0\.\d\d m; --far is 0.1"),
        ({"near_m": 0.6, "far_m": 0.5}, "depth range 0.6 to 0.5 m: expected near below far"),
        ({"near_m": -1.0}, "near_m=-1.0: expected metres from 0"),
        ({"far_m": "x"}, "far_m='x': expected metres from 0"),
        ({"near_m": True}, "near_m=True: expected metres from 0"),
        ({"remove_plane": "yes"}, "remove_plane='yes': expected true or false"),
        ({"allow_touching": "no"}, "allow_touching='no': expected true or false"),
        ({"background": 3}, "background=3: expected a DepthImage or the name of its file"),
        ({"radius_m": 0.1}, "a sphere needs its centre and its radius"),
        ({"around_m": (0, 0), "radius_m": 0.1}, "expected x, y, z in camera axes"),
        (
            {"around_m": (0, 0, 2.0), "radius_m": 0.1},
            r"no returns within 0.1 m of \(0.0, 0.0, 2.0\): the nearest is 1\.",
        ),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_invalid_fields_are_refused(arguments, message):
    image, _ = view(FLOATING)
    with pytest.raises(ReorientError, match=message):
        isolate(image, **arguments)


def test_a_whole_scene_is_no_isolated_object():
    image, _ = view(PART, TABLE)
    for refused in (isolate, require_isolated):
        with pytest.raises(ReorientError, match="isolate the object: returns fill 100% of the image"):
            refused(image)


def test_an_object_before_a_far_background_is_in_metres_and_the_background_is_no_object():
    image, owner = view(FLOATING)
    raw = DepthImage(np.where(owner == 0, image.depth_m, 25.0), CAMERA)
    for kept in (isolate(raw, far_m=2.0), isolate(raw, owner == 0)):
        assert np.array_equal(kept.valid, owner == 0)
    with pytest.raises(ReorientError, match=r"the object is at 25 m .*: choose it with --near, --far or --mask"):
        require_isolated(replace(raw, depth_m=np.where(np.arange(180)[:, None] < 70, raw.depth_m, 0)))


def test_a_tight_crop_of_an_object_is_isolated():
    image, owner = view(FLOATING)
    crop = image.cropped(*box_around(owner == 0, 1))
    assert np.array_equal(isolate(crop).depth_m, crop.depth_m)


# --- the summary ----------------------------------------------------------------------------------------------------


def test_the_summary_states_size_distance_and_pixels_and_warns():
    depth_m = np.zeros((180, 240), np.float32)
    depth_m[60:100, 50:120] = 0.46  # 140 x 80 mm
    whole = Summary.of(DepthImage(depth_m, CAMERA))
    np.testing.assert_allclose(whole.size_m, (0.14, 0.08, 0.0), atol=0.004)
    assert str(whole) == "object of 138 x 78 x 0 mm at 0.46 m, 2800 px"
    assert pair_warnings(whole, whole) == []
    (warning,) = pair_warnings(*[replace(whole, size_m=(1.4, 0.8, 0.0), distance_m=4.6)] * 2)
    assert warning.startswith("the object measures 1.6 m at 4.6 m: is the depth scale right? (--depth-scale;")
    depth_m[:, 85:] = 0
    half = Summary.of(DepthImage(depth_m, CAMERA))
    (warning,) = pair_warnings(whole, half)
    assert "is it the same object" in warning
    at_the_end = np.roll(np.roll(depth_m, -60, axis=0), 100, axis=1)
    (warning,) = pair_warnings(half, Summary.of(DepthImage(at_the_end, CAMERA)))
    assert "the object touches the frame of the goal image" in warning
