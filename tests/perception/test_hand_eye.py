"""Hand-eye calibration on synthetic motions: exact, with noise, with outliers, degenerate."""

import numpy as np
import pytest

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.perception.hand_eye import Motion, solve_hand_eye


def random_pose(rng):
    return se3.transform(so3.sample_uniform(rng, 1)[0], rng.uniform(-0.5, 0.5, 3))


def motions_of(rng, X, axes, noise_rad=0.0):
    """Motions from a start pose, and between neighbours, about a point 5 cm from the object."""
    center = rng.uniform(-0.4, 0.4, 3)
    poses = [np.eye(4)]
    for w in axes:
        R = so3.exp(w)
        poses.append(se3.transform(R, center - R @ center))
    found = []
    for i in range(len(poses)):
        for j in range(i + 1, len(poses)):
            A = poses[j] @ se3.inverse(poses[i])
            B = se3.inverse(X) @ A @ X
            before = se3.apply(se3.inverse(X), center) + rng.uniform(-0.05, 0.05, 3)
            error = so3.exp(rng.normal(0, noise_rad, 3)) if noise_rad else np.eye(3)
            found.append(Motion(A, error @ B[:3, :3], before, se3.apply(B, before), None, (i, j)))
    return found


AXES = 0.6 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0.6, -0.6, 0.5]])


@pytest.mark.parametrize("seed", range(4))
def test_exact_motions_give_the_exact_pose(seed):
    rng = np.random.default_rng(seed)
    X = random_pose(rng)
    found = solve_hand_eye(motions_of(rng, X, AXES))
    np.testing.assert_allclose(found.T_base_camera, X, atol=1e-6)
    assert found.agree.all()
    assert found.rotation_se_rad < 1e-6


def test_a_third_of_wrong_estimates_does_no_harm(rng):
    X = random_pose(rng)
    motions = motions_of(rng, X, AXES)
    for k in range(0, len(motions), 3):
        motion = motions[k]
        motions[k] = Motion(
            motion.T_after_before, so3.sample_uniform(rng, 1)[0], motion.before_m, motion.before_m, None, motion.images
        )
    found = solve_hand_eye(motions)
    np.testing.assert_allclose(found.T_base_camera, X, atol=1e-5)
    assert not found.agree[::3].any()


@pytest.mark.usefixtures("unchecked")
def test_the_standard_error_is_that_of_repeated_calibrations():
    """Of estimates with independent errors; the jackknife over images is conservative for these."""
    rng = np.random.default_rng(3)
    X = random_pose(rng)
    errors, stated = [], []
    for _ in range(5):
        found = solve_hand_eye(motions_of(rng, X, AXES, noise_rad=np.radians(0.5)))
        errors.append(so3.angle_difference(found.T_base_camera[:3, :3], X[:3, :3]))
        stated.append(found.rotation_se_rad)
    rms = np.sqrt(np.mean(np.square(errors)))
    assert 0.4 * rms < np.mean(stated) < 3 * rms


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (0.6 * np.array([[1, 0, 0], [-1, 0, 0], [0.5, 0, 0], [-0.5, 0, 0]]), "degenerate motions: .* about two axes"),
        (0.6 * np.array([[1, 0, 0], [0, 1, 0]]), "only 3 of 3 estimated motions"),
    ],
)
def test_degenerate_motions_are_refused(rng, axes, message):
    with pytest.raises(ReorientError, match=message):
        solve_hand_eye(motions_of(rng, random_pose(rng), axes))
