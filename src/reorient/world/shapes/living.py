"""Families of living things: trees, plants, animals."""

import numpy as np
from manifold3d import Manifold
from numpy.random import Generator

from reorient.world.shapes.solids import (
    ball,
    chance,
    lathe_profile,
    limb,
    ngon,
    revolved,
    smooth_path,
    sweep,
    union,
)


def branches(rng: Generator) -> Manifold:
    """A trunk that forks: tree, coral, antlers, coat stand."""
    parts: list[Manifold] = []
    spread, shrink = rng.uniform(0.3, 0.9), rng.uniform(0.55, 0.8)

    def grow(start: np.ndarray, direction: np.ndarray, length: float, radius: float, depth: int) -> None:
        middle = start + direction * length / 2 + rng.normal(0, 0.08, 3) * length
        end = start + direction * length
        parts.append(limb([start, middle, end], (radius, radius * 0.85, radius * 0.7), 6))
        for _ in range(rng.integers(2, 5 - min(depth, 2)) if depth else 0):
            heading = direction + rng.normal(0, spread, 3)
            grow(end, heading / np.linalg.norm(heading), length * shrink, radius * 0.7, depth - 1)

    grow(np.zeros(3), np.array([0.0, 0.0, 1.0]), rng.uniform(0.3, 0.6), rng.uniform(0.03, 0.1), int(rng.integers(1, 4)))
    if chance(rng, 0.5):
        parts.append(Manifold.cylinder(0.06, rng.uniform(0.15, 0.35), -1, 24))
    return union(parts)


def plant(rng: Generator) -> Manifold:
    """A pot with stems that carry leaves or balls."""
    wide, high = rng.uniform(0.12, 0.3), rng.uniform(0.2, 0.5)
    parts = [revolved(lathe_profile(rng, wide, 0.15) * (1, high), int(rng.choice([4, 8, 24])))]
    length, spread, broad = rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.8), rng.uniform(0.15, 0.6)
    for _ in range(rng.integers(2, 11)):
        reach = rng.normal(0, spread, 2) * length
        droop = length * rng.uniform(0.3, 1.0)
        path = smooth_path(
            np.array(
                [
                    (*(rng.uniform(-0.5, 0.5, 2) * wide), high - 0.05),
                    (*(reach * 0.35), high + length * 0.7),
                    (*reach, high + droop),
                ]
            ),
            10,
        )
        if chance(rng, broad):
            parts.append(sweep(path, ngon(4, 0.15), 0.02 + 0.12 * np.sin(np.linspace(0, 3.1, 10))))
        else:
            parts.append(sweep(path, ngon(5), 0.015))
            parts.append(ball(rng.uniform(0.04, 0.12, 3), path[-1], 8))
    return union(parts)


def creature(rng: Generator) -> Manifold:
    """A body with neck, head, limbs in some pose and a tail: quadruped, person, insect, toy."""
    upright, pairs = chance(rng, 0.45), int(rng.choice([2, 2, 2, 3]))
    length, girth = rng.uniform(0.5, 1.0), rng.uniform(0.08, 0.2)
    ahead = np.array([0.15, 0, 1.0]) if upright else np.array([1.0, 0, rng.uniform(-0.1, 0.3)])
    spine = smooth_path(np.array([-0.5 * ahead, rng.normal(0, 0.06, 3), 0.5 * ahead]) * length, 5)
    parts = [limb(spine, girth * rng.uniform(0.6, 1.2, 5), 12)]
    head = spine[-1] + ahead * rng.uniform(0.1, 0.4) + (0, rng.normal(0, 0.06), rng.uniform(0.05, 0.3))
    skull = girth * rng.uniform(0.5, 1.1)
    nose = head + np.array([1.0, rng.normal(0, 0.4), -0.3]) * skull * rng.uniform(0.8, 2.2)
    parts.append(limb([spine[-1], head], (girth * 0.5, skull * 0.6), 10))
    parts.append(Manifold.batch_hull([ball(skull, head, 12), ball(skull * 0.5, nose, 8)]))
    if chance(rng, 0.5):
        parts += [limb([head, head + np.array([-0.3, s, 1.0]) * skull * 1.6], (skull * 0.4, 0.02), 6) for s in (-1, 1)]
    reach = length * rng.uniform(0.4, 0.8)
    for station in np.linspace(0, len(spine) - 1, pairs).astype(int):
        for s in (-1, 1):
            hip = spine[station] + (0, s * girth * 0.6, 0)
            swing = rng.normal(0, 0.35)
            out = s * rng.uniform(0.1, 0.6 if upright or pairs == 3 else 0.25)
            knee = hip + np.array([swing, out, -0.9]) * reach / 2
            foot = knee + np.array([rng.normal(-0.2, 0.4), 0.2 * out, -0.9]) * reach / 2
            thick = girth * rng.uniform(0.3, 0.5)
            parts.append(
                limb([hip, knee, foot, np.add(foot, (0.1, 0, 0))], (thick, thick * 0.8, thick * 0.6, thick * 0.6), 8)
            )
    if not upright and chance(rng, 0.7):
        tail = spine[0] - ahead * rng.uniform(0.2, 0.6) + rng.normal(0, 0.15, 3)
        parts.append(limb([spine[0], (spine[0] + tail) / 2 + (0, 0, 0.1), tail], (girth * 0.4, girth * 0.25, 0.02), 6))
    return union(parts)
