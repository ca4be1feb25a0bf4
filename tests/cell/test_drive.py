import numpy as np
import pytest

from reorient import so3
from reorient.stations.cell.drive import Drive, Errors, Load

LOAD = Load(0.15, np.array([0.0, 0.0, 0.05]), 0.03)
GOAL_RAD = np.array([-1.0, -0.9, 0.9, 0.1, 1.7, 1.0, 2.0])


def drive(arm, errors, zero_rad=0.0, load=LOAD):
    zeros = np.full(len(arm.joints), zero_rad)
    return Drive(arm, arm.home_rad, 0.01, load, errors, zeros, np.random.default_rng(0))


def test_without_errors_the_encoders_say_the_truth_and_gravity_sags_the_servos(arm):
    exact = drive(arm, Errors(0.0, 0.0, 0.0))
    exact.move(GOAL_RAD)
    np.testing.assert_allclose(exact.read(), exact.true_joints(), atol=2e-6)
    np.testing.assert_allclose(exact.true_tcp(), arm.tcp(exact.read()), atol=1e-5)
    sag = np.abs(exact.read() - GOAL_RAD).max()
    assert 1e-5 < sag < 5e-3


def test_encoders_do_not_see_the_backlash_or_their_zeros(arm):
    errors = Errors(backlash_rad=0.002, encoder_zero_rad=0.0, encoder_noise_rad=0.0)
    real = drive(arm, errors, zero_rad=0.004)
    real.move(GOAL_RAD)
    off = real.true_joints() - (real.read() - 0.004)
    assert np.abs(off).max() < 0.0018  # half the play, and a little more under load
    assert np.abs(off).max() > 0.0008
    assert np.abs(real.read() - GOAL_RAD).max() < 5e-3  # what is driven there is the reading


def test_no_joint_is_faster_than_it_can(arm):
    real = drive(arm, Errors())
    begin_s = real.time_s
    real.move(GOAL_RAD)
    needed_s = np.max(np.abs(GOAL_RAD - arm.home_rad) / arm.speed_rad_s)
    assert real.time_s - begin_s > needed_s


@pytest.mark.parametrize("slip_nm", [None, 1.0, 0.01])
def test_only_a_weak_grip_slips_and_about_the_line_between_the_fingertips(arm, slip_nm):
    real = drive(arm, Errors(slip_nm=slip_nm), load=Load(0.15, np.array([0.05, 0.0, 0.0]), 0.03))
    real.move(GOAL_RAD)
    slipped = so3.log(real.true_tcp()[:3, :3].T @ real.true_held()[:3, :3])
    if slip_nm == 0.01:
        assert abs(slipped[1]) > np.radians(1)
        np.testing.assert_allclose(slipped[[0, 2]], 0, atol=1e-6)
    else:
        assert np.linalg.norm(slipped) < np.radians(0.2)


def test_the_same_seed_makes_the_same_motion(arm):
    readings = []
    for _ in range(2):
        real = drive(arm, Errors())
        real.move(GOAL_RAD)
        readings.append(real.read())
    np.testing.assert_array_equal(*readings)
