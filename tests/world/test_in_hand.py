"""The preset ``in_hand``: losses that move with the object or do not, known or not; static parts, stray returns."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from reorient import so3
from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.world.gripper import grip
from reorient.world.in_hand import Hand, InHand
from reorient.world.losses import LOSSES, Scene, quantised, with_losses, with_stray_returns
from reorient.world.pairs import FEWEST_RETURNS, sample_pair, scene_of, share_on_holes
from reorient.world.rendering import Placement, Renderer, load_world
from reorient.world.sensing import Sensor, randomised
from reorient.world.static_parts import with_static_part

PAGE = Path(__file__).parents[2] / "docs" / "presets.md"
CAMERA = load_world("benchmark").camera
PLACEMENT = Placement(0.08, np.array([0.0, 0.0, 0.6]))


@pytest.fixture(scope="module")
def scene(mesh):
    renderer, poses = Renderer(mesh), (so3.exp(np.array([0.4, -0.7, 0.2])), so3.exp(np.array([0.9, -0.5, 0.6])))
    images = [DepthImage(renderer.depth(CAMERA, R, PLACEMENT), CAMERA) for R in poses]
    return Scene.of(renderer, PLACEMENT, poses, (images[0], images[1]))


NUMBERS = InHand()


def masks_of(scene, name, seed, numbers=NUMBERS):
    rng = np.random.default_rng(seed)
    gripper = grip(rng, scene.renderer, scene.placement, scene.R_camera_object, numbers.hand)
    return LOSSES[name](rng, scene, gripper, numbers)


# --- losses ---------------------------------------------------------------------------------------------------------


def test_losses_remove_returns_and_change_no_other(scene):
    for seed in range(8):
        images = with_losses(np.random.default_rng(seed), scene, InHand(stray=0, quantum_m=(1e-6, 1e-6)))
        for image, whole in zip(images, scene.images, strict=True):
            assert not np.any(image.valid & ~whole.valid)
            assert np.abs(image.depth_m - whole.depth_m)[image.valid].max() < 2e-6
            assert image.valid.sum() >= InHand.least_kept * whole.valid.sum() > image.valid.sum() - whole.valid.sum()


@pytest.mark.parametrize("known", [0, 1])
def test_losses_are_unknown_pixels_or_empty_ones(scene, known):
    numbers = InHand(all_known=known, none_known=1 - known, stray=0)
    images = with_losses(np.random.default_rng(3), scene, numbers)
    for image, whole in zip(images, scene.images, strict=True):
        lost = whole.valid & ~image.valid
        assert lost.sum() > 100
        assert image.unknown[lost].all() if known else not image.unknown.any()


def test_known_and_unmarked_losses_are_the_same_for_a_seed(scene):
    drawn = [
        with_losses(np.random.default_rng(5), scene, InHand(all_known=known, none_known=1 - known)) for known in (0, 1)
    ]
    for zero, known in zip(*drawn, strict=True):
        assert np.array_equal(zero.depth_m, known.depth_m)


@pytest.mark.parametrize("name", ["gripper", "patches"])
def test_gripper_and_patches_move_with_the_object(scene, name):
    """Rotated with the camera about its axis, the whole image rotates with them; other poses show them elsewhere."""
    quarter = so3.exp(np.array([0.0, 0.0, np.pi / 2]))
    poses = scene.R_camera_object[0], quarter @ scene.R_camera_object[0]
    images = [DepthImage(scene.renderer.depth(CAMERA, R, PLACEMENT), CAMERA) for R in poses]
    turned = Scene.of(scene.renderer, PLACEMENT, poses, (images[0], images[1]))
    for seed in range(6):
        first, second = masks_of(turned, name, seed, InHand(margin_px=(0.0, 0.0), patch_radius=(0.3, 0.35)))
        assert first[turned.seen[0]].any() == second[turned.seen[1]].any()
        rotated = np.rot90(first, -1)  # x right, y down: a positive angle is clockwise
        core = ndimage.binary_erosion(rotated, np.ones((3, 3)), iterations=2, border_value=1) & turned.seen[1]
        assert np.mean(second[core]) > 0.95 if core.sum() > 30 else True


def test_fingers_touch_the_object_and_do_not_hide_all_of_it(scene):
    shares = np.array([scene.share(masks_of(scene, "gripper", seed)) for seed in range(40)])
    assert np.mean(shares > 0.02) > 0.6
    assert np.mean(shares) < 0.4


def test_the_forearm_points_at_the_camera_in_neither_pose(scene):
    """It would hide the object: with the rule reversed, more is hidden."""
    allowed, towards = (
        np.mean(
            [scene.share(masks_of(scene, "gripper", seed, InHand(Hand(towards_camera=most)))) for seed in range(25)]
        )
        for most in (-0.5, 1.0)
    )
    assert allowed < towards


def test_holes_take_the_share_that_was_drawn(scene):
    for share in (0.05, 0.2):
        masks = masks_of(scene, "holes", 0, InHand(hole_share=(share, share)))
        assert scene.share(masks) == pytest.approx([share, share], abs=0.01)


def test_a_box_is_the_same_line_in_both_images_and_a_frame_ends_one(scene):
    numbers = InHand(cut_share=(0.3, 0.3))
    box = masks_of(scene, "box", 1, numbers)
    assert np.array_equal(box[0], box[1])
    assert scene.share(box)[0] == pytest.approx(0.3, abs=0.03)
    frame = masks_of(scene, "frame", 1, numbers)
    assert frame.any(axis=(1, 2)).sum() == 1
    assert scene.share(frame).max() == pytest.approx(0.3, abs=0.03)
    outside = frame[frame.any(axis=(1, 2))][0]
    assert outside.all(axis=0).any() or outside.all(axis=1).any()


def test_edges_are_lost_from_the_silhouette_inwards(scene):
    masks = masks_of(scene, "edges", 2)
    for mask, seen in zip(masks, scene.seen, strict=True):
        depth_px = ndimage.distance_transform_edt(seen)
        assert mask.any()
        assert depth_px[mask].max() <= InHand.edge_px[1] + 1


def test_a_shadow_lies_beside_the_silhouette_on_one_side(scene):
    sides = set()
    for seed in range(6):
        masks = masks_of(scene, "shadow", seed)
        for mask, seen in zip(masks, scene.seen, strict=True):
            columns = np.nonzero(mask & ~seen)[1]
            assert len(columns)
            inside = np.nonzero(seen)[1]
            left, right = np.sum(columns < inside.min()), np.sum(columns > inside.max())
            assert min(left, right) == 0
            sides.add(np.sign(right - left))
    assert {-1, 1} <= sides


# --- stray returns, depth steps -------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 5])
def test_stray_returns_are_in_the_background(scene, count, rng):
    image = scene.images[0]
    strayed = with_stray_returns(rng, image, count)
    added = strayed.valid & ~image.valid
    assert added.sum() == count
    assert np.array_equal(strayed.depth_m[image.valid], image.depth_m[image.valid])
    assert np.all((strayed.depth_m[added] >= InHand.stray_m[0]) & (strayed.depth_m[added] <= InHand.stray_m[1]))


def test_depth_is_in_whole_steps(scene):
    steps = quantised(scene.images[0], 0.001).depth_m.astype(float) / 0.001
    assert np.allclose(steps, np.rint(steps), atol=1e-3)


# --- pairs ----------------------------------------------------------------------------------------------------------


def test_pairs_of_the_preset_keep_their_truth(mesh):
    """At the true rotation the surfaces of both images coincide where both have returns."""
    world, renderer = load_world("in_hand"), Renderer(mesh)
    numbers = dataclasses.replace(world.in_hand, stray=0.0)
    residuals = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        pair = sample_pair(rng, renderer, dataclasses.replace(world, in_hand=numbers), randomised(), 0.2, 0.5)
        center_m, camera = pair.placement.center_m, pair.goal.camera
        moved = (pair.current.points() - center_m) @ pair.R_goal_current.T + center_m
        at = np.floor(moved[:, :2] / moved[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]).astype(int)
        at = np.clip(at, 0, 127)
        depth_m = pair.goal.depth_m[at[:, 1], at[:, 0]]
        residuals.append(np.abs(depth_m - moved[:, 2])[depth_m > 0])
        assert min(pair.current.valid.sum(), pair.goal.valid.sum()) >= FEWEST_RETURNS
    assert np.median(np.concatenate(residuals)) < 0.002


def test_the_same_seed_gives_the_same_pair(mesh):
    def pair():
        return sample_pair(np.random.default_rng(4), Renderer(mesh), load_world("in_hand"), randomised(0.001), 0.1, 0.5)

    first, second = pair(), pair()
    for a, b in ((first.current, second.current), (first.goal, second.goal)):
        assert a.depth_m.tobytes() == b.depth_m.tobytes()
        assert np.array_equal(a.unknown, b.unknown)


def test_more_losses_leave_more_points_on_holes(mesh, rng):
    pair = sample_pair(rng, Renderer(mesh), load_world("benchmark"), Sensor(), 0.5, 0.6)
    before = share_on_holes(pair)
    current, goal = scene_of(Renderer(mesh), pair).without(
        {"half": np.broadcast_to(np.arange(128) < 64, (2, 128, 128))}, frozenset()
    )
    assert 0 <= before < share_on_holes(dataclasses.replace(pair, current=current, goal=goal)) <= 1
    same = dataclasses.replace(pair, goal=pair.current, R_goal_current=np.eye(3))
    assert share_on_holes(same) < 0.01


def test_an_object_that_a_gripper_hides_is_refused(scene):
    numbers = InHand(Hand(finger_width=(9.0, 9.0), finger_thickness=(9.0, 9.0)), least_kept=0.9)
    with pytest.raises(ReorientError, match="gripper hides too much"):
        with_losses(np.random.default_rng(0), scene, numbers)


# --- static parts ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["table", "gripper"])
def test_static_parts_are_the_same_in_both_images(mesh, kind):
    world = dataclasses.replace(load_world("in_hand"), in_hand=None)
    pair = sample_pair(np.random.default_rng(1), Renderer(mesh), world, Sensor(), 0.5, 0.6)
    scene = scene_of(Renderer(mesh), pair)
    part = with_static_part(np.random.default_rng(2), scene, kind, (0.15, 0.3))
    assert 0.15 <= part.share <= 0.3
    added = [
        image.valid & (image.depth_m != whole.depth_m) for image, whole in zip(part.images, scene.images, strict=True)
    ]
    shares = [mask.sum() / image.valid.sum() for mask, image in zip(added, part.images, strict=True)]
    assert np.mean(shares) == pytest.approx(part.share, abs=0.01)
    both = added[0] & added[1]
    assert both.sum() > 0.5 * added[0].sum()
    assert np.array_equal(part.images[0].depth_m[both], part.images[1].depth_m[both])


def test_a_share_that_cannot_be_is_refused(scene, rng):
    with pytest.raises(ReorientError, match="expected a smaller object"):
        with_static_part(rng, scene, "gripper", (0.97, 0.98))


# --- the page -------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not PAGE.is_file(), reason="a source distribution has no docs")
def test_the_page_states_every_number():
    lines = PAGE.read_text().splitlines()
    for numbers in (InHand(), InHand().hand):
        for item in dataclasses.fields(numbers):
            value = getattr(numbers, item.name)
            if isinstance(value, Hand):
                continue
            if item.name in LOSSES or item.name == "stray":
                stated = f"{value:.0%} |"
                assert any(stated in line for line in lines), item.name
                continue
            row = next((line for line in lines if f"| `{item.name}` |" in line), "")
            text = "–".join(map(str, value)) if isinstance(value, tuple) else str(value)
            assert re.search(rf"(?<![\d.]){re.escape(text)}(?![\d])", row), f"{item.name}: {text} in {row!r}"


def test_meshes_of_a_single_sheet_can_be_held(rng):
    sheet = trimesh.creation.box((2.0, 1.4, 0.01))
    pair = sample_pair(rng, Renderer(sheet), load_world("in_hand"), randomised(), 0.1, 0.5)
    assert pair.current.valid.sum() >= FEWEST_RETURNS
