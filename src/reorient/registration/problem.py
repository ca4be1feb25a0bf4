"""The alignment problem: views of the object now, views of the goal, the pivot prior, and the score of hypotheses.

Both sides have one structure: a first view, and further ones with the known motion from their pose to the first's.
Every view now is compared with every goal view. What the pairs say adds up over the goal views: each shows another part
of the object, and a pair that shares no surface says nothing, as its points are occluded.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.registration.depth_view import DepthView, Warped
from reorient.registration.evidence import Evidence, evidence_of, score, warp_both
from reorient.registration.hypotheses import Hypotheses, rotate
from reorient.registration.pivot import PivotPrior, pivot_prior

PRIOR_COST = 0.01  # of the score, for each unit of the prior's squared Mahalanobis distance
LARGEST_DISTANCE2 = 20.0
FEWEST_POINTS = 50  # of an image in a pair
BOX_POINTS = 100
NEAR_RAD = float(np.radians(10))
"""Of 50 tuning objects with six goal views, polished 1 / 5 / 10 / 15 degrees from one: with that view alone the median
error is 0.26 / 0.33 / 0.35 / 0.41 degrees, with all views 0.36 / 0.34 / 0.40 / 0.43."""


@dataclass(frozen=True, eq=False)
class PosedView:
    """A view, and the motion of the object from its pose to that of the first view: p_first = R p_view + t."""

    view: DepthView
    R_first_view: Float[np.ndarray, "3 3"]
    t_first_view_m: Float[np.ndarray, "3"]

    @classmethod
    def first(cls, view: DepthView) -> "PosedView":
        """The first view itself."""
        return cls(view, np.eye(3), np.zeros(3))

    def of(self, view: DepthView) -> "PosedView":
        """Another view of the same pose."""
        return replace(self, view=view)

    @property
    def points_m(self) -> Float[np.ndarray, "m 3"]:
        """All returns, in the pose of the first view (camera axes, metres)."""
        return np.asarray(self.view.points_m.astype(float) @ self.R_first_view.T + self.t_first_view_m)


@dataclass(frozen=True, eq=False)
class ViewPair:
    """A view of the object now and a goal view, with the hypotheses as motions from the one to the other."""

    now: PosedView
    goal: PosedView
    motions: Hypotheses


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be aligned, and the prior of its first views."""

    views_now: tuple[PosedView, ...]
    """The current view first."""
    goal_views: tuple[PosedView, ...]
    """The primary view first."""
    prior: PivotPrior

    @classmethod
    def of(
        cls, views_now: tuple[PosedView, ...], goal_views: tuple[PosedView, ...], pivot_m: Float[np.ndarray, "3"] | None
    ) -> "Problem":
        """The problem of these views, with a rotation centre (camera axes) or None."""
        diameter_m = max(x.view.diameter_m for x in (views_now[0], *goal_views))
        prior = pivot_prior(views_now[0].view, goal_views[0].view, pivot_m, diameter_m)
        return cls(views_now, goal_views, prior)

    @property
    def current(self) -> DepthView:
        """The current view."""
        return self.views_now[0].view

    @property
    def goal(self) -> DepthView:
        """The primary goal view."""
        return self.goal_views[0].view

    @property
    def diameter_m(self) -> float:
        """Diameter of the object, as far as it is visible."""
        return self.prior.diameter_m

    def each_pair(self, hypotheses: Hypotheses) -> Iterator[tuple["Problem", Hypotheses]]:
        """The problem of each pair of views alone, with the hypotheses as motions between them."""
        for pair in self.pairs(hypotheses):
            yield self.of_views((PosedView.first(pair.now.view),), (PosedView.first(pair.goal.view),)), pair.motions

    @cached_property
    def without_silhouettes(self) -> "Problem":
        """The problem with all that is not the object unknown in every image."""
        now, goal = (tuple(x.of(x.view.without_silhouette) for x in side) for side in (self.views_now, self.goal_views))
        return replace(self, views_now=now, goal_views=goal)

    @property
    def at_present(self) -> "Problem":
        """The problem without earlier views."""
        return replace(self, views_now=self.views_now[:1])

    @property
    def without_pivot(self) -> "Problem":
        """The problem with guesses in place of a known pivot."""
        return Problem.of(self.views_now, self.goal_views, None)

    def nearest_views(self, R: Float[np.ndarray, "3 3"]) -> "Problem":
        """The problem of the goal views from nearly the same side as the current view, for a rotation; all if none is.

        Images of one side sample the same surface: their errors are alike, and cancel.
        """
        near = tuple(x for x in self.goal_views if so3.angle_difference(R, x.R_first_view) <= NEAR_RAD)
        return replace(self, goal_views=near or self.goal_views)

    def of_views(self, now: tuple[PosedView, ...], goal: tuple[PosedView, ...]) -> "Problem":
        """The problem of other views, with this one's pivot, if that is known."""
        return Problem.of(now, goal, self.prior.current_m if self.prior.known else None)

    def first_translations(self, R: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3"]:
        """Translations (metres) to begin with: about a known pivot, else current's returns in place of the goal's.

        That is: the boxes around both share their middle across the view, and their nearest depth, in the goal view
        that faces the object most nearly from the same side.
        """
        if self.prior.known:
            return self.prior.translations(R)
        t_m = np.empty((len(R), 3))
        faces = np.stack([(x.R_first_view.T @ R)[:, 2, 2] for x in self.goal_views]).argmax(axis=0)
        for index, goal in enumerate(self.goal_views):
            chosen = faces == index
            rotated = rotate((goal.R_first_view.T @ R[chosen]).astype(np.float32), self.current.sample(BOX_POINTS))
            in_view_m = np.asarray(_anchor(goal.view.sample(BOX_POINTS)[None]) - _anchor(rotated))
            t_m[chosen] = in_view_m @ goal.R_first_view.T + goal.t_first_view_m
        return t_m

    def start(self, R: Float[np.ndarray, "k 3 3"]) -> Hypotheses:
        """Hypotheses of these rotations with their first translations."""
        return Hypotheses(R, self.first_translations(R))

    def pairs(self, hypotheses: Hypotheses) -> Iterator[ViewPair]:
        """Each view now with each goal view."""
        for now in self.views_now:
            from_now = hypotheses.after(now.R_first_view, now.t_first_view_m)
            for goal in self.goal_views:
                yield ViewPair(now, goal, from_now.onto(goal.R_first_view, goal.t_first_view_m))

    def image_score(self, hypotheses: Hypotheses, tolerance: float, points: int) -> Float[np.ndarray, " k"]:
        """The scores of the pairs, added over the goal views, their mean over the views now.

        ``tolerance``: relative to the object diameter. ``points``: of each image where there is one pair.
        """
        total = np.zeros(len(hypotheses))
        for pair in self.pairs(hypotheses):
            views = pair.now.view, pair.goal.view
            total += score(*views, pair.motions, tolerance * self.diameter_m, self.share(points))
        return total / len(self.views_now)

    def score(self, hypotheses: Hypotheses, tolerance: float, points: int) -> Float[np.ndarray, " k"]:
        """``image_score`` less the cost of the prior."""
        distance2 = self.prior.mahalanobis2(hypotheses.R, hypotheses.t_m)
        return np.asarray(
            self.image_score(hypotheses, tolerance, points) - PRIOR_COST * np.minimum(distance2, LARGEST_DISTANCE2)
        )

    def evidence(
        self, R: Float[np.ndarray, "3 3"], t_m: Float[np.ndarray, "3"], tolerance_m: float, points: int
    ) -> Evidence:
        """The evidence for one motion by the current view and all goal views."""
        warped: list[Warped] = []
        for pair in self.at_present.pairs(Hypotheses(R[None], t_m[None])):
            warped += warp_both(pair.now.view, pair.goal.view, pair.motions.R[0], pair.motions.t_m[0], points)
        return evidence_of(warped, tolerance_m)

    def share(self, points: int) -> int:
        """Points of each image in a pair: several views now take no longer than one, and goal views longer by the
        square root of their number."""
        return max(int(points / len(self.views_now) / sqrt(len(self.goal_views))), FEWEST_POINTS)


def _anchor(points_m: Float[np.ndarray, "k 3 n"]) -> Float[np.ndarray, "k 3"]:
    """The middle of the box across the view, and its nearest depth."""
    low, high = points_m.min(axis=2).astype(float), points_m.max(axis=2).astype(float)
    return np.concatenate([(low[:, :2] + high[:, :2]) / 2, low[:, 2:]], axis=1)
