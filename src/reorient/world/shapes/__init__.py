"""Procedurally generated objects: a family of constructions, random details, one closed surface.

``generate(seed, index)`` is object ``index`` of an endless series. Families are construction rules for household
objects, from machine parts to furniture, vessels, tools, vehicles, plants and animals; each draws its own proportions.
Objects stand with z up; lengths are arbitrary until the object is scaled to unit radius.
"""

import numpy as np
import trimesh
from manifold3d import Manifold
from numpy.random import Generator

from reorient.errors import ReorientError
from reorient.world.meshes import check_surface, scale_to_radius
from reorient.world.shapes.compounds import Family, assembly, drawn, is_solid, mirrored
from reorient.world.shapes.deformations import bent, detailed, lumpy
from reorient.world.shapes.furniture import chair, frame, relief_panel, shelves, table, upholstery
from reorient.world.shapes.living import branches, creature, plant
from reorient.world.shapes.parts import (
    array,
    bent_pipe,
    bracket,
    cluster,
    crossed_profiles,
    draped_sheet,
    machined_block,
    pebble,
    profile_bar,
    rock,
    tray,
    turned_part,
)
from reorient.world.shapes.solids import (
    chance,
    extents,
)
from reorient.world.shapes.things import appliance, bottle, flyer, hand_tool, lamp, mechanism, vehicle, vessel

MAX_FACES = 5000
MIN_FACES = 30
MAX_ASPECT = 12.0

FAMILIES: tuple[Family, ...] = (
    cluster,
    machined_block,
    crossed_profiles,
    profile_bar,
    turned_part,
    bent_pipe,
    tray,
    pebble,
    rock,
    bracket,
    array,
    mirrored,
    draped_sheet,
    chair,
    table,
    shelves,
    upholstery,
    frame,
    relief_panel,
    vessel,
    bottle,
    hand_tool,
    mechanism,
    vehicle,
    flyer,
    lamp,
    branches,
    plant,
    creature,
    appliance,
    assembly,
)


def largest_part(solid: Manifold) -> Manifold:
    """The connected part with the largest bounding box."""
    return max(solid.decompose(), key=lambda part: float(np.prod(extents(part))), default=solid)


def varied(rng: Generator, solid: Manifold) -> Manifold:
    """The solid with details that break its symmetry (often), bent or warped (sometimes), stretched along each axis."""
    if chance(rng, 0.55):
        solid = detailed(rng, solid, int(rng.integers(1, 4)))
    if chance(rng, 0.15):
        solid = bent(rng, solid)
    if chance(rng, 0.1):
        solid = lumpy(rng, solid, rng.uniform(0.2, 0.6))
    return solid.scale(np.exp(rng.normal(0, 0.2, 3)))


def within_limits(solid: Manifold) -> Manifold:
    """The solid thickened to the largest allowed aspect, and simplified or refined to the allowed number of faces."""
    size = extents(solid)
    solid = solid.scale(np.maximum(1.0, size.max() / (MAX_ASPECT * size)))
    while solid.num_tri() < MIN_FACES:
        solid = solid.refine(2)
    for tolerance in 1e-4 * float(size.max()) * 3.0 ** np.arange(5):
        if solid.num_tri() > MAX_FACES:
            solid = solid.simplify(tolerance)
    return solid


def generate(seed: int, index: int) -> trimesh.Trimesh:
    """Object ``index`` of the series of this seed: a closed mesh of unit radius about the centre of its bounding box.

    The same arguments give the same bytes. ``metadata`` contains ``name`` and ``family``. Raises ReorientError for a
    negative seed or index.
    """
    if seed < 0 or index < 0:
        raise ReorientError(f"generated object of seed {seed}, index {index}: expected both to be at least 0")
    rng = np.random.default_rng([seed, index])
    while True:  # the variation, too, can produce a sliver or too many faces
        family, solid = drawn(rng, FAMILIES)
        solid = largest_part(varied(rng, solid))
        if is_solid(solid) and (solid := within_limits(solid)).num_tri() <= MAX_FACES:
            break
    mesh = solid.to_mesh64()
    metadata = {"name": f"generated-{seed}-{index:06d}", "family": family.__name__}
    surface = trimesh.Trimesh(mesh.vert_properties, mesh.tri_verts.astype(np.int64), process=False, metadata=metadata)
    return scale_to_radius(check_surface(surface, metadata["name"]), 1.0)
