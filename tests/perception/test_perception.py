"""A bench of boxes below two cameras: perception must work for a cell that is not this package's simulated one."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.perception.calibration import Calibration, MountedCamera
from reorient.perception.colour import ColourRange
from reorient.perception.frame import ColorImage, Frame, align
from reorient.perception.recalibration import corrected_calibration
from reorient.perception.segmentation import (
    Box,
    ByColour,
    ByShape,
    crop,
    isolate_object,
    learn_gripper_colour,
    object_mask,
    object_returns,
)
from reorient.world.rendering import Placement, Renderer

DOWN = np.diag([1.0, -1.0, -1.0])
TOOL_M = np.array([0.3, 0.1, 0.2])
GREY, GREEN, BROWN = (70, 70, 72), (40, 160, 60), (160, 140, 115)
TRUE = Calibration(
    MountedCamera(
        Camera(420, 380, 560.0, 560.0, 210.0, 190.0), se3.transform(DOWN, TOOL_M + np.array([0.0, 0.0, 0.6]))
    ),
    MountedCamera(
        Camera(400, 300, 450.0, 450.0, 200.0, 150.0), se3.transform(DOWN, TOOL_M + np.array([0.06, 0.0, 0.62]))
    ),
)


def box(low, high):
    return trimesh.creation.box(bounds=[low, high]).apply_translation(TOOL_M)


GRIPPER = trimesh.util.concatenate(
    [
        box((-0.13, -0.035, -0.03), (-0.05, 0.035, 0.03)),
        box((-0.05, 0.012, -0.008), (0.01, 0.022, 0.008)),
        box((-0.05, -0.022, -0.008), (0.01, -0.012, 0.008)),
    ]
)
OBJECT = trimesh.util.concatenate(
    [box((-0.012, -0.012, -0.02), (0.07, 0.012, 0.02)), box((0.04, -0.05, -0.01), (0.07, 0.05, 0.03))]
)
TABLE = box((-0.5, -0.5, -0.22), (0.5, 0.5, -0.2))


def look(mounted, meshes, colours):
    """Exact depth and flat colours of meshes, and which mesh each pixel shows."""
    mesh = trimesh.util.concatenate(meshes)
    T = mounted.T_camera_world
    placement = Placement(1.0, se3.apply(T, mesh.bounds.mean(axis=0)))
    renderer = Renderer(mesh)
    face = renderer.faces(mounted.camera, T[:3, :3], placement)
    owner = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])[face]
    rgb = np.array(colours, np.uint8)[owner]
    return renderer.depth(mounted.camera, T[:3, :3], placement), rgb, np.where(face >= 0, owner, -1)


def take(holds=True):
    """A frame, and the pixels that show the object."""
    meshes, colours = [TABLE, GRIPPER, *([OBJECT] if holds else [])], [BROWN, GREY, GREEN]
    depth_m, _, owner = look(TRUE.depth, meshes, colours)
    _, rgb, _ = look(TRUE.color, meshes, colours)
    frame = Frame(DepthImage(depth_m, TRUE.depth.camera), ColorImage(rgb, TRUE.color.camera), GRIPPER, TOOL_M)
    return frame, owner == 2


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


def perturbed(mounted, off_m=0.001):
    T = se3.transform(so3.exp(np.radians(0.3) * np.array([0.6, 0.8, 0.0])), off_m * np.array([0.0, 0.6, 0.8]))
    return replace(mounted, T_world_camera=mounted.T_world_camera @ T)


def test_the_gripper_is_removed_by_its_shape():
    frame, truth = take()
    assert iou(object_mask(frame, TRUE, ByShape()), truth) > 0.95


def test_the_gripper_is_removed_by_a_learned_colour():
    empty, _ = take(holds=False)
    frame, truth = take()
    colour = learn_gripper_colour(empty, TRUE)
    assert colour.contains(np.array([GREY], np.uint8)).all()
    assert iou(object_mask(frame, TRUE, ByColour(colour)), truth) > 0.95


def without(frame, lost):
    """The frame with no returns there."""
    return replace(frame, depth=replace(frame.depth, depth_m=np.where(lost, 0, frame.depth.depth_m)))


def both_ways():
    return ByShape(), ByColour(learn_gripper_colour(take(holds=False)[0], TRUE))


def test_where_the_sensor_lost_the_object_the_mask_is_filled_and_the_depth_is_not(rng):
    frame, truth = take()
    _, columns = np.nonzero(truth)
    band = np.zeros_like(truth)
    band[:, columns.max() - 18 : columns.max() - 8] = True  # a shadow across it, and single pixels
    frame = without(frame, truth & (band | (rng.random(truth.shape) < 0.1)))
    for segmentation in both_ways():
        returned = object_returns(frame, TRUE, segmentation)
        mask = object_mask(frame, TRUE, segmentation)
        assert not (returned & ~frame.depth.valid).any()
        np.testing.assert_array_equal(mask & frame.depth.valid, returned)
        assert iou(returned, truth) < 0.85
        assert iou(mask, truth) > 0.95
        image = isolate_object(frame, TRUE, segmentation)
        assert np.isin(image.depth_m, [0, *frame.depth.depth_m[returned]]).all()


def test_only_colour_finds_a_dark_side_and_neither_takes_lost_background_for_the_object():
    frame, truth = take()
    _, columns = np.nonzero(truth)
    beside = np.zeros_like(truth)
    beside[:, columns.max() - 5 :] = True  # the object's end, and the table beyond
    frame = without(frame, beside)
    by_shape, by_colour = both_ways()
    shape, colour = object_mask(replace(frame, color=None), TRUE, by_shape), object_mask(frame, TRUE, by_colour)
    np.testing.assert_array_equal(object_mask(frame, TRUE, by_shape) & truth & beside, colour & truth & beside)
    assert (shape & beside & ~truth).sum() < 0.01 * truth.sum()
    assert (colour & beside & ~truth).sum() < 0.06 * truth.sum()  # a pixel or two around it
    assert (shape & beside & truth).sum() < 0.2 * (beside & truth).sum()
    assert (colour & beside & truth).sum() > 0.6 * (beside & truth).sum()


def test_what_the_gripper_hides_is_no_part_of_the_mask():
    frame, truth = take()
    _, _, owner = look(TRUE.depth, [TABLE, GRIPPER, OBJECT], [BROWN, GREY, GREEN])
    mask = object_mask(without(frame, owner == 1), TRUE, ByShape())  # a black gripper returns nothing
    assert (mask & (owner == 1)).sum() < 0.02 * truth.sum()
    assert iou(mask, truth) > 0.93


def test_parts_that_the_gripper_cuts_off_are_kept_and_specks_are_not():
    frame, truth = take()
    rows, columns = np.nonzero(truth)
    depth_m, far = frame.depth.depth_m.copy(), columns > columns.max() - 8
    cut = np.zeros_like(truth)
    cut[:, columns.max() - 11 : columns.max() - 7] = True
    end = np.zeros_like(truth)
    end[rows[far], columns[far]] = True
    depth_m[cut & truth] = 0.8  # the table shows between
    speck = int(rows.min()) - 12, int(columns.mean())
    depth_m[speck] = 0.6
    mask = object_mask(replace(frame, depth=replace(frame.depth, depth_m=depth_m)), TRUE, ByShape())
    assert mask[end].all()
    assert not mask[speck]


def test_a_perturbed_colour_camera_is_corrected_by_the_empty_gripper():
    wrong = Calibration(TRUE.depth, perturbed(TRUE.color))
    right = corrected_calibration(wrong, take(holds=False)[0])

    def off_px(calibration):
        at_m = [se3.apply(mounted.T_camera_world, TOOL_M) for mounted in (calibration.color, TRUE.color)]
        return float(np.linalg.norm(np.subtract(*(TRUE.color.camera.project(x) for x in at_m))))

    assert off_px(wrong) > 2
    assert off_px(right) < 0.5


def test_a_colour_camera_that_sees_no_gripper_stays_as_it_was():
    elsewhere = replace(TRUE.color, T_world_camera=se3.transform(DOWN, TOOL_M + np.array([4.0, 0.0, 0.6])))
    assert corrected_calibration(Calibration(TRUE.depth, elsewhere), take(holds=False)[0]).color is elsewhere


def test_a_perturbed_depth_camera_is_corrected_by_the_empty_gripper():
    wrong = Calibration(perturbed(TRUE.depth), TRUE.color)
    right = corrected_calibration(wrong, take(holds=False)[0])

    def off_m(calibration):
        T = calibration.depth.T_world_camera
        at_tool_m = se3.apply(T, se3.apply(TRUE.depth.T_camera_world, TOOL_M)) - TOOL_M
        return float(np.linalg.norm(at_tool_m))

    assert off_m(wrong) > 0.0025
    assert off_m(right) < 0.0015
    frame, truth = take()
    assert iou(object_mask(frame, right, ByShape()), truth) > iou(object_mask(frame, wrong, ByShape()), truth)
    assert iou(object_mask(frame, right, ByShape()), truth) > 0.93


def test_colours_are_aligned_and_what_is_hidden_is_unknown():
    frame, _ = take()
    rgb, known = align(frame, TRUE)
    _, expected, owner = look(TRUE.depth, [TABLE, GRIPPER, OBJECT], [BROWN, GREY, GREEN])
    same = np.all(np.abs(rgb.astype(int) - expected) < 30, axis=-1)
    assert same[known].mean() > 0.97
    hidden = ~known & (owner == 0)
    assert hidden.sum() > 300  # of the table, beside the gripper
    assert known[owner == 2].mean() > 0.9


def test_the_object_alone_is_left_in_metres_and_in_its_own_camera():
    frame, truth = take()
    image = isolate_object(frame, TRUE, ByShape())
    assert image.depth_m.shape == (128, 128)
    expected = frame.depth.camera.rays()[truth] * frame.depth.depth_m[truth][:, None]
    np.testing.assert_allclose(image.points().min(axis=0), expected.min(axis=0), atol=0.003)
    np.testing.assert_allclose(image.points().max(axis=0), expected.max(axis=0), atol=0.003)


def test_the_gripper_and_lost_returns_are_unknown_and_the_table_is_not():
    frame, truth = take()
    _, _, owner = look(TRUE.depth, [TABLE, GRIPPER, OBJECT], [BROWN, GREY, GREEN])
    rows, columns = np.nonzero(truth)
    lost = np.zeros_like(truth)
    lost[int(np.median(rows)) - 3 :][:6, columns.max() - 6 : columns.max() + 4] = True  # a dark patch and a shadow

    def shown(mask, image):  # through the window of the isolated image
        scene = replace(frame.depth, depth_m=np.where(mask, 0.6, 0.5).astype(np.float32))
        left, top = scene.camera.cx - 2 * image.camera.cx, scene.camera.cy - 2 * image.camera.cy
        return scene.cropped(round(left), round(top), 256, 256).resized(128, 128).depth_m > 0.55

    for segmentation in both_ways():
        image = isolate_object(without(frame, lost), TRUE, segmentation)
        assert image.unknown[shown((owner == 1) & ~lost, image)].mean() > 0.9
        assert image.unknown[shown(lost, image)].all()
        assert image.unknown[shown((owner == 0) & ~lost, image)].mean() < 0.05


def test_a_crop_is_centred_and_grows_with_the_object():
    camera = Camera(600, 500, 560.0, 560.0, 300.0, 250.0)
    for width, side in ((80, 256), (400, 442)):
        depth_m = np.zeros((500, 600), np.float32)
        depth_m[200:220, 100 : 100 + width] = 0.6
        image = crop(DepthImage(depth_m, camera))
        assert image.camera.fx == pytest.approx(560 * 128 / side, rel=0.01)
        rows, columns = np.nonzero(image.valid)
        assert abs(rows.mean() - 63.5) < 1
        assert abs(columns.mean() - 63.5) < 1


def test_an_empty_segmentation_is_refused():
    frame, _ = take()
    with pytest.raises(ReorientError, match="the segmentation leaves nothing"):
        object_mask(frame, TRUE, ByColour(ColourRange()))
    with pytest.raises(ReorientError, match="the segmentation leaves nothing"):
        object_mask(frame, TRUE, ByShape(margin_m=0.2))


def test_a_cell_out_of_view_is_refused():
    frame, _ = take()
    with pytest.raises(ReorientError, match="no returns in the box around the gripper"):
        object_mask(replace(frame, tool_m=TOOL_M + np.array([0.0, 0.0, 5.0])), TRUE, ByShape())
    with pytest.raises(ReorientError, match="returns where the gripper should be"):
        corrected_calibration(Calibration(perturbed(TRUE.depth, 0.1)), take(holds=False)[0])


def test_where_no_gripper_is_in_view_nothing_is_removed():
    frame, truth = take()
    away = replace(frame, robot=GRIPPER.copy().apply_translation([3.0, 0.0, 0.0]))
    assert iou(object_mask(away, TRUE, ByShape(), Box((0.11, 0.11, 0.11))), truth) < 0.9  # the gripper is in it
    with pytest.raises(ReorientError, match="returns where the gripper should be"):
        corrected_calibration(TRUE, replace(take(holds=False)[0], robot=away.robot))


def test_colour_needs_a_colour_camera():
    frame, _ = take()
    with pytest.raises(ReorientError, match="no colour camera"):
        align(replace(frame, color=None), TRUE)
    with pytest.raises(ReorientError, match="no colour camera"):
        align(frame, Calibration(TRUE.depth))
