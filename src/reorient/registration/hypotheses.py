"""Hypotheses: many rigid motions at once."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """k motions from current to goal, goal's camera axes: p_goal = R p_current + t."""

    R: Float[np.ndarray, "k 3 3"]
    t_m: Float[np.ndarray, "k 3"]

    def __len__(self) -> int:
        return len(self.R)

    def __getitem__(self, chosen: np.ndarray | slice) -> "Hypotheses":
        return Hypotheses(self.R[chosen], self.t_m[chosen])

    def and_also(self, others: "Hypotheses") -> "Hypotheses":
        """These, and others after them."""
        return Hypotheses(np.concatenate([self.R, others.R]), np.concatenate([self.t_m, others.t_m]))

    @property
    def inverse(self) -> "Hypotheses":
        """The motions from goal to current."""
        R = np.ascontiguousarray(np.swapaxes(self.R, 1, 2))
        return Hypotheses(R, -(R @ self.t_m[:, :, None])[:, :, 0])

    def after(self, R_now_then: Float[np.ndarray, "3 3"], t_now_then_m: Float[np.ndarray, "3"]) -> "Hypotheses":
        """The motions from an earlier moment to the goal, through now."""
        return Hypotheses(self.R @ R_now_then, self.R @ t_now_then_m + self.t_m)

    def onto(self, R_goal_view: Float[np.ndarray, "3 3"], t_goal_view_m: Float[np.ndarray, "3"]) -> "Hypotheses":
        """The motions to the pose of another goal view, which ``R_goal_view`` and its translation take to the goal."""
        return Hypotheses(R_goal_view.T @ self.R, (self.t_m - t_goal_view_m) @ R_goal_view)

    def perturbed(
        self, about_m: Float[np.ndarray, "3"], R: Float[np.ndarray, "k 3 3"], shift_m: Float[np.ndarray, "k 3"]
    ) -> "Hypotheses":
        """Rotated about a point and shifted, on the left."""
        t_m = (R @ (self.t_m - about_m)[:, :, None])[:, :, 0] + about_m + shift_m
        return Hypotheses(R @ self.R, t_m)

    def single(self) -> "Hypotheses":
        """In float32, for the kernels that move points."""
        return Hypotheses(self.R.astype(np.float32), self.t_m.astype(np.float32))

    def move(self, points_m: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "k 3 n"]:
        """Points (as columns) under all motions, in one matrix product."""
        return rotate(self.R, points_m, self.t_m)


def rotate(
    R: Float[np.ndarray, "k 3 3"], points_m: Float[np.ndarray, "3 n"], t_m: Float[np.ndarray, "k 3"] | None = None
) -> Float[np.ndarray, "k 3 n"]:
    """Points (as columns) under k rotations, and shifted where translations are given."""
    x: np.ndarray = (R.reshape(-1, 3) @ points_m).reshape(len(R), 3, points_m.shape[1])
    if t_m is not None:
        x += t_m[:, :, None]
    return x
