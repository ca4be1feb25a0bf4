"""Families of furniture and joinery."""

from itertools import pairwise

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.random import Generator

from reorient.world.shapes.solids import (
    ball,
    beam,
    box,
    chance,
    fit,
    limb,
    ngon,
    outline,
    primitive,
    rod,
    soft_box,
    tilt,
    union,
)


def legs(rng: Generator, width: float, depth: float, top: float, thick: float) -> Manifold:
    """The support of a seat or slab whose underside is at height ``top``: legs, a pedestal or panels."""
    kind, splay = rng.integers(5), 1 + abs(rng.normal(0, 0.15))
    x, y = width / 2 - thick, depth / 2 - thick
    corners = [(x, y), (-x, y), (-x, -y), (x, -y)]
    if kind == 0:
        star = [rod((0, 0, thick), (width * 0.5 * c, depth * 0.5 * s, thick / 2), thick / 2) for c, s in ngon(5)]
        return union([rod((0, 0, thick / 2), (0, 0, top), thick), *star])
    if kind == 1:
        sides = [box((thick, depth, top), (side, 0, top / 2)) for side in (-x, x)]
        return union([*sides, box((width, thick, top * rng.uniform(0.2, 0.8)), (0, rng.uniform(-y, y), top / 2))])
    if kind == 2:
        return union(limb([(a * splay, b * splay, 0), (a, b, top)], (thick * 0.4, thick * 0.7)) for a, b in corners)
    bars = [beam((a * splay, b * splay, 0), (a, b, top + 0.01), thick, thick) for a, b in corners]
    height = top * rng.uniform(0.15, 0.7)
    for i in rng.choice(4, rng.integers(0, 5), replace=False):
        bars.append(beam((*corners[i], height), (*corners[i - 1], height), thick * 0.6, thick * 0.6))
    return union(bars)


def chair(rng: Generator) -> Manifold:
    """A seat on legs with a back of panel, slats or posts, and perhaps arms, even only one."""
    width, depth, height = rng.uniform(0.4, 0.65), rng.uniform(0.4, 0.6), rng.uniform(0.3, 0.75)
    thick, bar = rng.uniform(0.03, 0.12), rng.uniform(0.03, 0.07)
    seat = soft_box((width, depth, thick), rounding=0.4)
    if chance(rng, 0.3):
        seat = fit(CrossSection.circle(0.5, 32).extrude(1.0), (width, depth, thick))
    parts = [seat.translate((0, 0, height)), legs(rng, width, depth, height, bar)]
    tall, lean = rng.uniform(0.25, 0.7), rng.uniform(0, 0.2)
    low, high = np.array([0, depth / 2 - bar, height]), np.array([0, depth / 2 - bar + lean, height + tall])
    side = np.array([width / 2 - bar / 2, 0, 0])
    if chance(rng, 0.4):
        panel = soft_box((width * rng.uniform(0.6, 1), thick, tall), rounding=0.3)
        parts.append(tilt(panel.rotate((0, 0, 90)), high - low, (low + high) / 2))
    elif chance(rng, 0.85):
        parts += [beam(low + s * side, high + s * side, bar, bar) for s in (-1, 1)]
        upright, n = chance(rng, 0.5), int(rng.integers(1, 6))
        for t in np.linspace(-1, 1, n + 2)[1:-1] if upright else np.linspace(0.3, 1, n):
            along, across = (t * side, 0 * side) if upright else (t * (high - low), side)
            start, end = (low, high) if upright else (low, low)
            parts.append(beam(start + along - across, end + along + across, bar * 0.8, bar * 0.6))
        parts.append(beam(high - side * 1.05, high + side * 1.05, bar, bar * 1.5))
    for s in (-1, 1):
        if chance(rng, 0.35):
            rest = np.array([s * side[0], -depth / 3, height + 0.4 * tall])
            parts.append(beam(rest * (1, 1, 0) + (0, 0, height), rest, bar, bar))
            parts.append(beam(rest, (rest[0], depth / 2 + lean / 2, rest[2]), bar, bar * 1.3))
    return union(parts)


def table(rng: Generator) -> Manifold:
    """A top on legs, with a shelf, a drawer box or things standing on it."""
    width, depth = rng.uniform(0.5, 1.4), rng.uniform(0.4, 0.7)
    height, thick = rng.uniform(0.3, 0.9), rng.uniform(0.03, 0.08)
    parts = [fit(outline(rng).hull().extrude(1.0), (width, depth, thick)).translate((0, 0, height))]
    if chance(rng, 0.6):
        parts = [box((width, depth, thick), (0, 0, height))]
    parts.append(legs(rng, width * 0.8, depth * 0.8, height, rng.uniform(0.03, 0.08)))
    if chance(rng, 0.5):
        wide = width * rng.uniform(0.25, 0.5)
        tall = height * rng.uniform(0.2, 0.9)
        side = rng.choice([-1, 1]) * (width - wide) / 2 * 0.8
        parts.append(box((wide, depth * 0.75, tall), (side, 0, height - tall / 2)))
        parts.append(ball(0.03, (side, -depth * 0.39, height - tall / 3), 8))
    if chance(rng, 0.3):
        parts.append(box((width * 0.82, depth * 0.82, thick), (0, 0, height * rng.uniform(0.15, 0.5))))
    for _ in range(rng.integers(0, 3)):
        size = rng.uniform(0.1, 0.4, 3) * min(width, depth)
        at = (rng.uniform(-0.3, 0.3) * width, rng.uniform(-0.3, 0.3) * depth, height + size[2] / 2)
        parts.append(primitive(rng, size).translate(at))
    return union(parts)


def shelves(rng: Generator) -> Manifold:
    """A cabinet or rack: boards at uneven heights, dividers, back, doors, and things on the boards."""
    width, depth, height = rng.uniform(0.4, 1.2), rng.uniform(0.2, 0.5), rng.uniform(0.5, 1.6)
    board = rng.uniform(0.02, 0.05)
    levels = np.concatenate([[0.0], np.sort(rng.uniform(0.15, 0.9, rng.integers(1, 5))), [1.0]]) * (height - board)
    parts = [box((width, depth, board), (0, 0, z + board / 2)) for z in levels]
    parts += [box((board, depth, height), (x, 0, height / 2)) for x in (-width / 2, width / 2)]
    if chance(rng, 0.6):
        parts.append(box((width, board, height), (0, depth / 2, height / 2)))
    for low, high in pairwise(levels):
        gap, what = high - low, rng.integers(5)
        if what == 0:
            parts.append(
                box((width * 0.5, board, gap), (rng.choice([-0.25, 0.25]) * width, -depth / 2, (low + high) / 2))
            )
        elif what == 1:
            parts.append(box((board, depth * 0.95, gap), (rng.uniform(-0.4, 0.4) * width, 0, (low + high) / 2)))
        elif what == 2:
            size = rng.uniform(0.3, 0.8, 3) * (width / 2, depth, gap)
            parts.append(
                primitive(rng, size).translate((rng.uniform(-0.25, 0.25) * width, 0, low + size[2] / 2 + board / 2))
            )
        elif what == 3:
            parts.append(box((width, depth * rng.uniform(1, 1.15), gap), (0, 0, (low + high) / 2)))
            parts.append(ball(board, (rng.uniform(-0.4, 0.4) * width, -depth * 0.58, (low + high) / 2), 8))
    return union(parts)


def upholstery(rng: Generator) -> Manifold:
    """Sofa, armchair, bed or bench: padded blocks, straight or cornered."""
    width, depth, height = rng.uniform(0.5, 1.6), rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.4)
    arm, round_ = rng.uniform(0.08, 0.2), rng.uniform(0.05, 0.45)
    back = rng.uniform(0.2, 0.6)
    parts = [soft_box((width, depth, height), (0, 0, height / 2), round_)]
    parts.append(soft_box((width, arm, height + back), (0, depth / 2, (height + back) / 2), round_))
    for side in (-1, 1):
        if chance(rng, 0.7):
            tall = height + back * rng.uniform(0.2, 0.9)
            parts.append(soft_box((arm, depth * rng.uniform(0.8, 1.1), tall), (side * width / 2, 0, tall / 2), round_))
    if chance(rng, 0.35):
        parts.append(soft_box((width * 0.4, depth, height), (-width * 0.3, -depth * 0.7, height / 2), round_))
    for _ in range(rng.integers(0, 4)):
        pillow = soft_box(rng.uniform(0.2, 0.4, 3) * (1, 1, 0.5), rounding=0.45).rotate((rng.uniform(0, 80), 0, 0))
        parts.append(pillow.translate((rng.uniform(-0.35, 0.35) * width, rng.uniform(-0.1, 0.3) * depth, height * 1.1)))
    if chance(rng, 0.5):
        parts.append(legs(rng, width, depth, height / 2, 0.05).translate((0, 0, -height * 0.35)))
    return union(parts)


def frame(rng: Generator) -> Manifold:
    """Sticks: railing, ladder, clothes horse, cage or rack, some missing, some across, perhaps with a board."""
    columns, rows = int(rng.integers(1, 9)), int(rng.integers(1, 4))
    width, height, depth = 0.3 * columns**0.7, rng.uniform(0.3, 0.5) * rows, rng.uniform(0.3, 0.9)
    thick, keep = rng.uniform(0.02, 0.06), rng.uniform(0.7, 1.0)

    def side() -> Manifold:
        bars = [CrossSection.square((width + thick, thick), True).translate((0, z)) for z in (-height / 2, height / 2)]
        bars += [
            CrossSection.square((thick, height), True).translate((x, 0))
            for x in np.linspace(-0.5, 0.5, columns + 1) * width
            if chance(rng, keep)
        ]
        bars += [
            CrossSection.square((width, thick), True).translate((0, z))
            for z in rng.uniform(-0.4, 0.4, rows - 1) * height
        ]
        if chance(rng, 0.3):
            lean = np.degrees(np.arctan2(height, width)) * rng.choice([-1, 1])
            bars.append(CrossSection.square((np.hypot(width, height) - thick, thick), True).rotate(lean))
        return CrossSection.compose(bars).extrude(thick).translate((0, 0, -thick / 2)).rotate((90, 0, 0))

    if chance(rng, 0.35):
        feet = [
            beam((x, -depth / 4, -height / 2), (x, depth / 4, -height / 2), thick, thick)
            for x in (-width / 2, width / 2)
        ]
        return union([side(), *feet[: rng.integers(0, 3)]])
    lean = rng.choice([0, 0, rng.uniform(-30, 30)])
    parts = [side().rotate((s * lean, 0, 0)).translate((0, s * depth / 2, 0)) for s in (-1, 1)]
    shift = 0.5 * height * float(np.sin(np.radians(lean)))
    for x in np.linspace(-0.5, 0.5, int(rng.integers(2, columns + 2))) * width:
        for s in (-1, 1):
            reach, z = depth / 2 - s * shift, s * height / 2 * float(np.cos(np.radians(lean)))
            if chance(rng, keep):
                parts.append(rod((x, -reach, z), (x, reach, z), thick / 2, sides=6))
    if chance(rng, 0.4):
        parts.append(box((width, depth, thick), (0, 0, height * rng.uniform(-0.3, 0.3))))
    return union(parts)


def relief_panel(rng: Generator) -> Manifold:
    """A flat board with mouldings, windows and a handle: door, picture, switch, game board."""
    width, height, thick = rng.uniform(0.4, 1), rng.uniform(0.6, 1.4), rng.uniform(0.05, 0.15)
    panel = box((width, thick, height))
    columns, rows = rng.integers(1, 4, 2)
    for i in range(columns):
        for k in range(rows):
            at = np.array([((i + 0.5) / columns - 0.5) * width, -thick / 2, ((k + 0.5) / rows - 0.5) * height])
            field = np.array([width / columns * 0.75, thick, height / rows * 0.75])
            what = rng.integers(5)
            if what == 0:
                panel -= box(field * (1, 3, 1), at)
            elif what == 1:
                panel -= box(field, at)
            elif what == 2:
                panel += soft_box(field, at, 0.3, 4)
            elif what == 3:
                panel += rod(
                    at, at - (0, thick * rng.uniform(0.7, 2), 0), float(min(field[0], field[2])) * 0.4, sides=24
                )
    knob = np.array([rng.choice([-0.42, 0.42]) * width, -thick / 2, rng.uniform(-0.2, 0.2) * height])
    out = knob - (0, rng.uniform(0.08, 0.15), 0)
    handle = limb([knob, out, out - (0.5 * knob[0], 0, 0)], [0.025] * 3)
    foot = beam((0, -0.25, -height / 2), (0, 0.25, -height / 2), width, 0.05)
    return union([panel, handle, foot] if chance(rng, 0.3) else [panel, handle])
