"""The alignment problem: observations of the object, the goal, the pivot prior, and the score of hypotheses."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from reorient.registration.depth_view import DepthView
from reorient.registration.evidence import score
from reorient.registration.hypotheses import Hypotheses, rotate
from reorient.registration.pivot import PivotPrior, pivot_prior

PRIOR_COST = 0.01  # of the score, for each unit of the prior's squared Mahalanobis distance
LARGEST_DISTANCE2 = 20.0
FEWEST_POINTS = 50  # of an observation
BOX_POINTS = 100


@dataclass(frozen=True, eq=False)
class Observation:
    """One capture of the object, and how the object moved from then to now."""

    view: DepthView
    R_now_then: Float[np.ndarray, "3 3"]
    t_now_then_m: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be aligned: the observations (the current one first) and the goal, with their prior."""

    observations: tuple[Observation, ...]
    goal: DepthView
    prior: PivotPrior

    @property
    def current(self) -> DepthView:
        """The current view."""
        return self.observations[0].view

    @property
    def diameter_m(self) -> float:
        """Diameter of the object, as far as it is visible."""
        return self.prior.diameter_m

    def only(self, observation: Observation) -> "Problem":
        """The problem with one observation alone."""
        return Problem((observation,), self.goal, self.prior)

    @cached_property
    def without_silhouettes(self) -> "Problem":
        """The problem with all that is not the object unknown in every image."""
        observations = tuple(replace(x, view=x.view.without_silhouette) for x in self.observations)
        return Problem(observations, self.goal.without_silhouette, self.prior)

    @property
    def without_pivot(self) -> "Problem":
        """The problem with guesses in place of a known pivot."""
        return replace(self, prior=pivot_prior(self.current, self.goal, None))

    def of_views(self, current: DepthView, goal: DepthView) -> "Problem":
        """The problem of other views, without history; with this one's pivot, if that is known."""
        prior = pivot_prior(current, goal, self.prior.current_m if self.prior.known else None)
        return Problem((Observation(current, np.eye(3), np.zeros(3)),), goal, prior)

    def first_translations(self, R: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3"]:
        """Translations (metres) to begin with: about a known pivot, else current's returns in place of the goal's.

        That is: the boxes around both share their middle across the view, and their nearest depth.
        """
        if self.prior.known:
            return self.prior.translations(R)
        rotated = rotate(R.astype(np.float32), self.current.sample(BOX_POINTS))
        return np.asarray(_anchor(self.goal.sample(BOX_POINTS)[None]) - _anchor(rotated))

    def start(self, R: Float[np.ndarray, "k 3 3"]) -> Hypotheses:
        """Hypotheses of these rotations with their first translations."""
        return Hypotheses(R, self.first_translations(R))

    def seen_from(self, hypotheses: Hypotheses) -> Iterator[tuple[Observation, Hypotheses]]:
        """Each observation, with the hypotheses as motions from it to the goal."""
        for observation in self.observations:
            yield observation, hypotheses.after(observation.R_now_then, observation.t_now_then_m)

    def image_score(self, hypotheses: Hypotheses, tolerance: float, points: int) -> Float[np.ndarray, " k"]:
        """Mean score over the observations, which share the points; ``tolerance``: relative to the object diameter."""
        total = np.zeros(len(hypotheses))
        for observation, then in self.seen_from(hypotheses):
            total += score(observation.view, self.goal, then, tolerance * self.diameter_m, self.share(points))
        return total / len(self.observations)

    def score(self, hypotheses: Hypotheses, tolerance: float, points: int) -> Float[np.ndarray, " k"]:
        """``image_score`` less the cost of the prior."""
        distance2 = self.prior.mahalanobis2(hypotheses.R, hypotheses.t_m)
        return np.asarray(
            self.image_score(hypotheses, tolerance, points) - PRIOR_COST * np.minimum(distance2, LARGEST_DISTANCE2)
        )

    def share(self, points: int) -> int:
        """Points of each observation, so that several take no longer than one."""
        return max(points // len(self.observations), FEWEST_POINTS)


def _anchor(points_m: Float[np.ndarray, "k 3 n"]) -> Float[np.ndarray, "k 3"]:
    """The middle of the box across the view, and its nearest depth."""
    low, high = points_m.min(axis=2).astype(float), points_m.max(axis=2).astype(float)
    return np.concatenate([(low[:, :2] + high[:, :2]) / 2, low[:, 2:]], axis=1)
