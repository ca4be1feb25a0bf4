"""A part of both images that did not move: a table, or a gripper that stays where it is.

It agrees under "no rotation" while the rest of the image agrees under another motion, or under none that was found. The
object is then estimated without it. Where "no rotation" leaves nothing unexplained, the object is at its goal.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from reorient.registration import INLIER_TOLERANCE, DepthView, Hypotheses, PosedView, Problem


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Shares are of the returns of an image."""

    unexplained: float = 0.06
    """A motion that contradicts fewer returns has explained the images."""
    least: float = 0.1
    """A smaller static part is none."""
    tolerance: float = INLIER_TOLERANCE
    """Depth difference of returns that agree, relative to the object diameter."""
    smallest: float = 0.02
    """A smaller connected region is no static part."""
    component: float = 0.2
    """A connected static region is removed if the answer contradicts this share of it."""
    left: float = 0.08
    """Fewer returns of the rest are no object."""
    fewest: int = 50
    """Returns of the rest."""


SETTINGS = Settings()


@dataclass(frozen=True, eq=False)
class StaticPart:
    """The static part of a pair, and the problem without it."""

    share: float
    """Of the returns of both images."""
    still: bool
    """Whether the answer is "no rotation"."""
    rest: Problem | None
    """The problem with the static pixels unknown and without history; None where too little is left."""


def find_static_part(
    problem: Problem, R_goal_current: Float[np.ndarray, "3 3"], t_goal_current_m: Float[np.ndarray, "3"], sure: bool
) -> StaticPart | None:
    """The part of the images that agrees under "no rotation", where that leaves another part unexplained; else None.

    A sure answer that does not contradict that part stands: None.
    """
    tolerance_m = SETTINGS.tolerance * problem.diameter_m
    motion = Hypotheses(R_goal_current[None], t_goal_current_m[None])
    moved = motion.move(problem.current.points_m.T)[0] - problem.current.points_m.T
    still_answer = bool(np.median(np.linalg.norm(moved, axis=0)) < 2 * tolerance_m)
    of_current = _Compared(problem.current, problem.goal, motion, tolerance_m)
    of_goal = [
        _Compared(pair.goal.view, pair.now.view, pair.motions.inverse, tolerance_m)
        for pair in problem.at_present.pairs(motion)
    ]
    compared = of_current, of_goal[0]
    if np.mean([each.unexplained_by_rest for each in compared]) < SETTINGS.unexplained:
        return None
    contradicted = np.mean([each.contradicted for each in compared]) >= SETTINGS.unexplained
    if sure and not (contradicted or still_answer):
        return None
    static = [
        each.contradicted_regions if contradicted and not still_answer else each.regions
        for each in (of_current, *of_goal)
    ]
    share = float(np.mean([each.share(mask) for each, mask in zip(compared, static[:2], strict=True)]))
    return StaticPart(share, still_answer, _without(problem, static)) if share >= SETTINGS.least else None


class _Compared:
    """The returns of one image in the other, at rest and under the answer, as masks."""

    def __init__(self, view: DepthView, other: DepthView, to_other: Hypotheses, tolerance_m: float) -> None:
        self._view = view
        at_rest = other.warp(view.points_m.T)
        moved = other.warp(to_other.single().move(view.points_m.T)[0])
        self._still = _opened(self._mask(at_rest.inlier(tolerance_m)))
        self._violation = self._mask(moved.violation(tolerance_m))
        self.unexplained_by_rest = self.share(_opened(self._mask(at_rest.violation(tolerance_m))))
        """Share of the returns that contradict "no rotation"."""
        self.contradicted = self.share(_opened(self._violation & self._still))
        """Share of the returns that agree with "no rotation" and contradict the answer."""

    @property
    def regions(self) -> Bool[np.ndarray, "h w"]:
        """The connected static regions that are large enough."""
        return self._chosen(np.ones_like(self._still), SETTINGS.smallest * len(self._view.points_m), ndimage.sum_labels)

    @property
    def contradicted_regions(self) -> Bool[np.ndarray, "h w"]:
        """The connected static regions of which the answer contradicts a good part."""
        return self._chosen(self._violation, SETTINGS.component, ndimage.mean)

    def share(self, mask: Bool[np.ndarray, "h w"]) -> float:
        """Share of the returns in a mask."""
        return float(np.count_nonzero(mask & self._view.image.valid)) / len(self._view.points_m)

    def _mask(self, points: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, "h w"]:
        mask = np.zeros(self._view.image.depth_m.shape, bool)
        mask[self._view.image.valid] = points
        return mask

    def _chosen(
        self, values: Bool[np.ndarray, "h w"], least: float, measure: Callable[..., np.ndarray]
    ) -> Bool[np.ndarray, "h w"]:
        """The connected static regions of which a measure reaches the least, one pixel wider."""
        labels, count = ndimage.label(self._still)
        chosen = np.zeros(count + 1, bool)
        chosen[1:] = measure(values, labels, np.arange(1, count + 1)) >= least
        return np.asarray(ndimage.binary_dilation(chosen[labels], np.ones((3, 3))))


def _opened(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Without single pixels and thin lines, which edges and noise leave."""
    return np.asarray(ndimage.binary_opening(mask, np.ones((3, 3))))


def _without(problem: Problem, static: list[Bool[np.ndarray, "..."]]) -> Problem | None:
    """The current view and the goal views with the static pixels unknown; without further views that keep too little,
    None where the current or the primary view does."""
    masked = [_masked(x, mask) for x, mask in zip((problem.views_now[0], *problem.goal_views), static, strict=True)]
    if masked[0] is None or masked[1] is None:
        return None
    return problem.of_views((masked[0],), tuple(x for x in masked[1:] if x is not None))


def _masked(posed: PosedView, mask: Bool[np.ndarray, "h w"]) -> PosedView | None:
    """A view with static pixels unknown; None if it keeps too few returns."""
    image = posed.view.image
    if np.count_nonzero(image.valid & ~mask) < max(SETTINGS.left * len(posed.view.points_m), SETTINGS.fewest):
        return None
    return posed.of(DepthView(replace(image, unknown=image.unknown | mask)))
