"""Drawing from families, and families composed of objects of other families."""

from collections.abc import Callable, Sequence

import numpy as np
from manifold3d import Manifold
from numpy.random import Generator

from reorient.world.shapes.deformations import randomly_rotated, surface_points
from reorient.world.shapes.living import branches
from reorient.world.shapes.parts import (
    array,
    bent_pipe,
    cluster,
    crossed_profiles,
    pebble,
    profile_bar,
    rock,
    tray,
    turned_part,
)
from reorient.world.shapes.solids import (
    box,
    extents,
    fit,
    tilt,
    union,
)
from reorient.world.shapes.things import mechanism

Family = Callable[[Generator], Manifold]


def is_solid(solid: Manifold) -> bool:
    """Whether the solid is usable: not empty, no sliver, not almost without volume."""
    if solid.is_empty() or not np.all(np.isfinite(solid.bounding_box())):
        return False
    size = extents(solid)
    return bool(size.min() > 0.004 * size.max() and solid.volume() > 1e-3 * np.prod(size))


def drawn(rng: Generator, families: Sequence[Family]) -> tuple[Family, Manifold]:
    """A random family and an object of it; a degenerate object is drawn again."""
    while True:
        family = families[int(rng.integers(len(families)))]
        solid = family(rng)
        if is_solid(solid):
            return family, solid


def mirrored(rng: Generator) -> Manifold:
    """A half and its mirror image: masks, spectacles, clamps, toys."""
    _, half = drawn(rng, (cluster, bent_pipe, crossed_profiles, branches, pebble))
    half = fit(randomly_rotated(rng, half), rng.uniform(0.5, 1.2, 3))
    # pushed through the mirror plane, so that the halves join
    half = half.translate((rng.uniform(0.1, 0.9) * float(extents(half)[0]) / 2, 0, 0)).trim_by_plane((1, 0, 0), 0.0)
    bridge = box((0.3, rng.uniform(0.1, 0.3), rng.uniform(0.1, 0.3)))
    return union([half, half.mirror((1, 0, 0)), bridge])


def assembly(rng: Generator) -> Manifold:
    """Two or three objects of other families grown together."""
    kinds = (cluster, turned_part, profile_bar, bent_pipe, tray, pebble, crossed_profiles, rock, mechanism, array)
    solid = fit(drawn(rng, kinds)[1], np.exp(rng.normal(0, 0.4, 3)))
    for _ in range(rng.integers(1, 3)):
        [point], [normal] = surface_points(rng, solid, 1)
        size = np.exp(rng.normal(-0.4, 0.45, 3))
        solid += tilt(fit(drawn(rng, kinds)[1], size), normal, point + normal * size[2] * 0.3)
    return solid
