"""Whether an arm of known kinematics reaches a pose within its joint limits."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.se3 import Transform
from reorient.stations.arms.supervised import StraightPath, apart

MARGIN_RAD = 0.05  # from a joint's limit. Not tuned
STEP_RAD = 0.05  # angle of the tool between two poses of the path that are solved
STEP_M = 0.01
_ITERATIONS = 20
_DAMPING = 1e-4  # of the least-squares step: small beside the squared singular values away from singular poses
_LARGEST_STEP_RAD = 0.4  # of a joint between two poses of the path: more is a singular pose
_SOLVED = 1e-5  # metres and radians

Joints = Float[np.ndarray, " n"]


def joint_limits(urdf: str, count: int) -> tuple[Joints, Joints]:
    """The lowest and the highest angles of the first ``count`` revolute joints of a URDF, rad."""
    joints = [joint for joint in ElementTree.fromstring(urdf).iter("joint") if joint.get("type") == "revolute"]
    limits = [limit for joint in joints[:count] if (limit := joint.find("limit")) is not None]
    low, high = (np.array([float(limit.get(name, "nan")) for limit in limits]) for name in ("lower", "upper"))
    return low, high


def follows(
    path: StraightPath,
    q: Joints,
    limits: tuple[Joints, Joints],
    pose_of: Callable[[Joints], Transform],
    jacobian_of: Callable[[Joints], Float[np.ndarray, "6 n"]],
) -> bool:
    """Whether joints that start at ``q`` follow a path of the tool within their limits, by the shortest steps.

    ``pose_of``: T_base_tool of joint angles. ``jacobian_of``: velocities of the tool (linear, then angular, base axes)
    by those of the joints. A redundant arm may choose other angles than these.
    """
    distance_m, angle_deg = apart(path.T_start, path.T_end)
    steps = int(np.ceil(max(np.radians(angle_deg) / STEP_RAD, distance_m / STEP_M, 1)))
    for k in range(1, steps + 1):
        goal = path.along(k / steps)
        before, q = q, _solved(goal, q, pose_of, jacobian_of)
        low, high = limits
        if not np.all((q > low + MARGIN_RAD) & (q < high - MARGIN_RAD)) or np.abs(q - before).max() > _LARGEST_STEP_RAD:
            return False
        if np.abs(_away(goal, pose_of(q))).max() > 100 * _SOLVED:
            return False
    return True


def _solved(
    goal: Transform,
    q: Joints,
    pose_of: Callable[[Joints], Transform],
    jacobian_of: Callable[[Joints], Float[np.ndarray, "6 n"]],
) -> Joints:
    """Joint angles of a pose, near ``q``: damped least squares."""
    for _ in range(_ITERATIONS):
        error = _away(goal, pose_of(q))
        if np.abs(error).max() < _SOLVED:
            break
        J = jacobian_of(q)
        q = q + J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), error)
    return q


def _away(goal: Transform, T: Transform) -> Float[np.ndarray, "6"]:
    """The twist from T to the goal: metres and radians, base axes."""
    return np.concatenate([goal[:3, 3] - T[:3, 3], so3.log(goal[:3, :3] @ T[:3, :3].T)])
