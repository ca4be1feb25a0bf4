"""The share of an object's surface that the views of a goal show, without a model of the object.

The object is carved out of a box of cells: what a view saw through is empty, what lies at a return is surface, the
rest may be object (the visual hull). From each direction the outermost cells are looked at: surface that a view showed,
or cells that none did. Rotations about the optical axis change no share, so directions stand for orientations.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from reorient.imaging import Goal
from reorient.registration.depth_view import DepthView

CELLS = 60  # along the diagonal of the box. Not tuned
DIRECTIONS = 200
ENOUGH = 0.5  # share of the visible surface, above which a start overlaps with the goal. Not tuned
_WIDTHS = 1.0  # of a cell: largest distance of a surface cell from its return, along the optical axis


@dataclass(frozen=True)
class Coverage:
    """What the views of a goal show of the surface that start orientations show."""

    mean: float
    """Share of the visible surface, the mean over all orientations."""
    starts: float
    """Share of all orientations of which at least half of the visible surface is shown."""


def coverage(goal: Goal) -> Coverage:
    """The overlap of the goal's views with a start in any orientation."""
    points_m, shown, cell_m = _hull(goal)
    z = 1 - 2 * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    around = np.pi * (1 + np.sqrt(5)) * np.arange(DIRECTIONS)
    directions = np.stack([np.cos(around) * np.sqrt(1 - z**2), np.sin(around) * np.sqrt(1 - z**2), z], axis=1)
    shares = np.array([_share(points_m, shown, cell_m, direction) for direction in directions])
    return Coverage(float(shares.mean()), float(np.mean(shares >= ENOUGH)))


def _hull(goal: Goal) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"], float]:
    """Cells that may be object (goal pose, metres), which of them a view showed, and their size."""
    views = [(DepthView(goal.image), np.eye(3), np.zeros(3))]
    for view in goal.views:
        t_m = np.zeros(3) if view.t_goal_view_m is None else view.t_goal_view_m
        views.append((DepthView(view.image), view.R_goal_view, t_m))
    clouds = [view.points_m.astype(float) @ R.T + t_m for view, R, t_m in views]
    low, high = _box(clouds)
    cell_m = float(np.linalg.norm(high - low)) / CELLS
    axes = [np.arange(a + cell_m / 2, b, cell_m) for a, b in zip(low, high, strict=True)]
    cells_m = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    solid, shown = np.ones(len(cells_m), bool), np.zeros(len(cells_m), bool)
    for seen, R, t_m in views:
        warped = seen.warp(((cells_m - t_m) @ R).T)
        tolerance_m = _WIDTHS * cell_m
        shown |= warped.inlier(tolerance_m)
        solid &= ~warped.violation(tolerance_m)
    shown &= solid
    return cells_m[solid], shown[solid], cell_m


def _box(clouds: Sequence[Float[np.ndarray, "_ 3"]]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Lowest and highest x, y, z of the object. One view does not show its depth: it is taken as its mean width."""
    low, high = np.percentile(np.concatenate(clouds), [0.5, 99.5], axis=0)
    if len(clouds) == 1:
        high[2] = max(high[2], low[2] + float(np.mean((high - low)[:2])))
    margin_m = 0.03 * float(np.linalg.norm(high - low))
    return low - margin_m, high + margin_m


def _share(
    points_m: Float[np.ndarray, "n 3"], shown: Bool[np.ndarray, " n"], cell_m: float, direction: Float[np.ndarray, "3"]
) -> float:
    """Of the cells that are outermost in a direction, the share that a view showed; parallel rays."""
    x = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    x /= np.linalg.norm(x)
    across = np.floor(points_m @ np.stack([x, np.cross(direction, x)], axis=1) / (1.2 * cell_m)).astype(int)
    across -= across.min(axis=0)
    ray = across[:, 0] * (across[:, 1].max() + 1) + across[:, 1]
    order = np.lexsort((-(points_m @ direction), ray))
    first = np.r_[True, np.diff(ray[order]) > 0]
    depth_m = (points_m @ direction)[order]
    outermost_m = np.repeat(depth_m[first], np.diff(np.r_[np.flatnonzero(first), len(ray)]))
    near = shown[order] & (depth_m >= outermost_m - 1.5 * cell_m)
    starts = np.flatnonzero(first)
    return float(np.mean(np.logical_or.reduceat(near, starts)))
