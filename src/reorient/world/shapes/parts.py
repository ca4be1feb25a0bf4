"""Families of machine parts and plain bodies: revolved, milled, bent, swept, cast, rounded."""

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.random import Generator

from reorient.world.shapes.deformations import bent, lumpy, surface_points
from reorient.world.shapes.solids import (
    ball,
    box,
    chance,
    extents,
    fit,
    lathe_profile,
    ngon,
    outline,
    pierced,
    primitive,
    revolved,
    rod,
    smooth_path,
    soft_box,
    sweep,
    tilt,
    union,
)


def cluster(rng: Generator) -> Manifold:
    """Primitives stuck to one another."""
    parts = [primitive(rng, np.exp(rng.normal(-0.3, 0.4, 3)))]
    for _ in range(rng.integers(1, 6)):
        size = np.exp(rng.normal(-0.9, 0.5, 3))
        [point], [normal] = surface_points(rng, parts[rng.integers(len(parts))], 1)
        # sunk by a quarter, so that parts overlap rather than touch
        parts.append(primitive(rng, size).translate(point + normal * size / 4))
    return union(parts)


def machined_block(rng: Generator) -> Manifold:
    """A block with holes, pockets and slots cut along its axes."""
    size = np.exp(rng.normal(0, 0.4, 3))
    block = soft_box(size, rounding=0.12, sides=4) if chance(rng, 0.4) else primitive(rng, size)
    for _ in range(rng.integers(2, 7)):
        axis = rng.integers(3)
        direction, at = np.eye(3)[axis] * rng.choice([-1, 1]), rng.uniform(-0.5, 0.5, 3) * size
        width = rng.uniform(0.1, 0.5, 3) * size
        if chance(rng, 0.5):
            width[axis] = 3 * size[axis]
        else:
            at[axis] = direction[axis] * size[axis] / 2
        block -= (
            box(width, at) if chance(rng, 0.5) else fit(rod(-direction, direction, 1, sides=24), width).translate(at)
        )
    return block


def crossed_profiles(rng: Generator) -> Manifold:
    """The common part of outlines extruded along two or three axes."""
    first, *others = [
        fit(pierced(rng, outline(rng), int(rng.integers(0, 2))).extrude(1.0), np.ones(3))
        for _ in range(rng.integers(2, 4))
    ]
    for rotation_deg, other in zip([(90, 0, 0), (0, 90, 0)], others, strict=False):
        common = first ^ other.rotate(rotation_deg)
        first = first if common.is_empty() else common
    return first.scale(np.exp(rng.normal(0, 0.35, 3)))


def profile_bar(rng: Generator) -> Manifold:
    """A pierced outline extruded, thin or long, twisted or tapered."""
    shape = pierced(rng, outline(rng), int(rng.integers(0, 5)))
    height = float(np.exp(rng.uniform(np.log(0.1), np.log(2.5))))
    if chance(rng, 0.5):
        return shape.extrude(height)
    return shape.extrude(height, 12, rng.normal(0, 60) * height, rng.uniform(0.3, 1.1, 2))


def turned_part(rng: Generator) -> Manifold:
    """A solid of revolution, complete or a sector of it, often with a peg beside its axis."""
    profile = lathe_profile(rng, float(np.exp(rng.normal(-1.2, 0.5))), 0.5)
    segments = int(rng.choice([6, 12, 32, 40]))
    solid = revolved(profile, segments, rng.uniform(90, 330) if chance(rng, 0.3) else 360.0)
    widest = float(profile[:, 0].max())
    if chance(rng, 0.4):
        solid = solid.trim_by_plane((-1, rng.normal(0, 0.3), 0), -rng.uniform(0.3, 0.8) * widest)
    if chance(rng, 0.5):
        height = rng.uniform(0.15, 0.85)
        reach = widest * rng.uniform(1.3, 2.5)
        solid += rod(
            (0, 0, height), (reach, 0, height + rng.normal(0, 0.15)), 0.25 * widest, rng.uniform(0.1, 0.4) * widest
        )
    return solid


def bent_pipe(rng: Generator) -> Manifold:
    """A section swept along a path: hook, helix, wire, ring or loose curve, sometimes with ends."""
    kind = rng.integers(4)
    if kind == 0:  # a helix, from spring to open ring
        angle = np.linspace(0, rng.uniform(0.7, 4) * 2 * np.pi, 80)
        grow = 1 + rng.uniform(-0.5, 0.5) * angle / angle[-1]
        path = np.column_stack([np.cos(angle) * grow, np.sin(angle) * grow, angle * rng.uniform(0.03, 0.2)]) / 2
        thick = min(0.12, 0.4 * float(path[-1, 2]) / max(1.0, angle[-1] / (2 * np.pi)))
    elif kind == 1:  # a hook: a straight shank and an arc
        angle = np.linspace(0, rng.uniform(0.5, 1.6) * np.pi, 20)
        arc = rng.uniform(0.2, 0.5) * np.column_stack([1 - np.cos(angle), 0 * angle, np.sin(angle)])
        shank = np.column_stack([np.zeros((8, 2)), np.linspace(-rng.uniform(0.3, 1.2), -0.05, 8)])
        path, thick = np.concatenate([shank, arc]), 0.1
    else:
        steps = rng.normal((0.0, 0.0, 0.3), 0.4, (rng.integers(3, 6), 3))
        path, thick = smooth_path(np.cumsum(steps, axis=0), 36), 0.12
    radius = thick * rng.uniform(0.4, 1.1)
    varying = 1 + rng.uniform(0, 0.5) * np.sin(np.linspace(0, rng.uniform(1, 12), len(path)) + rng.uniform(0, 6))
    pipe = sweep(path, ngon(int(rng.choice([4, 6, 12])), rng.uniform(0.35, 1)), radius * varying)
    for end in path[[0, -1]]:
        if chance(rng, 0.4):
            pipe += primitive(rng, radius * rng.uniform(2.2, 6, 3)).translate(end)
    return pipe


def tray(rng: Generator) -> Manifold:
    """A shell open on one side: cup, box, bin or drawer, with dividers, a handle or a gap in the wall."""
    shape, wall = outline(rng).hull(), rng.uniform(0.03, 0.08)
    height, flare = float(np.exp(rng.normal(-0.9, 0.6))), rng.uniform(0.8, 1.5)
    outer = shape.extrude(height, 0, 0.0, (flare, flare))
    inside = shape.offset(-wall)
    if inside.is_empty():  # too narrow for the wall
        return outer
    parts = [outer - inside.extrude(height, 0, 0.0, (flare, flare)).translate((0, 0, wall))]
    for _ in range(rng.integers(0, 4)):
        partition = box((2, wall, height), (0, rng.uniform(-0.4, 0.4), height / 2)).rotate((0, 0, rng.choice([0, 90])))
        parts.append(partition.scale((1, 1, rng.uniform(0.5, 0.95))) ^ outer)
    if chance(rng, 0.5):
        side = rng.uniform(0.35, 0.5) * flare
        arc = [(side, -0.12, height * 0.8), (side + 0.2, 0, height * rng.uniform(0.6, 1.2)), (side, 0.12, height * 0.8)]
        parts.append(sweep(smooth_path(np.array(arc)), ngon(8), 0.04))
    shell = union(parts)
    if chance(rng, 0.5):
        low, high = np.sort(rng.uniform(0.2, 1.2, 2)) * height
        shell -= box((1, rng.uniform(0.1, 0.5), high - low), (0.6, rng.uniform(-0.3, 0.3), (low + high) / 2))
    return shell


def pebble(rng: Generator) -> Manifold:
    """Smooth and rounded: soaps, remote controls, cushions, perhaps hollowed or with a flat."""
    size = np.exp(rng.normal(0, 0.45, 3)) * (0.5, 0.4, 0.25)
    radii = rng.uniform(0.08, 0.22, rng.integers(3, 9))
    solid = Manifold.batch_hull([ball(radius, rng.uniform(-1, 1, 3) * size, 16) for radius in radii])
    reach = extents(solid)
    solid = fit(solid, reach)
    if chance(rng, 0.5):
        at = rng.uniform(-0.4, 0.4, 3) * reach + (0, 0, 0.6 * reach[2])
        solid -= ball(rng.uniform(0.2, 0.5, 3) * reach, at, 20)
    if chance(rng, 0.4):
        solid = solid.trim_by_plane((0, 0, 1), -0.25 * float(reach[2]))
    return solid


def rock(rng: Generator) -> Manifold:
    """A warped ball: rock, potato, blob; faceted, rough or smooth."""
    solid = ball(0.5, sides=int(rng.choice([12, 20, 32]))).scale(np.exp(rng.normal(0, 0.3, 3)))
    for _ in range(rng.integers(1, 4)):
        solid = lumpy(rng, solid, rng.uniform(0.6, 1.3), waves=6)
    if chance(rng, 0.3):
        solid = solid.trim_by_plane((0, 0, 1), -rng.uniform(0, 0.3))
    return solid


def bracket(rng: Generator) -> Manifold:
    """Sheet bent to an L, U, Z or more, with holes and ribs."""
    width, thick = rng.uniform(0.2, 0.9), rng.uniform(0.03, 0.1)
    heading = np.cumsum(rng.choice([-90, -60, 90, 90, 120], rng.integers(2, 5))) * np.pi / 180
    lengths = rng.uniform(0.3, 1, len(heading))
    steps = np.column_stack([np.cos(heading), 0 * heading, np.sin(heading)])
    corners = np.concatenate([np.zeros((1, 3)), np.cumsum(steps * lengths[:, None], axis=0)])
    sheet, holes = [], []
    for start, step, length in zip(corners, steps, lengths, strict=False):
        normal = np.cross(step, (0, 1, 0))
        # longer by half the thickness at each end, to close the corner
        sheet.append(tilt(box((thick, width, length + thick)), step, start + step * length / 2))
        for _ in range(rng.integers(0, 3)):
            at = start + step * length * rng.uniform(0.25, 0.75) + np.array([0, rng.uniform(-0.3, 0.3) * width, 0])
            holes.append(rod(at - normal * thick, at + normal * thick, min(length, width) * rng.uniform(0.07, 0.2)))
    for i in range(1, len(steps)):
        if chance(rng, 0.5):
            reach = 0.6 * min(lengths[i - 1], lengths[i])
            tips = np.array([corners[i], corners[i] - reach * steps[i - 1], corners[i] + reach * steps[i]])
            side = np.array([0, rng.uniform(-0.4, 0.4) * width, 0])
            sheet.append(Manifold.hull_points(np.concatenate([tips + side, tips + side + (0, thick, 0)])))
    return union(sheet) - union(holes) if holes else union(sheet)


def array(rng: Generator) -> Manifold:
    """One part repeated on a base in a row, ring or grid, growing or with gaps: rack, brush, keypad, candles."""
    part = fit(primitive(rng, np.ones(3)) if chance(rng, 0.7) else revolved(lathe_profile(rng, 0.3), 12), np.ones(3))
    columns, rows = int(rng.integers(2, 7)), int(rng.integers(1, 5))
    if chance(rng, 0.3):
        angle = np.arange(columns + 1) * 2 * np.pi / (columns + 1)
        spots = 0.4 * np.column_stack([np.cos(angle), np.sin(angle)])
        base, pitch = CrossSection.circle(0.52, 40).extrude(0.1), 0.75 / (columns + 1) ** 0.7
    else:
        pitch = 1 / max(columns, rows)
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        spots = (grid - grid.max(axis=0) / 2) * pitch
        base = box((columns * pitch, rows * pitch, 0.1), (0, 0, 0.05))
    height, grow = float(np.exp(rng.normal(-1, 0.6))), rng.normal(0, 0.5)
    kept = rng.random(len(spots)) > rng.choice([0.0, 0.3])
    parts = [base]
    for x, y in spots[kept]:
        tall = height * float(np.exp(grow * (x + y / 2)))
        parts.append(part.scale((0.8 * pitch, 0.8 * pitch, tall)).translate((x, y, 0.08 + tall / 2)))
    return union(parts)


def draped_sheet(rng: Generator) -> Manifold:
    """A thin outline warped: leaf, cloth, seat shell, crisp."""
    sheet = pierced(rng, outline(rng), int(rng.integers(0, 3))).extrude(rng.uniform(0.025, 0.07))
    for _ in range(rng.integers(1, 3)):
        sheet = lumpy(rng, sheet, rng.uniform(0.5, 1.1), waves=4, edge=0.07)
    return bent(rng, sheet)
