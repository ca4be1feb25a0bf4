"""A goal from a mesh is right for that object, and unsure for its mirror image and for another one."""

import numpy as np
import pytest

from reorient import Goal, load_estimator, se3, so3
from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.imaging.summary import check_scale
from reorient.world.objects import generated
from reorient.world.pairs import sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised

WORLD = load_world("benchmark")


@pytest.fixture(scope="module")
def pair(mesh):
    return sample_pair(np.random.default_rng(2), Renderer(mesh), WORLD, randomised(0.001), 2.0, 2.5)


def goal_of(mesh, pair, folder, scale_m=None):
    centred = mesh.copy()
    centred.apply_translation(-mesh.bounds.mean(axis=0))
    centred.export(folder / "part.stl")
    T = se3.transform(pair.R_goal_current @ pair.R_camera_object, pair.placement.center_m)
    return Goal.from_mesh(folder / "part.stl", T, WORLD.camera, scale_m or pair.placement.scale_m)


@pytest.mark.slow
def test_a_goal_from_a_mesh_estimates_any_start(mesh, pair, tmp_path):
    estimate = load_estimator().estimate(pair.current, goal_of(mesh, pair, tmp_path))
    assert so3.angle_difference(estimate.R_goal_current, pair.R_goal_current) < np.radians(1.5)
    assert estimate.confidence > 0.9
    center_m = pair.placement.center_m
    assert np.linalg.norm(se3.apply(estimate.T_goal_current, center_m) - center_m) < 0.004


@pytest.mark.slow
def test_a_mirrored_mesh_and_another_object_are_unsure(mesh, pair, tmp_path):
    mirrored = mesh.copy()
    mirrored.apply_transform(np.diag([-1.0, 1.0, 1.0, 1.0]))
    objects = generated(31)
    other = objects.load(objects.names[30])
    radius = np.linalg.norm(other.vertices - other.bounds.mean(axis=0), axis=1).max()
    for wrong, scale_m in ((mirrored, None), (other, WORLD.radius_m / radius)):
        assert load_estimator().estimate(pair.current, goal_of(wrong, pair, tmp_path, scale_m)).confidence < 0.9


@pytest.mark.parametrize(
    ("factor", "expected"),
    [
        (10, "about 10, as of a mesh in cm that is read as mm"),
        (0.1, "about 10, as of a mesh in mm that is read as cm"),
        (25.4, "about 25.4, as of a mesh in in that is read as mm"),
        (1 / 25.4, "about 25.4, as of a mesh in mm that is read as in"),
        (5.0, "expected the same object"),
    ],
)
def test_an_object_of_another_scale_is_refused_with_the_unit(mesh, pair, tmp_path, factor, expected):
    """``factor``: of the object before the camera, relative to the goal."""
    goal, image = goal_of(mesh, pair, tmp_path), pair.current
    check_scale(image, goal)
    scaled = DepthImage(image.depth_m * factor, image.camera)
    with pytest.raises(ReorientError, match=expected):
        check_scale(scaled, goal)
