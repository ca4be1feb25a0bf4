"""Rotations of an object that show all of its sides to a fixed camera."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from reorient import so3

_TILTS_DEG = (30, 45, 60, 75, 90, 105, 120, 150, 180)  # of the candidates. Not tuned
_AZIMUTHS = 12
_ROUNDS = 3  # of exchanging chosen candidates; more change nothing
_ALL_ROUND = 5  # with fewer views none is tilted by more than 90 degrees, as views must overlap to be aligned
_TILT_COST = 1e-3  # of a candidate's angle: of two that show as much the smaller rotation is taken


def spread_rotations(
    count: int, reachable: Callable[[Float[np.ndarray, "3 3"]], bool] | None = None
) -> list[Float[np.ndarray, "3 3"]]:
    """At most ``count`` rotations (camera axes, left) whose views, with the present one, spread over all directions.

    Of the candidates that are ``reachable`` those are chosen with the smallest mean squared angle from any viewing
    direction to the nearest of theirs; fewer than five are within 90 degrees of the present one. The rotations between
    them are small in their order.
    """
    largest_rad = np.pi if count >= _ALL_ROUND else np.pi / 2
    candidates = [so3.exp(x) for x in _tilts() if np.linalg.norm(x) <= largest_rad + 1e-9]
    candidates = [R for R in candidates if reachable is None or reachable(R)]
    count = min(count, len(candidates))
    if count <= 0:
        return []
    z = np.stack([R.T[:, 2] for R in candidates])  # the viewing directions, in the axes of the present pose
    sphere = so3.grid(400)[:, :, 2]
    away2 = np.arccos(np.clip(sphere @ z.T, -1, 1)) ** 2
    cost = _TILT_COST * np.array([float(so3.angle(R)) for R in candidates])
    present = np.arccos(np.clip(sphere[:, 2], -1, 1)) ** 2
    chosen: list[int] = []
    for k in range(count * _ROUNDS):
        others = chosen if k < count else chosen[1:]  # then each is exchanged in turn
        nearest = np.min(np.concatenate([present[:, None], away2[:, others]], axis=1), axis=1)
        loss = np.minimum(nearest[:, None], away2).mean(axis=0) + cost
        loss[others] = np.inf
        chosen = [*others, int(np.argmin(loss))]
    return _in_order([candidates[i] for i in chosen])


def _tilts() -> Float[np.ndarray, "n 3"]:
    """Rotation vectors about axes across the view: none rolls the object about the optical axis."""
    azimuth = 2 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    axes = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(_AZIMUTHS)], axis=1)
    return np.concatenate([np.radians(tilt) * axes for tilt in _TILTS_DEG])


def _in_order(rotations: list[Float[np.ndarray, "3 3"]]) -> list[Float[np.ndarray, "3 3"]]:
    ordered = [np.eye(3)]
    left = list(rotations)
    while left:
        nearest = int(np.argmin([float(so3.angle_difference(R, ordered[-1])) for R in left]))
        ordered.append(left.pop(nearest))
    return ordered[1:]
