"""Objects and estimators that each worker loads once and uses for many tasks."""

from functools import lru_cache

import trimesh

from reorient.estimators import load_estimator
from reorient.estimators.base import Estimator
from reorient.world.objects import ObjectSource
from reorient.world.symmetry import SymmetryGroup, rotation_group


@lru_cache(maxsize=32)
def cached_object(source: ObjectSource, name: str) -> tuple[trimesh.Trimesh, SymmetryGroup]:
    """The mesh of an object and its symmetry group. Raises ReorientError for a broken mesh."""
    mesh = source.open().load(name)
    return mesh, rotation_group(mesh)


@lru_cache
def cached_estimator(name: str) -> Estimator:
    """As ``load_estimator``."""
    return load_estimator(name)
