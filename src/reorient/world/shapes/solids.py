"""Building blocks of generated objects: primitives, outlines, solids of revolution, sweeps.

A solid is a ``manifold3d.Manifold``, an outline a ``CrossSection``. Lengths are in arbitrary units; objects are about 1
across, z up. All random draws come from the ``rng`` argument.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from jaxtyping import Float
from manifold3d import CrossSection, Manifold, Mesh64, OpType
from numpy.random import Generator
from scipy.interpolate import PchipInterpolator

Point = Sequence[float] | np.ndarray


def chance(rng: Generator, probability: float) -> bool:
    """True with this probability."""
    return bool(rng.random() < probability)


def union(parts: Iterable[Manifold]) -> Manifold:
    """The union of all parts."""
    return Manifold.batch_boolean(list(parts), OpType.Add)


def extents(solid: Manifold) -> Float[np.ndarray, " 3"]:
    """Side lengths of the bounding box."""
    bounds = np.array(solid.bounding_box())
    return np.asarray(bounds[3:] - bounds[:3])


def fit(solid: Manifold, size: Point) -> Manifold:
    """Centred on the origin and stretched to this bounding box."""
    bounds = np.array(solid.bounding_box())
    return solid.translate(-(bounds[3:] + bounds[:3]) / 2).scale(np.asarray(size) / (bounds[3:] - bounds[:3]))


def tilt(solid: Manifold, direction: Point, at: Point = (0.0, 0.0, 0.0)) -> Manifold:
    """Rotated so that its z axis points along the direction, then moved."""
    z = np.asarray(direction, float) / np.linalg.norm(direction)
    # the axis least along z, so that an axis-aligned direction keeps the part axis-aligned
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return solid.transform(np.column_stack([x, np.cross(z, x), z, np.asarray(at, float)]))


# --- primitives -----------------------------------------------------------------------------------------------------


def box(size: Point, at: Point = (0.0, 0.0, 0.0)) -> Manifold:
    """A box by its side lengths and centre."""
    return Manifold.cube(np.asarray(size, float), True).translate(np.asarray(at, float))


def ball(radii: float | Point, at: Point = (0.0, 0.0, 0.0), sides: int = 16) -> Manifold:
    """An ellipsoid by its radii and centre."""
    return Manifold.sphere(1.0, sides).scale(np.broadcast_to(radii, 3)).translate(np.asarray(at, float))


def soft_box(size: Point, at: Point = (0.0, 0.0, 0.0), rounding: float = 0.15, sides: int = 8) -> Manifold:
    """A box with rounded edges (bevelled when ``sides`` is 4); the radius is a share of the shortest side."""
    size, at = np.asarray(size, float), np.asarray(at, float)
    radius = rounding * size.min()
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3) * (size / 2 - radius)
    return Manifold.batch_hull([ball(radius, corner, sides) for corner in corners]).translate(at)


def rod(start: Point, end: Point, radius: float, end_radius: float | None = None, sides: int = 12) -> Manifold:
    """A cylinder or cone frustum from one point to another."""
    start, axis = np.asarray(start, float), np.subtract(end, start)
    tip = radius if end_radius is None else end_radius
    return tilt(Manifold.cylinder(float(np.linalg.norm(axis)), radius, tip, sides), axis, start)


def beam(start: Point, end: Point, width: float, depth: float) -> Manifold:
    """A square-edged bar from one point to another; ``width`` and ``depth`` of its cross-section in the units of the
    points."""
    axis = np.subtract(end, start)
    return tilt(box((width, depth, float(np.linalg.norm(axis)))), axis, np.add(start, end) / 2)


def primitive(rng: Generator, size: Point) -> Manifold:
    """A box, bevelled box, prism, frustum, ball, wedge, ring or half cylinder of this size, along any axis."""
    sides = int(rng.choice([3, 5, 6, 8, 24, 32]))
    wedge = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [0, rng.random(), 1]], float)
    ring = CrossSection.circle(rng.uniform(0.08, 0.22), 10).translate((0.4, 0.0)).revolve(28)
    makers: tuple[Callable[[], Manifold], ...] = (
        lambda: box((1, 1, 1)),
        lambda: soft_box((1, 1, 1), rounding=rng.uniform(0.05, 0.4), sides=int(rng.choice([4, 8, 12]))),
        lambda: Manifold.cylinder(1.0, 0.5, 0.5, sides),
        lambda: Manifold.cylinder(1.0, 0.5, rng.uniform(0.05, 0.4), sides),
        lambda: ball(0.5, sides=24),
        lambda: Manifold.hull_points(wedge),
        lambda: ring,
        lambda: Manifold.cylinder(1.0, 0.5, 0.5, 32).trim_by_plane((1, 0, 0), -0.1),
    )
    solid = makers[rng.choice(len(makers), p=[0.17, 0.17, 0.2, 0.1, 0.12, 0.1, 0.07, 0.07])]()
    return fit(solid.rotate(90.0 * rng.integers(0, 4, 3)), size)


# --- outlines, extruded or revolved ---------------------------------------------------------------------------------


def polygon(points: Float[np.ndarray, "n 2"]) -> CrossSection:
    """The region inside counterclockwise points."""
    return CrossSection([points])


def radial(rng: Generator, n: int = 32) -> Float[np.ndarray, "{n} 2"]:
    """Points of a smooth star-shaped blob of radius about 0.5."""
    angle = np.arange(n) * 2 * np.pi / n
    waves = np.arange(1, 6)
    amplitude = rng.normal(0, 0.22, 5) / waves
    radius = 0.5 * np.exp(np.sin(angle[:, None] * waves + rng.uniform(0, 2 * np.pi, 5)) @ amplitude)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def outline(rng: Generator) -> CrossSection:
    """A rounded rectangle, disc, regular polygon, blob, some rectangles, sector, star or hull, about 1 across."""

    def rectangles() -> CrossSection:
        slabs = rng.uniform(0.15, 0.35, (rng.integers(1, 4), 2))
        slabs[np.arange(len(slabs)), rng.integers(0, 2, len(slabs))] = rng.uniform(0.6, 1.0, len(slabs))
        arms = [CrossSection.square(slab, True).translate(rng.uniform(-0.12, 0.12, 2)) for slab in slabs]
        return CrossSection.batch_boolean([CrossSection.square(rng.uniform(0.25, 0.6, 2), True), *arms], OpType.Add)

    def star() -> CrossSection:
        teeth, depth = int(rng.integers(3, 10)), rng.uniform(0.4, 0.85)
        angle = np.arange(2 * teeth) * np.pi / teeth
        radius = np.where(np.arange(2 * teeth) % 2, 0.5 * depth, 0.5)
        return polygon(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))

    def sector() -> CrossSection:
        angle = np.linspace(0, rng.uniform(0.5, 1.7) * np.pi, 24)
        arc = 0.5 * np.column_stack([np.cos(angle), np.sin(angle)])
        return polygon(np.concatenate([arc, arc[::-1] * rng.uniform(0.05, 0.7)]))

    kinds: tuple[Callable[[], CrossSection], ...] = (
        lambda: CrossSection.square((1, rng.uniform(0.3, 1)), True).offset(-0.12).offset(0.12, circular_segments=24),
        lambda: CrossSection.circle(0.5, 40).scale((1, rng.uniform(0.4, 1))),
        lambda: CrossSection.circle(0.5, int(rng.integers(3, 9))),
        lambda: polygon(radial(rng)),
        rectangles,
        sector,
        star,
        lambda: CrossSection.hull_points(rng.uniform(-0.5, 0.5, (rng.integers(4, 9), 2))),
    )
    return kinds[rng.integers(len(kinds))]()


def pierced(rng: Generator, shape: CrossSection, n: int) -> CrossSection:
    """The outline with n round, square or slotted holes at random positions."""
    low, high = np.reshape(shape.bounds(), (2, 2))
    holes = []
    for _ in range(n):
        width, length = rng.uniform(0.08, 0.3, 2) * np.min(high - low)
        slot = CrossSection.square((width, length), True) if chance(rng, 0.5) else CrossSection.circle(width / 2, 20)
        holes.append(slot.rotate(rng.choice([0.0, 30.0, 90.0])).translate(rng.uniform(low, high)))
    # a margin stays whole, so that the holes do not open the rim
    return shape - (CrossSection.compose(holes) ^ shape.offset(-0.05 * float(np.min(high - low))))


def lathe_profile(rng: Generator, mean: float, wobble: float = 0.4, n: int = 14) -> Float[np.ndarray, "{n} 2"]:
    """Radii (around ``mean``) and heights (0 to 1) of a solid of revolution, rounded or in straight steps."""
    knots = int(rng.integers(3, 7))
    z = np.concatenate([[0.0], np.sort(rng.uniform(0.08, 0.92, knots - 2)), [1.0]])
    radii = mean * np.exp(rng.normal(0, wobble, knots))
    height = np.linspace(0, 1, n)
    radius = PchipInterpolator(z, radii)(height) if chance(rng, 0.6) else radii[np.searchsorted(z, height)]
    return np.column_stack([radius, height])


def meridian(profile: Float[np.ndarray, "n 2"]) -> CrossSection:
    """The region between the axis and radii at rising heights."""
    axis = np.array([[0.0, profile[-1, 1]], [0.0, profile[0, 1]]])
    return polygon(np.concatenate([profile, axis]))


def revolved(profile: Float[np.ndarray, "n 2"], segments: int = 32, degrees: float = 360.0) -> Manifold:
    """A solid of revolution about z from radii and rising heights."""
    return meridian(profile).revolve(segments, degrees)


def revolved_shell(profile: Float[np.ndarray, "n 2"], wall: float, segments: int = 32) -> Manifold:
    """As ``revolved``, hollow and open at the top."""
    inner = profile[profile[:, 1] > profile[0, 1] + wall] - (wall, 0.0)
    inner[:, 0] = np.maximum(inner[:, 0], 0.2 * wall)
    inner[-1, 1] += wall  # cuts through the top rather than flush with it
    return (meridian(profile) - meridian(inner)).revolve(segments)


# --- sweeps ---------------------------------------------------------------------------------------------------------


def smooth_path(knots: Float[np.ndarray, "k 3"], n: int = 24) -> Float[np.ndarray, "{n} 3"]:
    """n points on a smooth curve through the knots."""
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    return np.asarray(PchipInterpolator(chord, knots)(np.linspace(0, chord[-1], n)))


def ngon(sides: int = 10, flat: float = 1.0) -> Float[np.ndarray, "{sides} 2"]:
    """Points of a regular polygon of radius 1, squeezed along y; the section of a sweep."""
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    return np.column_stack([np.cos(angle), flat * np.sin(angle)])


def sweep(path: Float[np.ndarray, "n 3"], section: Float[np.ndarray, "k 2"], scale: float | np.ndarray) -> Manifold:
    """A star-shaped section carried along a path without twist, scaled by a number or one number a point."""
    n, k = len(path), len(section)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    sides = np.empty_like(path)
    for i in range(n):
        side = side - tangent[i] * (side @ tangent[i])
        side = side / math.sqrt(side @ side)
        sides[i] = side
    offsets = section[:, :1] * sides[:, None] + section[:, 1:] * np.cross(tangent, sides)[:, None]
    rings = path[:, None] + np.broadcast_to(scale, n)[:, None, None] * offsets
    here = np.arange(n * k).reshape(n, k)
    after = np.roll(here, -1, axis=1)
    a, b, c, d = here[:-1].ravel(), after[:-1].ravel(), here[1:].ravel(), after[1:].ravel()
    first, last = np.full(k, n * k), np.full(k, n * k + 1)
    triangles = [(a, b, d), (a, d, c), (first, after[0], here[0]), (last, here[-1], after[-1])]
    faces = np.concatenate([np.column_stack(columns) for columns in triangles])
    vertices = np.concatenate([rings.reshape(-1, 3), path[[0, -1]]])
    return Manifold(Mesh64(vertices, faces.astype(np.uint64)))


def limb(points: Sequence[Point] | np.ndarray, radii: Sequence[float] | np.ndarray, sides: int = 8) -> Manifold:
    """A bar with round ends through the points, its radius given at each."""
    path, radius = np.asarray(points, float), np.asarray(radii, float)
    lift, shrink = np.array([0.97, 0.7]), np.array([0.25, 0.7])  # two rings of each hemisphere
    ends = []
    for tip, inward in ((0, 1), (-1, -2)):
        out = (path[tip] - path[inward]) / np.linalg.norm(path[tip] - path[inward])
        ends.append((path[tip] + radius[tip] * lift[:, None] * out, radius[tip] * shrink))
    (start, start_radius), (end, end_radius) = ends
    whole = np.concatenate([start, path, end[::-1]])
    return sweep(whole, ngon(sides), np.concatenate([start_radius, radius, end_radius[::-1]]))
