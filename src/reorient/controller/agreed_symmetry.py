"""The symmetry of the object that the estimates of a loop agree on."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.estimators.base import RotationEstimate

SAME_RAD = float(np.radians(8))
"""Symmetries of two estimates, or two in turn and a third, that differ by less are one. Not tuned."""
LEAST_SHARE = 0.5
"""Of the estimates that state a symmetry. A single one may miss, or imagine, some. Not tuned."""
ABOUT_RAD = np.radians([40.0, -40.0])
"""An axis is one of revolution if the rotations by these about it are symmetries. Not tuned."""


@dataclass(frozen=True, eq=False)
class AgreedSymmetry:
    """The rotations that are the same to the object."""

    rotations: Float[np.ndarray, "k 3 3"] = field(default_factory=lambda: np.eye(3)[None])
    """S, the goal's camera axes, such that R_goal and S R_goal are the same; the identity first."""
    axis: Float[np.ndarray, "3"] | None = None
    """Every rotation about it is one of them."""

    @classmethod
    def of(cls, estimates: Sequence[RotationEstimate]) -> "AgreedSymmetry":
        """What ``LEAST_SHARE`` of some estimates state, as far as it is a group: two in turn are a symmetry, too."""
        stated = [np.stack([np.eye(3), *x.symmetries]) for x in estimates]
        if all(len(x) == 1 for x in stated):
            return cls()
        found = np.concatenate(stated)
        found = found[so3.non_maximum_suppression(found, np.zeros(len(found)), SAME_RAD)]
        share = np.mean([[_holds(x, R) for R in found] for x in stated], axis=0)
        found, share = found[share >= LEAST_SHARE], share[share >= LEAST_SHARE]
        axes = [x.free_axis for x in estimates if x.free_axis is not None]
        free = [axis for axis in axes if all(_holds(found, R) for R in so3.exp(ABOUT_RAD[:, None] * axis))]
        if free:
            return cls(found, free[-1])
        while not all(_holds(found, R) for R in (found[:, None] @ found).reshape(-1, 3, 3)):
            kept = np.arange(len(found)) != len(found) - 1 - np.argmin(share[::-1])  # without the least stated one
            found, share = found[kept], share[kept]
        return cls(found)

    def nearest(
        self, R: Float[np.ndarray, "n 3 3"], target: Float[np.ndarray, "3 3"]
    ) -> tuple[Float[np.ndarray, "3 3"], float]:
        """Of n rotations and those that are the same, the one nearest to a target, and their difference in radians."""
        same = (self.rotations @ R[:, None]).reshape(-1, 3, 3)
        away_rad = so3.angle_but_about(same @ target.T, self.axis)
        nearest = same[np.argmin(away_rad)]
        if self.axis is not None:
            nearest = so3.exp(-so3.twist_angle(nearest @ target.T, self.axis) * self.axis) @ nearest
        return nearest, float(away_rad.min())


def _holds(rotations: Float[np.ndarray, "k 3 3"], R: Float[np.ndarray, "3 3"]) -> bool:
    return bool(so3.angle_difference(rotations, R).min() <= SAME_RAD)
