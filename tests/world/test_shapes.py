import hashlib
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from reorient.errors import ReorientError
from reorient.world.meshes import bounding_radius, check_surface
from reorient.world.shapes import FAMILIES, MAX_ASPECT, MAX_FACES, MIN_FACES, generate

COUNT = 150


@pytest.fixture(scope="module")
def objects() -> list[trimesh.Trimesh]:
    return [generate(3, index) for index in range(COUNT)]


def digest(seed: int, indices: range) -> str:
    meshes = [generate(seed, index) for index in indices]
    return hashlib.sha256(b"".join(mesh.vertices.tobytes() + mesh.faces.tobytes() for mesh in meshes)).hexdigest()


@pytest.mark.slow
def test_same_bytes_in_another_process():
    code = "import test_shapes; print(test_shapes.digest(9, range(20)))"
    run = subprocess.run([sys.executable, "-c", code], cwd=__file__.rpartition("/")[0], capture_output=True, text=True)
    assert run.stdout.strip() == digest(9, range(20)), run.stderr


def test_seed_and_index_both_matter():
    assert len({digest(seed, range(index, index + 1)) for seed in (0, 1) for index in (0, 1, 10**9)}) == 6


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.__name__)
def test_family_yields_closed_solids(family):
    volumes = set()
    for seed in range(6):
        solid = family(np.random.default_rng([17, seed]))
        mesh = solid.to_mesh64()
        surface = trimesh.Trimesh(mesh.vert_properties, mesh.tri_verts.astype(np.int64), process=False)
        assert check_surface(surface).is_watertight
        assert surface.is_winding_consistent
        assert surface.volume > 0
        volumes.add(round(surface.volume, 9))
    assert len(volumes) == 6


def test_objects_are_single_closed_bodies_of_unit_radius(objects):
    for mesh in objects:
        name = mesh.metadata["name"]
        assert mesh.is_watertight, name
        assert mesh.volume > 0, name
        assert mesh.body_count == 1, name
        assert MIN_FACES <= len(mesh.faces) <= MAX_FACES, name
        assert bounding_radius(mesh) == pytest.approx(1.0), name
        assert np.allclose(mesh.bounds.sum(axis=0), 0, atol=1e-9), name
        assert mesh.extents.max() <= (MAX_ASPECT + 1e-6) * mesh.extents.min(), name


def test_objects_are_named_and_spread_over_the_families(objects):
    assert objects[7].metadata["name"] == "generated-3-000007"
    counts = {family.__name__: 0 for family in FAMILIES}
    for mesh in objects:
        counts[mesh.metadata["family"]] += 1
    assert sum(count > 0 for count in counts.values()) > 0.9 * len(FAMILIES)
    assert max(counts.values()) < COUNT / 8


def test_objects_vary_as_household_things_do(objects):
    aspect = np.array([mesh.extents.max() / mesh.extents.min() for mesh in objects])
    convexity = np.array([mesh.volume / mesh.convex_hull.volume for mesh in objects])
    genus = np.array([1 - mesh.euler_number // 2 for mesh in objects])
    assert np.allclose(np.percentile(aspect, [5, 25, 50, 75, 95]), [1.2, 1.6, 2.1, 2.9, 6.1], rtol=0.3)
    assert convexity.min() < 0.1
    assert convexity.max() > 0.9
    assert np.mean(genus == 0) > 0.2
    assert genus.max() >= 10


def flip_gap(mesh: trimesh.Trimesh) -> float:
    """Smallest share of points that a rotation by 180 degrees about x, y or z takes off the surface (by 0.1 radii)."""
    points, surface = mesh.sample(300, seed=1), cKDTree(mesh.sample(3000, seed=2))
    flips = 2 * np.eye(3)[:, :, None] * np.eye(3)[:, None] - np.eye(3)
    return min(float(np.mean(surface.query(points @ flip)[0] > 0.1)) for flip in flips)


def test_flip_gap_sees_a_symmetry_and_its_break():
    bar = trimesh.creation.box((0.4, 0.6, 1.8))
    assert flip_gap(bar) == 0
    knob = trimesh.creation.box((0.5, 0.5, 0.5), transform=trimesh.transformations.translation_matrix((0.4, 0.3, 0.7)))
    assert flip_gap(bar + knob) > 0.05


def test_most_objects_have_no_180_degree_symmetry(objects):
    gaps = np.array([flip_gap(mesh) for mesh in objects[:60]])
    assert np.mean(gaps > 0.05) > 0.6


@pytest.mark.parametrize(("seed", "index"), [(-1, 0), (0, -1)])
def test_negative_arguments_are_named(seed, index):
    with pytest.raises(ReorientError, match=rf"seed {seed}, index {index}: expected both"):
        generate(seed, index)
