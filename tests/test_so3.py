"""The laws of rotations, quaternions and matrices alike."""

import numpy as np
import pytest
from scipy import stats

from reorient import so3
from reorient.errors import ReorientError

# far from each other and from the identity, so that no law holds by accident
ROTATIONS = so3.sample_uniform(np.random.default_rng(1), 50)
QUATS = so3.quat_from_matrix(ROTATIONS)
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def same_rotation(quat0_wxyz, quat1_wxyz, tolerance_rad=1e-12):
    return bool(np.all(so3.angle_between(quat0_wxyz, quat1_wxyz) < tolerance_rad))


# --- group axioms ---------------------------------------------------------------------------------------------------


def test_products_of_unit_quaternions_are_unit_quaternions():
    products = so3.multiply(QUATS[:, None], QUATS[None])
    assert products.shape == (50, 50, 4)
    assert np.allclose(np.linalg.norm(products, axis=-1), 1, atol=1e-14)


def test_products_of_rotations_are_rotations():
    assert all(so3.is_rotation(R, 1e-12) for R in ROTATIONS @ ROTATIONS[::-1])


def test_identity_changes_nothing_from_either_side():
    assert np.allclose(so3.multiply(QUATS, IDENTITY), QUATS)
    assert np.allclose(so3.multiply(IDENTITY, QUATS), QUATS)
    assert np.allclose(so3.matrix_from_quat(IDENTITY), np.eye(3))


def test_conjugate_is_the_inverse_from_either_side():
    assert np.allclose(so3.multiply(QUATS, so3.conjugate(QUATS)), IDENTITY)
    assert np.allclose(so3.multiply(so3.conjugate(QUATS), QUATS), IDENTITY)
    assert np.allclose(so3.matrix_from_quat(so3.conjugate(QUATS)), np.swapaxes(ROTATIONS, 1, 2))


def test_multiplication_is_associative_but_not_commutative():
    a, b, c = QUATS, QUATS[::-1], np.roll(QUATS, 7, axis=0)
    assert np.allclose(so3.multiply(so3.multiply(a, b), c), so3.multiply(a, so3.multiply(b, c)))
    assert not np.allclose(so3.multiply(a, b), so3.multiply(b, a))


def test_hamilton_product_is_the_matrix_product_in_the_same_order():
    product = so3.matrix_from_quat(so3.multiply(QUATS, QUATS[::-1]))
    assert np.allclose(product, ROTATIONS @ ROTATIONS[::-1])
    assert not np.allclose(product, ROTATIONS[::-1] @ ROTATIONS)


def test_difference_turns_the_second_into_the_first_by_left_multiplication():
    q0, q1 = QUATS, QUATS[::-1]
    assert same_rotation(so3.multiply(so3.difference(q0, q1), q1), q0)
    assert np.allclose(so3.matrix_from_quat(so3.difference(q0, q1)), ROTATIONS @ np.swapaxes(ROTATIONS[::-1], 1, 2))


# --- the direction --------------------------------------------------------------------------------------------------

# By hand: the start takes the object's x, y, z to the camera's y, -x, z (a quarter turn about z). A quarter turn about
# the camera's x takes y to z and z to -y. So the goal takes the object's x, y, z to z, -x, -y: its columns.
START = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURN = np.array([90.0, 0.0, 0.0])  # degrees, camera axes
GOAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
READINGS = {
    "as stated": lambda turn_deg: so3.exp(np.radians(turn_deg)) @ START,
    "inverse": lambda turn_deg: so3.exp(np.radians(turn_deg)).T @ START,
    "right multiplication": lambda turn_deg: START @ so3.exp(np.radians(turn_deg)),
    "degrees for radians": lambda turn_deg: so3.exp(turn_deg) @ START,
}


@pytest.mark.parametrize("reading", READINGS)
def test_direction(reading):
    error_rad = so3.angle_difference(READINGS[reading](TURN), GOAL)
    assert (error_rad < 1e-9) == (reading == "as stated")


def test_direction_of_quaternions_is_that_of_matrices():
    difference = so3.difference(so3.quat_from_matrix(GOAL), so3.quat_from_matrix(START))
    assert np.allclose(so3.canonical(difference), [np.sqrt(0.5), np.sqrt(0.5), 0, 0])
    assert np.allclose(so3.matrix_from_quat(difference), GOAL @ START.T)


# --- conversions and angles -----------------------------------------------------------------------------------------


def test_matrices_and_quaternions_agree():
    assert np.allclose(so3.matrix_from_quat(QUATS), ROTATIONS)
    assert np.all(QUATS[:, 0] >= 0)
    half = np.pi / 6
    about_z = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
    c, s = np.cos(2 * half), np.sin(2 * half)
    assert np.allclose(so3.matrix_from_quat(about_z), [[c, -s, 0], [s, c, 0], [0, 0, 1]])


def test_double_cover():
    assert np.allclose(so3.matrix_from_quat(-QUATS), ROTATIONS)
    assert np.all(so3.angle_between(QUATS, -QUATS) == 0)
    assert np.allclose(so3.canonical(-QUATS), QUATS)
    assert np.allclose(so3.quat_axis(-QUATS), so3.quat_axis(QUATS))
    assert np.allclose(so3.quat_angle(-QUATS), so3.quat_angle(QUATS))


def test_axis_and_angle_rebuild_the_rotation():
    rotvec_rad = so3.quat_axis(QUATS) * so3.quat_angle(QUATS)[:, None]
    assert np.allclose(so3.exp(rotvec_rad), ROTATIONS)
    assert np.array_equal(so3.quat_axis(IDENTITY), [1, 0, 0])


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 1e-8, 1e-3, 1.0, 3.0, np.pi - 1e-9, np.pi])
def test_exp_and_log_undo_each_other(angle_rad, rng):
    rotvec_rad = angle_rad * so3.sample_axes(rng, 20)
    R = so3.exp(rotvec_rad)
    back_rad = so3.log(R)
    assert np.allclose(np.linalg.norm(back_rad, axis=1), angle_rad, rtol=1e-3, atol=1e-15)
    assert np.allclose(so3.exp(back_rad), R, atol=1e-15)
    if angle_rad < np.pi:  # at pi, v and -v are the same rotation
        assert np.allclose(back_rad, rotvec_rad, rtol=1e-3, atol=1e-15)


def test_angle_between_is_the_papers_formula_in_the_middle():
    dot = np.abs(np.sum(QUATS * QUATS[::-1], axis=1))
    middle = (dot > 0.1) & (dot < 0.9)
    assert middle.sum() > 20
    assert np.allclose(so3.angle_between(QUATS, QUATS[::-1])[middle], 2 * np.arccos(dot[middle]), atol=1e-12)
    assert np.allclose(so3.angle_difference(ROTATIONS, ROTATIONS[::-1]), so3.angle_between(QUATS, QUATS[::-1]))


@pytest.mark.parametrize("angle_rad", [1e-9, 1e-6, np.pi - 1e-9])
def test_angle_between_keeps_its_digits_at_the_ends(angle_rad):
    turn = np.array([np.cos(angle_rad / 2), np.sin(angle_rad / 2), 0.0, 0.0])
    measured_rad = so3.angle_between(so3.multiply(turn, QUATS), QUATS)
    assert np.allclose(measured_rad, angle_rad, rtol=1e-6)
    assert np.allclose(so3.quat_angle(turn), angle_rad, rtol=1e-9)


def test_rotations_broadcast_against_one():
    assert so3.angle_difference(ROTATIONS, ROTATIONS[0]).shape == (50,)
    assert so3.multiply(QUATS.reshape(5, 10, 4), QUATS[0]).shape == (5, 10, 4)


# --- interpolation --------------------------------------------------------------------------------------------------


def test_slerp_starts_at_one_end_and_stops_at_the_other():
    assert same_rotation(so3.slerp(QUATS, QUATS[::-1], 0.0), QUATS)
    assert same_rotation(so3.slerp(QUATS, QUATS[::-1], 1.0), QUATS[::-1])


@pytest.mark.parametrize("t", [0.1, 0.5, 0.9])
def test_slerp_has_constant_speed_along_the_shorter_arc(t):
    whole_rad = so3.angle_between(QUATS, QUATS[::-1])
    for end in (QUATS[::-1], -QUATS[::-1]):
        between = so3.slerp(QUATS, end, t)
        assert np.allclose(so3.angle_between(QUATS, between), t * whole_rad)
        assert np.allclose(so3.angle_between(between, end), (1 - t) * whole_rad)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-12, 1e-9, 1e-7, 1e-5])
def test_slerp_of_near_equal_rotations_is_finite_and_between(angle_rad):
    end = so3.multiply(so3.quat_from_matrix(so3.exp(np.array([0.0, angle_rad, 0.0]))), QUATS)
    half = so3.slerp(QUATS, end, 0.5)
    assert np.allclose(so3.angle_between(QUATS, half), angle_rad / 2, rtol=1e-3, atol=1e-15)


def test_twist_leaves_the_smallest_angle(rng):
    for R, axis in zip(so3.sample_uniform(rng, 20), so3.sample_axes(rng, 20), strict=True):
        left = so3.angle(so3.exp(-so3.twist_angle(R, axis) * axis) @ R)
        angles = so3.angle(so3.exp(np.linspace(-np.pi, np.pi, 361)[:, None] * axis) @ R)
        assert left <= angles.min() + 1e-9
        assert left == pytest.approx(angles.min(), abs=0.02)
        assert so3.angle_but_about(R, axis) == pytest.approx(left)
        assert so3.angle_but_about(R, None) == so3.angle(R)


def test_mean_of_opposite_errors_is_the_truth(rng):
    errors_rad = rng.normal(0, 0.2, (20, 3))
    R = so3.exp(np.concatenate([errors_rad, -errors_rad])) @ ROTATIONS[0]
    assert so3.angle_difference(so3.mean(R), ROTATIONS[0]) < 1e-9


def test_mean_heeds_the_weights():
    R = np.stack([ROTATIONS[0], so3.exp(np.array([0.0, 0.0, 0.3])) @ ROTATIONS[0]])
    assert so3.angle_difference(so3.mean(R, np.array([0.0, 1.0])), R[1]) < 1e-9
    even, uneven = so3.mean(R), so3.mean(R, np.array([3.0, 1.0]))
    assert so3.angle_difference(even, R[0]) == pytest.approx(0.15)
    assert 0 < so3.angle_difference(uneven, R[0]) < 0.15


# --- sampling and grids ---------------------------------------------------------------------------------------------


def test_bounded_samples_have_the_four_properties_of_the_paper(rng):
    quats = so3.sample_bounded(rng, 5000, 0.0, np.pi / 6)
    real, imaginary = quats[:, 0], quats[:, 1:]
    assert np.allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-14)
    assert np.all(real > 0)
    assert np.all(real[:, None] > np.abs(imaginary))
    assert np.all(real >= np.cos(np.pi / 12) - 1e-15)


def test_bounded_samples_have_uniform_angles_and_axes(rng):
    low_rad, high_rad = 0.3, 2.5
    quats = so3.sample_bounded(rng, 5000, low_rad, high_rad)
    angles_rad, axes = so3.quat_angle(quats), so3.quat_axis(quats)
    assert stats.kstest(angles_rad, stats.uniform(low_rad, high_rad - low_rad).cdf).pvalue > 0.01
    assert np.all(np.abs(axes.mean(axis=0)) < 0.03)
    # each coordinate of a uniform direction is uniform (Archimedes)
    assert all(stats.kstest(axis, stats.uniform(-1, 2).cdf).pvalue > 0.01 for axis in axes.T)


def test_uniform_samples_have_the_angles_of_so3(rng):
    R = so3.sample_uniform(rng, 5000)

    def share_below(angle_rad):  # of the density (1 - cos) / pi
        return (angle_rad - np.sin(angle_rad)) / np.pi

    assert stats.kstest(so3.angle(R), share_below).pvalue > 0.01
    assert stats.kstest(so3.angle_difference(R, ROTATIONS[0]), share_below).pvalue > 0.01
    assert np.all(np.abs(R.mean(axis=0)) < 0.03)


def test_samplers_repeat_with_their_generator():
    for sample in (so3.sample_uniform, so3.sample_axes, lambda rng, n: so3.sample_bounded(rng, n, 0.0, 1.0)):
        assert np.array_equal(sample(np.random.default_rng(4), 5), sample(np.random.default_rng(4), 5))


def angles_to_rad(R, grid):
    """The angles from each rotation to all of the grid, nearest first."""
    trace = np.einsum("nij,mij->nm", R, grid)
    return np.arccos(np.clip((np.sort(trace, axis=1)[:, ::-1] - 1) / 2, -1, 1))


@pytest.mark.parametrize("n", [500, 3000])
def test_grid_leaves_no_gaps_and_is_even(n, rng):
    grid = so3.grid(n)
    assert grid.shape == (n, 3, 3)
    # a ball of radius a holds (a - sin a) / pi of SO(3): this one, the share of one grid point
    spacing_rad = (6 * np.pi / n) ** (1 / 3)
    assert angles_to_rad(so3.sample_uniform(rng, 400), grid)[:, 0].max() < 1.5 * spacing_rad
    neighbour_rad = angles_to_rad(grid[::5], grid)[:, 1]
    random_rad = angles_to_rad(so3.sample_uniform(rng, 100), so3.sample_uniform(rng, n))[:, 0]
    assert neighbour_rad.std() < 0.15 * neighbour_rad.mean()
    assert random_rad.std() > 0.25 * random_rad.mean()


# --- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("array", "is_one"),
    [
        (ROTATIONS[0], True),
        (np.eye(3), True),
        (-np.eye(3), False),
        (np.diag([1.0, 1.0, -1.0]), False),
        (1.01 * np.eye(3), False),
        (np.full((3, 3), np.nan), False),
        (np.eye(4), False),
        (ROTATIONS, False),
    ],
)
def test_is_rotation(array, is_one):
    assert so3.is_rotation(array) == is_one


@pytest.mark.parametrize("quat", [[0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0], [np.inf, 0.0, 0.0, 1.0]])
def test_normalize_refuses_what_has_no_direction(quat):
    with pytest.raises(ReorientError, match="quaternion has zero or non-finite norm"):
        so3.normalize(np.array(quat))


@pytest.mark.parametrize(("low_rad", "high_rad"), [(-0.1, 1.0), (1.0, 0.5), (0.0, 30.0), (np.nan, 1.0)])
def test_bounded_sampling_refuses_no_range_of_angles(low_rad, high_rad, rng):
    with pytest.raises(ReorientError, match=r"angle range .* expected 0 <= low <= high <= pi"):
        so3.sample_bounded(rng, 1, low_rad, high_rad)


# --- sets of rotations ----------------------------------------------------------------------------------------------


def test_suppression_keeps_the_best_of_every_neighbourhood(rng):
    R, score, radius_rad = so3.sample_uniform(rng, 400), rng.random(400), 0.8
    kept = so3.non_maximum_suppression(R, score, radius_rad)
    assert 10 < len(kept) < 400
    assert np.all(np.diff(score[kept]) < 0)
    apart_rad = so3.angle_difference(R[kept][:, None], R[kept])[~np.eye(len(kept), dtype=bool)]
    assert apart_rad.min() > radius_rad - 1e-3
    for i in set(range(400)) - set(kept.tolist()):  # each of the others is near one that is better
        near = so3.angle_difference(R[kept], R[i]) < radius_rad + 1e-3
        assert score[kept][near].max() > score[i]


def test_suppression_of_equal_scores_keeps_the_first_and_at_most_so_many(rng):
    R = np.repeat(so3.grid(6), 2, axis=0)
    assert so3.non_maximum_suppression(R, np.zeros(12), 0.1).tolist() == [0, 2, 4, 6, 8, 10]
    assert so3.non_maximum_suppression(R, np.arange(12.0), 0.1, most=2).tolist() == [11, 9]
    assert so3.non_maximum_suppression(R[:0], np.zeros(0), 0.1).tolist() == []
