"""Rigid transforms as (4, 4) matrices, named as rotations are in ``so3``: ``T_a_b`` takes points in b to points in a.

``T_a_c = T_a_b @ T_b_c`` and ``p_a = R_a_b @ p_b + t_a_b_m``. Lengths are in metres.
"""

import numpy as np
from jaxtyping import Float

Transform = Float[np.ndarray, "4 4"]


def transform(R_a_b: Float[np.ndarray, "3 3"], t_a_b_m: Float[np.ndarray, "3"]) -> Transform:
    """The transform T_a_b of a rotation and a translation in metres."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_a_b, t_a_b_m
    return T


def inverse(T_a_b: Transform) -> Transform:
    """The transform T_b_a, by the transpose of the rotation."""
    R_b_a = T_a_b[:3, :3].T
    return transform(R_b_a, -R_b_a @ T_a_b[:3, 3])


def apply(T_a_b: Transform, points_m: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Points given in b, in a. Metres, any leading shape."""
    return np.asarray(points_m @ T_a_b[:3, :3].T + T_a_b[:3, 3])
