"""Families of artefacts: vessels, tools, mechanisms, vehicles, lamps, appliances."""

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.random import Generator

from reorient.world.shapes.furniture import legs
from reorient.world.shapes.solids import (
    ball,
    box,
    chance,
    extents,
    fit,
    lathe_profile,
    limb,
    ngon,
    outline,
    pierced,
    polygon,
    primitive,
    revolved,
    revolved_shell,
    rod,
    smooth_path,
    soft_box,
    sweep,
    tilt,
    union,
)


def vessel(rng: Generator) -> Manifold:
    """Mug, jug, vase, pan or watering can: a revolved shell, with or without a handle and a spout."""
    wide = float(np.exp(rng.normal(-1.0, 0.35)))
    profile = lathe_profile(rng, wide, 0.25)
    solid = revolved_shell(profile, wide * rng.uniform(0.08, 0.18), int(rng.choice([8, 32, 40])))
    room = revolved(profile * (0.85, 0.95) + (0, 0.1), 32)
    kind, grip = rng.integers(4), wide * rng.uniform(0.08, 0.16)
    low, high = np.sort(rng.uniform(0.1, 0.95, 2))
    inner, outer = np.interp([low, high], profile[:, 1], profile[:, 0]) * 0.95
    reach = wide * rng.uniform(0.5, 1.2)
    if kind < 2:  # an ear, on one side or both
        knots = [(inner, 0, low), (inner + reach, 0, low + 0.1), (outer + reach, 0, high), (outer, 0, high - 0.03)]
        ear = sweep(smooth_path(np.array(knots)), ngon(8, 0.6), grip) - room
        solid += ear if kind else union([ear, ear.mirror((1, 0, 0))])
    elif kind == 2:  # a straight handle, as of a pan
        solid += limb([(inner, 0, low), (inner + reach * 2.5, 0, low + rng.uniform(0, 0.4))], (grip, grip * 1.4)) - room
    else:  # a bail over the top
        rim = float(profile[-1, 0]) * 0.93
        arc = np.array([(-rim, 0, 0.9), (-rim * 0.8, 0, 1 + wide), (rim * 0.8, 0, 1 + wide), (rim, 0, 0.9)])
        solid += sweep(smooth_path(arc), ngon(8), grip * 0.7)
    if chance(rng, 0.5):
        foot = np.array([-wide * 0.7, rng.normal(0, 0.1), rng.uniform(0.1, 0.6)])
        tip = np.add(foot, (-wide * rng.uniform(0.6, 1.6), 0, rng.uniform(0.1, 0.6)))
        bend = (foot + tip) / 2 - (0.1 * wide, 0, 0.08)
        path = smooth_path(np.array([foot, bend, tip]), 12)
        solid += sweep(path, ngon(12), np.linspace(0.28, 0.12, 12) * wide) - room
    return solid


def bottle(rng: Generator) -> Manifold:
    """A closed vessel: body of any outline, shoulder, neck and cap, with a trigger, pump, grip or label panel."""
    body = outline(rng).hull().offset(0.05, circular_segments=16)
    height, neck, top = rng.uniform(0.5, 2), rng.uniform(0.08, 0.25), rng.uniform(0.1, 0.4)
    solid = fit(body.extrude(1.0), (0.8, rng.uniform(0.35, 0.8), height)).translate((0, 0, height / 2))
    collar = Manifold.cylinder(0.02, neck, neck, 24).translate((rng.choice([0, 0, 0.2]), 0, height + top))
    cap = collar.scale((0.8, 0.8, 8)).translate((0, 0, -7 * (height + top)))
    solid = Manifold.batch_hull([solid, collar]) + cap
    end = height + top + 0.1
    if chance(rng, 0.5):
        solid += soft_box((0.5, neck * 1.6, 0.15), (-0.1, 0, end + 0.1))
        solid += limb([(-0.25, 0, end + 0.05), (-0.3, 0, end - top)], (0.04, 0.03))
    if chance(rng, 0.5):
        grip = smooth_path(np.array([(0.35, 0, 0.3), (0.6, 0, 0.4), (0.55, 0, 0.7), (0.3, 0, 0.8)]) * (1, 1, height))
        solid += sweep(grip, ngon(8), 0.06)
    if chance(rng, 0.4):
        solid -= box((0.5, 0.1, height * 0.5), (0, -float(extents(solid)[1]) / 2, height / 2))
    return solid


def hand_tool(rng: Generator) -> Manifold:
    """A handle with a head: hammer, spoon, spatula, fork, spanner, screwdriver, brush."""
    length, grip = rng.uniform(0.6, 1.3), rng.uniform(0.04, 0.1)
    profile = lathe_profile(rng, grip, 0.2) * (1, length)
    solid = revolved(profile, int(rng.choice([6, 16]))).scale((1, rng.uniform(0.5, 1), 1))
    width, kind = rng.uniform(0.15, 0.4), rng.integers(6)
    if kind == 0:
        head = union([box((width, 0.12, 0.14)), rod((0, 0, 0), (width, 0, rng.uniform(-0.1, 0.1)), 0.08, 0.1, 16)])
        head += Manifold.batch_hull([box((0.02, 0.1, 0.1)), box((0.02, 0.2, 0.02), (-width * 1.3, 0, -0.08))])
    elif kind == 1:
        bowl = ball((width, width * 1.3, width * 0.6), sides=24)
        head = bowl - bowl.scale((0.88, 0.9, 0.88)) - box((1, 1, 1), (0, 0, 0.55 - rng.uniform(0, 0.2) * width))
        head = head.rotate((rng.uniform(20, 90), 0, 0)).translate((0, 0, width * 0.5))
    elif kind == 2:
        head = fit(
            pierced(rng, outline(rng).hull(), 3).extrude(0.05).rotate((90, 0, 0)), (width * 1.6, 0.04, width * 2)
        )
        head = head.rotate((rng.uniform(-40, 40), 0, 0)).translate((0, 0, width * 0.8))
    elif kind == 3:
        xs = np.linspace(-width, width, int(rng.integers(2, 6))) * 0.7
        tines = [limb([(x, 0, 0), (x, -0.1, width), (x, 0, width * 2)], (0.03, 0.025, 0.015), 6) for x in xs]
        head = union([*tines, box((width * 1.5, 0.06, 0.06))])
    elif kind == 4:
        jaw = CrossSection.circle(width * 0.7, 24) - CrossSection.square((width * 0.6, width * 1.2), True).translate(
            (0, 0.5 * width)
        )
        head = jaw.rotate(rng.uniform(-30, 30)).extrude(0.1).translate((0, 0, -0.05)).rotate((90, 0, 0))
        head = head.translate((0, 0, 0.3 * width))
    else:
        head = rod((0, 0, -0.1), (0, 0, width * 2.5), 0.025, 0.015, 8) + box(
            (width * 0.2, 0.02, 0.1), (0, 0, width * 2.5)
        )
    return union([solid, head.translate((rng.normal(0, 0.02), 0, length))])


def mechanism(rng: Generator) -> Manifold:
    """Gear, knob, pulley or crank: a toothed or round disc with hub, bore, spokes and a lever."""
    teeth, thick = int(rng.integers(6, 24)), rng.uniform(0.08, 0.5)
    step = np.arange(4 * teeth)
    depth = np.where(step % 4 < 2, 0.5, 0.5 - rng.choice([0.03, 0.08, 0.12]))
    rim = polygon(
        depth[:, None] * np.column_stack([np.cos(step * np.pi / 2 / teeth), np.sin(step * np.pi / 2 / teeth)])
    )
    if chance(rng, 0.3):
        rim = CrossSection.circle(0.5, 40)
    if chance(rng, 0.6):
        spokes = int(rng.integers(2, 7))
        gap = CrossSection.circle(rng.uniform(0.06, 0.13), 16).translate((rng.uniform(0.2, 0.28), 0))
        rim -= CrossSection.compose([gap.rotate(360.0 * i / spokes) for i in range(spokes)])
    hub = Manifold.cylinder(thick * rng.uniform(1.2, 4), 0.15, rng.uniform(0.08, 0.15), 24)
    solid = union([rim.extrude(thick), hub])
    if chance(rng, 0.6):
        angle = rng.uniform(0, 2 * np.pi)
        reach = rng.uniform(0.45, 1.1) * np.array([np.cos(angle), np.sin(angle)])
        height = thick + rng.uniform(0, 0.2)
        lever = limb([(0, 0, height), (*reach, height)], (0.1, 0.06)) + rod(
            (*reach, height), (*reach, height + 0.4), 0.05
        )
        solid += lever
    bore = union([Manifold.cylinder(6, 0.06, 0.06, 16, True), box((0.05, 0.2, 6), (0, 0.05, 0))])
    return solid - bore if chance(rng, 0.7) else solid


def vehicle(rng: Generator) -> Manifold:
    """A body of some side profile on wheels, with a cabin, load or spoiler."""
    length, width, height = rng.uniform(1, 2), rng.uniform(0.4, 0.7), rng.uniform(0.2, 0.4)
    wheel = rng.uniform(0.12, 0.24)
    side = [(0, 0), (1, 0), (1, rng.uniform(0.4, 1)), (rng.uniform(0.5, 0.8), 1), (0.2, 1), (0, rng.uniform(0.4, 1))]
    body = polygon(np.array(side) * (length, height)).extrude(width).rotate((90, 0, 0))
    parts = [body.translate((-length / 2, width / 2, wheel))]
    roof, front = rng.uniform(0.15, 0.5), rng.uniform(-0.3, 0.2) * length
    long, short = rng.uniform(0.25, 0.5) * length, rng.uniform(0.5, 0.95)
    cabin = [box((long, width * 0.95, 0.02)), box((long * short, width * 0.8, 0.02), (rng.uniform(-0.1, 0.1), 0, roof))]
    parts.append(Manifold.batch_hull(cabin).translate((front, 0, wheel + height - 0.02)))
    axles = np.linspace(-0.38, 0.35, int(rng.integers(2, 4))) * length
    for x in axles:
        for s in (-1, 1):
            y, size = s * width / 2, wheel * rng.choice([1.0, 1.0, 1.3])
            parts.append(rod((x, y - 0.07, wheel), (x, y + 0.07, wheel), size, sides=24))
    if chance(rng, 0.6):
        size = np.array([rng.uniform(0.2, 0.5) * length, width * rng.uniform(0.3, 0.9), rng.uniform(0.1, 0.4)])
        at = (rng.choice([-1, 1]) * (length - size[0]) / 2 * 0.9, 0, wheel + height + 0.4 * size[2])
        parts.append(primitive(rng, size).translate(at))
    if chance(rng, 0.4):
        tail, reach = np.array([-0.4 * length, 0, wheel + height]), np.array([-0.1, 0, 0.35])
        parts += [rod(tail, tail + reach, 0.04), box((0.12, width, 0.04), tail + reach)]
    return union(parts)


def flyer(rng: Generator) -> Manifold:
    """A long body with paired and single fins: plane, fish, bird, rocket."""
    length, girth = rng.uniform(0.8, 1.4), rng.uniform(0.06, 0.16)
    x = np.linspace(-0.5, 0.5, 14) * length
    path = np.column_stack([x, rng.normal(0, 0.1) * x**2, rng.normal(0, 0.15) * np.sin(3 * x)])
    fullness = girth * (0.15 + np.sin(np.linspace(0.1, 2.9, 14)) ** rng.uniform(0.4, 1.5))
    parts = [sweep(path, ngon(12, rng.uniform(0.6, 1.5)), fullness)]

    def fin(root: float, span: float, chord: float, roll: float) -> Manifold:
        sweepback, tip = rng.uniform(-0.1, 0.7) * span, rng.uniform(0.2, 0.9)
        shape = np.array([(0, 0), (chord, 0), (chord * tip - sweepback, span), (-sweepback, span)])
        blade = polygon(shape).extrude(0.035).translate((root * length - chord / 2, 0, -0.0175))
        return blade.rotate((roll, 0, 0))

    for root, size in ((rng.uniform(-0.1, 0.2), rng.uniform(0.3, 0.8)), (-0.42, rng.uniform(0.1, 0.35))):
        roll, chord = rng.uniform(-30, 50), size * rng.uniform(0.25, 0.7)
        wing = fin(root, size, chord, roll)
        parts += [wing, wing.mirror((0, 1, 0))]
    parts.append(fin(-0.42, rng.uniform(0.15, 0.35), 0.2, 90))
    for _ in range(rng.integers(0, 3)):
        at = (rng.uniform(-0.2, 0.3) * length, rng.uniform(-0.2, 0.2), -girth * rng.uniform(0.5, 1))
        parts.append(ball((0.15, 0.06, 0.06), at, 12))
    return union(parts)


def lamp(rng: Generator) -> Manifold:
    """A base, a stem straight, jointed or curved, and one shade or several heads."""
    height, stem = rng.uniform(0.5, 1.6), rng.uniform(0.015, 0.05)
    base = fit(outline(rng).hull().extrude(1.0), (rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.6), rng.uniform(0.03, 0.2)))
    lean = rng.normal(0, 0.25, 2)
    parts = [base]
    for _ in range(rng.choice([1, 1, 2, 3])):
        lean = lean + rng.normal(0, 0.25, 2)
        knots = np.array(
            [(0, 0, 0), (-lean[0] * 0.6, -lean[1] * 0.6, height * 0.5), (*lean, height * rng.uniform(0.7, 1))]
        )
        path = smooth_path(knots, 16) if chance(rng, 0.6) else knots
        parts.append(limb(path, [stem] * len(path), 6))
        wide = rng.uniform(0.15, 0.35)
        low, high = wide * rng.uniform(0.6, 1.1), wide * rng.uniform(0.3, 0.9)
        profile = np.column_stack([np.linspace(high, low, 12), np.linspace(0, 1, 12) * rng.uniform(0.2, 0.45)])
        shade = revolved_shell(profile, 0.03, 24) if chance(rng, 0.7) else ball(wide, sides=16)
        parts.append(tilt(shade, (*(rng.normal(0, 0.5, 2) + lean), rng.choice([-1, 1, -0.5])), path[-1]))
    return union(parts)


def appliance(rng: Generator) -> Manifold:
    """A housing with a door or screen, knobs, vents, feet or top part: oven, radio, toaster, mixer, projector."""
    size = rng.uniform(0.4, 1.0, 3)
    width, depth, height = size
    body = soft_box(size, rounding=rng.uniform(0.02, 0.25), sides=int(rng.choice([4, 12])))
    front = -depth / 2
    if chance(rng, 0.6):
        at = np.array([rng.uniform(-0.15, 0.15) * width, front, rng.uniform(-0.1, 0.1) * height])
        door = box((width * rng.uniform(0.4, 0.7), depth * rng.uniform(0.06, 1.2), height * rng.uniform(0.3, 0.7)), at)
        hatch = rod(at - (0, 0.05, 0), np.add(at, (0, 0.1, 0)), 0.35 * min(width, height), sides=32)
        body = body - door if chance(rng, 0.6) else body + hatch
    for _ in range(rng.integers(1, 6)):
        at = np.array([rng.uniform(-0.4, 0.4) * width, front, rng.uniform(-0.42, 0.42) * height])
        body += rod(np.add(at, (0, 0.05, 0)), at - (0, rng.uniform(0.03, 0.12), 0), rng.uniform(0.03, 0.1), sides=16)
    if chance(rng, 0.5):
        n, high = int(rng.integers(2, 7)), height * rng.uniform(0.2, 0.7)
        xs = np.linspace(-0.3, 0.3, n) * width
        body -= union(box((width * 0.3 / n, depth * 0.6, high), (x, 0.1 * depth, height / 2)) for x in xs)
    if chance(rng, 0.5):
        top = rng.uniform(0.2, 0.8, 3) * size
        body += primitive(rng, top).translate(
            (rng.uniform(-0.3, 0.3) * width, rng.uniform(-0.4, 0.2) * depth, height / 2 + top[2] * 0.4)
        )
    if chance(rng, 0.4):
        body += legs(rng, width * 0.9, depth * 0.9, 0.2, 0.06).translate((0, 0, -height / 2 - 0.15))
    return body
