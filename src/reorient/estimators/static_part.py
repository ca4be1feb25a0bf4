"""A part of both images that did not move: a table, or a gripper that stays where it is.

It agrees under "no rotation" while the rest of the image agrees under another motion, or under none that was found. The
object is then estimated without it. Where "no rotation" leaves nothing unexplained, the object is at its goal.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from reorient.registration import INLIER_TOLERANCE, DepthView, Hypotheses, Problem


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Shares are of the returns of an image."""

    unexplained: float = 0.06
    """An answer that contradicts fewer returns has explained the images."""
    tolerance: float = INLIER_TOLERANCE
    """Depth difference of returns that agree, relative to the object diameter."""
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
    problem: Problem, R_goal_current: Float[np.ndarray, "3 3"], t_goal_current_m: Float[np.ndarray, "3"]
) -> StaticPart | None:
    """The part of the images that agrees under "no rotation" and that the answer leaves unexplained; None if small."""
    tolerance_m = SETTINGS.tolerance * problem.diameter_m
    motion = Hypotheses(R_goal_current[None], t_goal_current_m[None])
    moved = motion.move(problem.current.points_m.T)[0] - problem.current.points_m.T
    still_answer = bool(np.median(np.linalg.norm(moved, axis=0)) < 2 * tolerance_m)
    unexplained, static = [], []
    for view, other, to_other in (
        (problem.current, problem.goal, motion),
        (problem.goal, problem.current, motion.inverse),
    ):
        still = _mask(view, other.warp(view.points_m.T).inlier(tolerance_m))
        moved_points = to_other.single().move(view.points_m.T)[0]
        contradicted = _mask(view, other.warp(moved_points).violation(tolerance_m))
        unexplained.append(_share(view, _opened(contradicted if still_answer else contradicted & still)))
        static.append(still if still_answer else _contradicted_regions(still, contradicted))
    if np.mean(unexplained) < SETTINGS.unexplained:
        return None
    views = problem.current, problem.goal
    share = float(np.mean([_share(view, mask) for view, mask in zip(views, static, strict=True)]))
    return StaticPart(share, still_answer, _without(problem, static))


def _mask(view: DepthView, points: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, "h w"]:
    mask = np.zeros(view.image.depth_m.shape, bool)
    mask[view.image.valid] = points
    return mask


def _opened(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Without single pixels and thin lines, which edges and noise leave."""
    return np.asarray(ndimage.binary_opening(mask, np.ones((3, 3))))


def _share(view: DepthView, mask: Bool[np.ndarray, "h w"]) -> float:
    return float(np.count_nonzero(mask)) / len(view.points_m)


def _contradicted_regions(
    still: Bool[np.ndarray, "h w"], contradicted: Bool[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """The connected static regions of which the answer contradicts a good part."""
    labels, count = ndimage.label(_opened(still))
    if not count:
        return np.zeros_like(still)
    share = ndimage.mean(contradicted, labels, np.arange(count + 1))
    share[0] = 0
    return np.asarray(ndimage.binary_dilation((share >= SETTINGS.component)[labels], np.ones((3, 3))))


def _without(problem: Problem, static: list[Bool[np.ndarray, "h w"]]) -> Problem | None:
    """The current observation and the goal with the static pixels unknown."""
    views = []
    for view, mask in zip((problem.current, problem.goal), static, strict=True):
        kept = np.count_nonzero(view.image.valid & ~mask)
        if kept < max(SETTINGS.left * len(view.points_m), SETTINGS.fewest):
            return None
        views.append(DepthView(replace(view.image, unknown=view.image.unknown | mask)))
    return problem.of_views(*views)
