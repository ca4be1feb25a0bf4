"""Taught tool poses follow the object; direction, units and covariance are checked against a known scene."""

from dataclasses import replace

import numpy as np
import pytest

from reorient import se3, so3, transfer
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.perception.transfer import read_tool_poses, write_tool_poses
from reorient.registration import Evidence

EVIDENCE = Evidence(1.0, 0.0, 0.0, 0.0, 0.0)
RNG = np.random.default_rng(5)
T_BASE_CAMERA, T_CAMERA_GOAL, T_CAMERA_NOW, *TAUGHT = (
    se3.transform(R, t_m) for R, t_m in zip(so3.sample_uniform(RNG, 6), RNG.uniform(-0.5, 0.5, (6, 3)), strict=True)
)


def estimate_of(T: np.ndarray, covariance: np.ndarray | None = None) -> RotationEstimate:
    return RotationEstimate(T[:3, :3], T[:3, 3], EVIDENCE, motion_covariance=covariance)


ESTIMATE = estimate_of(T_CAMERA_GOAL @ se3.inverse(T_CAMERA_NOW))


def relative(T_base_tool: np.ndarray, T_camera_object: np.ndarray) -> np.ndarray:
    """The tool's pose in the object's axes."""
    return se3.inverse(T_BASE_CAMERA @ T_camera_object) @ T_base_tool


def test_the_tool_is_to_the_object_now_as_it_was_to_the_goal():
    result = transfer(ESTIMATE, T_BASE_CAMERA, TAUGHT)
    for now, taught in zip(result.T_base_tool, TAUGHT, strict=True):
        np.testing.assert_allclose(relative(now, T_CAMERA_NOW), relative(taught, T_CAMERA_GOAL), atol=1e-12)
    assert result.covariance is None
    assert result.position_std_m is None
    assert transfer(ESTIMATE, T_BASE_CAMERA, TAUGHT[0]).T_base_tool.shape == (1, 4, 4)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: transfer(estimate_of(se3.inverse(ESTIMATE.T_goal_current)), T_BASE_CAMERA, TAUGHT),
        lambda: transfer(ESTIMATE, se3.inverse(T_BASE_CAMERA), TAUGHT),
        lambda: transfer(ESTIMATE, T_BASE_CAMERA, [se3.inverse(T) for T in TAUGHT]),
        lambda: transfer(replace(ESTIMATE, t_goal_current_m=np.zeros(3)), T_BASE_CAMERA, TAUGHT),
    ],
)
def test_inverse_and_exchanged_transforms_do_not_pass_that_test(wrong):
    now = wrong().T_base_tool[0]
    assert np.abs(relative(now, T_CAMERA_NOW) - relative(TAUGHT[0], T_CAMERA_GOAL)).max() > 0.05


def test_the_covariance_is_that_of_transferred_samples(rng):
    A = rng.normal(size=(6, 6)) * np.repeat([2e-3, 1e-3], 3)[:, None]
    covariance = A @ A.T
    result = transfer(estimate_of(ESTIMATE.T_goal_current, covariance), T_BASE_CAMERA, TAUGHT)
    errors = []
    for d_u in rng.multivariate_normal(np.zeros(6), covariance, 400):
        truth = se3.transform(so3.exp(d_u[:3]), d_u[3:]) @ ESTIMATE.T_goal_current
        true = transfer(estimate_of(truth), T_BASE_CAMERA, TAUGHT).T_base_tool
        R = true[:, :3, :3] @ np.swapaxes(result.T_base_tool[:, :3, :3], 1, 2)
        errors.append(np.concatenate([so3.log(R), true[:, :3, 3] - result.T_base_tool[:, :3, 3]], axis=1))
    for i in range(len(TAUGHT)):
        sampled = np.cov(np.array(errors)[:, i].T)
        scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
        assert np.abs((sampled - result.covariance[i]) / scale).max() < 0.25
        np.testing.assert_allclose(result.position_std_m[i], np.sqrt(np.trace(sampled[3:, 3:])), rtol=0.12)
        np.testing.assert_allclose(result.rotation_std_rad[i], np.sqrt(np.trace(sampled[:3, :3])), rtol=0.12)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((ESTIMATE, np.eye(3), TAUGHT), "T_base_camera of shape"),
        ((ESTIMATE, T_BASE_CAMERA, np.eye(3)), "T_base_tool of shape"),
        ((ESTIMATE, T_BASE_CAMERA * 2, TAUGHT), "no rigid transform"),
        ((ESTIMATE, T_BASE_CAMERA, [se3.transform(np.eye(3), np.array([400.0, 0, 0]))]), "millimetres"),
    ],
)
def test_what_is_no_pose_is_refused(arguments, expected):
    with pytest.raises(ReorientError, match=expected):
        transfer(*arguments)


# --- files ----------------------------------------------------------------------------------------------------------


def test_poses_come_back(tmp_path):
    write_tool_poses(tmp_path / "poses.csv", np.array(TAUGHT))
    np.testing.assert_allclose(read_tool_poses(tmp_path / "poses.csv"), TAUGHT, atol=1e-7)


def rows(arrays: list[np.ndarray]) -> str:
    return "\n".join(",".join(map(str, row)) for row in arrays)


def test_matrices_and_other_orders_are_read(tmp_path):
    path = tmp_path / "poses.csv"
    for text in (
        rows([T.ravel() for T in TAUGHT]),
        rows([T[:3].ravel() for T in TAUGHT]),
        "\n\n".join(rows(list(T)) for T in TAUGHT),
    ):
        path.write_text("# taught\n" + text + "\n")
        np.testing.assert_allclose(read_tool_poses(path), TAUGHT, atol=1e-12)
    w, x, y, z = so3.quat_from_matrix(TAUGHT[0][:3, :3])
    path.write_text(f"qx;qy;qz;qw;x;y;z\n{x};{y};{z};{w};{';'.join(map(str, TAUGHT[0][:3, 3]))}\n")
    np.testing.assert_allclose(read_tool_poses(path), TAUGHT[:1], atol=1e-9)


BROKEN = """
x,y,z,qw,qx,qy,qz
1,2,3
0,0,0,1,0,0,0|1,2
0,0,0,1,0,0,zero
0,0,0,2,0,0,0
0,0,0,nan,0,0,0
400,0,0,1,0,0,0
x,y,z,qw|1,2,3,4
2,0,0,0,0,2,0,0,0,0,2,0
"""


@pytest.mark.parametrize("text", BROKEN.split("\n")[:-1])
def test_broken_files_are_refused_in_one_line(tmp_path, text):
    path = tmp_path / "poses.csv"
    path.write_text(text.replace("|", "\n"))
    with pytest.raises(ReorientError, match="expected") as caught:
        read_tool_poses(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
