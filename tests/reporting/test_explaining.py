"""The picture of an estimate shows the very points that its evidence counts."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from reorient import load_estimator, so3
from reorient.estimators.base import with_evidence
from reorient.formatting import format_share
from reorient.imaging import DepthImage
from reorient.registration import DepthView
from reorient.reporting import explaining
from reorient.reporting.explaining import CLASSES, classify, picture
from reorient.world.pairs import Pair, sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised


def pair_of(mesh, seed: int, angle_deg: float, world: str = "benchmark") -> Pair:
    angle_rad = np.radians(angle_deg)
    return sample_pair(
        np.random.default_rng(seed), Renderer(mesh), load_world(world), randomised(0.001), angle_rad, angle_rad
    )


def shares(current: DepthImage, goal: DepthImage, estimate) -> dict[str, float]:
    """Of the points of both panels, by class."""
    count = Counter(int(each) for panel in classify(current, goal, estimate) for each in panel.classes)
    return {each.share: count[number] / count.total() for number, each in enumerate(CLASSES)}


@pytest.mark.parametrize("name", ["fast", "gicp", "icp", "swift"])
@pytest.mark.parametrize("scale", [1, 3])
def test_the_points_of_the_picture_are_those_of_the_evidence(name, scale, mesh):
    """Also where the images are so large that the evidence is measured on smaller ones."""
    pair = pair_of(mesh, 2, 40)
    size = 128 * scale
    current, goal = (image.resized(size, size) for image in (pair.current, pair.goal))
    estimate = load_estimator(name).estimate(current, goal)
    for share, value in shares(current, goal, estimate).items():
        assert value == pytest.approx(getattr(estimate.evidence, share), abs=1e-9), share


def test_every_class_appears_where_it_must(mesh):
    """A wrong rotation has violations, an image moved towards the camera only free-space ones, away only occluded."""
    pair = pair_of(mesh, 2, 0)
    view = DepthView(pair.goal)
    for shift_m, full in ((0.0, "inlier_ratio"), (-0.05, "free_space_violation"), (0.05, "occluded")):
        estimate = with_evidence(view, view, np.eye(3), np.array([0.0, 0.0, shift_m]))
        forward, _ = classify(pair.goal, pair.goal, estimate)
        counted = Counter(CLASSES[each].share for each in forward.classes)
        assert counted[full] > 0.9 * counted.total(), shift_m
    aside = with_evidence(view, view, np.eye(3), np.array([0.3, 0.0, 0.0]))
    assert shares(pair.goal, pair.goal, aside)["silhouette_violation"] > 0.9


def test_the_legend_has_the_shares_of_the_evidence(mesh, monkeypatch):
    pair = pair_of(mesh, 2, 40)
    estimate = load_estimator("fast").estimate(pair.current, pair.goal, pair.pivot_m)
    texts = []
    mask = explaining.text_mask
    monkeypatch.setattr(explaining, "text_mask", lambda text, *size: texts.append(text) or mask(text, *size))
    drawn = picture(pair.current, pair.goal, estimate)
    assert texts == [f"{each.label} {format_share(getattr(estimate.evidence, each.share))}" for each in CLASSES]
    colours = {colour for _, colour in drawn.getcolors(drawn.width * drawn.height)}
    assert {each.colour for each in CLASSES} <= colours


def test_a_right_estimate_has_more_points_in_the_colour_of_inliers(mesh):
    """Than the same estimate rotated by another 90 degrees."""
    pair = pair_of(mesh, 2, 40)
    estimate = load_estimator("fast").estimate(pair.current, pair.goal, pair.pivot_m)
    wrong = replace(estimate, R_goal_current=so3.exp(np.array([0.0, 0.0, np.pi / 2])) @ estimate.R_goal_current)
    right, other = (np.array(picture(pair.current, pair.goal, each)) for each in (estimate, wrong))
    green, other_green = (np.all(each == CLASSES[0].colour, axis=-1).sum() for each in (right, other))
    assert green > 2 * other_green


def test_the_colours_can_be_told_apart_without_red_or_green():
    """Viénot, Brettel and Mollon (1999): what a dichromat sees of each pair of colours differs by 40 of 255 or more."""
    rgb = np.array([each.colour for each in CLASSES], float)
    linear = (rgb / 255) ** 2.2
    deuteranope = linear @ np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]]).T
    protanope = linear @ np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]]).T
    for seen in (deuteranope, protanope):
        perceived = 255 * np.clip(seen, 0, 1) ** (1 / 2.2)
        for i in range(len(CLASSES)):
            for j in range(i):
                assert np.abs(perceived[i] - perceived[j]).max() >= 40, (CLASSES[i].label, CLASSES[j].label)
