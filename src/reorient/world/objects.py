"""Sets of objects: generated ones, a folder of meshes, or a pip package that ships meshes."""

import importlib.util
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import trimesh

from reorient.errors import ReorientError, check_counts, check_range, unknown_name
from reorient.world import shapes
from reorient.world.meshes import load_mesh

PACKAGES = ("example-robot-data", "rtb-data", "pybullet")  # pip packages with meshes
VALIDATION_SHARE = 0.1  # of the objects for training
MESH_SUFFIXES = (".npz", ".obj", ".stl", ".ply", ".dae", ".off", ".glb", ".gltf", ".3mf")


@dataclass(frozen=True)
class ObjectSet:
    """Named meshes, loaded on demand, in the units and about the origin of the source."""

    source: str
    names: tuple[str, ...]
    load: Callable[[str], trimesh.Trimesh]
    """Loads the mesh of a name; raises ReorientError for a broken file."""

    def only(self, names: Sequence[str]) -> "ObjectSet":
        """The subset with these names, in this order. Raises ReorientError for a name the set does not have."""
        known = set(self.names)
        for name in names:
            if name not in known:
                raise unknown_name("object", name, list(self.names))
        return ObjectSet(self.source, tuple(names), self.load)


@dataclass(frozen=True)
class Split:
    """Indices of the objects in three disjoint parts of a set."""

    train: tuple[int, ...]
    validation: tuple[int, ...]
    test: tuple[int, ...]


def split(names: Sequence[str], test_objects: int | None = None) -> Split:
    """Split by a hash of the name: a fifth for testing unless given, a tenth of the others for validation.

    Raises ReorientError if a part would be empty.
    """
    test = len(names) // 5 if test_objects is None else test_objects
    order = sorted(range(len(names)), key=lambda i: zlib.crc32(names[i].encode()))
    rest = order[test:]
    validation = max(1, round(VALIDATION_SHARE * len(rest)))
    if test < 1 or len(rest) <= validation:
        raise ReorientError(
            f"{len(names)} objects, {test} for testing: expected some for training, validation and testing"
        )
    return Split(tuple(rest[validation:]), tuple(rest[:validation]), tuple(order[:test]))


def generated(count: int, seed: int = 0) -> ObjectSet:
    """The first ``count`` objects of the procedural generator's sequence ``seed``."""
    if count < 1 or seed < 0:
        raise ReorientError(f"{count} generated objects of seed {seed}: expected at least 1, of a seed from 0")
    names = tuple(f"generated-{seed}-{index:06d}" for index in range(count))
    return ObjectSet("generated", names, _generate)


def folder(path: str | Path) -> ObjectSet:
    """All meshes below a folder, named by their relative path, with the suffix only where names would collide.

    Raises ReorientError if there is none.
    """
    root = Path(path)
    if not root.is_dir():
        raise ReorientError(f"no folder {str(path)!r}: expected a folder with {', '.join(MESH_SUFFIXES)} files")
    files: dict[str, Path] = {}
    for file in sorted(root.rglob("*")):
        if file.suffix.lower() in MESH_SUFFIXES:
            name = file.relative_to(root).with_suffix("").as_posix()
            files[file.relative_to(root).as_posix() if name in files else name] = file
    if not files:
        raise ReorientError(f"no meshes in {str(path)!r}: expected {', '.join(MESH_SUFFIXES)} files")
    return ObjectSet(str(root), tuple(files), partial(_load_file, files))


def package(name: str) -> ObjectSet:
    """The meshes of an installed pip package. Raises ReorientError if it is not installed."""
    if name not in PACKAGES:
        raise unknown_name("mesh package", name, list(PACKAGES))
    module = {"pybullet": "pybullet_data"}.get(name)
    if module and (spec := importlib.util.find_spec(module)) and spec.submodule_search_locations:
        return folder(Path(spec.submodule_search_locations[0]) / "random_urdfs")
    try:
        shipped = metadata.files(name) or []
    except metadata.PackageNotFoundError:
        shipped = []
    meshes = {
        file.with_suffix("").as_posix(): Path(str(file.locate()))
        for file in sorted(shipped, key=str)
        if file.suffix.lower() in MESH_SUFFIXES
    }
    if not meshes:
        raise ReorientError(f"package {name!r} is not installed: expected `pip install {name}`")
    return ObjectSet(name, tuple(meshes), partial(_load_file, meshes))


@dataclass(frozen=True)
class ObjectSource:
    """Source of the objects.

    They are generated unless a folder or a package is given.
    """

    meshes: Path | None = None
    """Folder of meshes (.obj, .stl, .ply, .dae, .npz with v and f, ...)."""
    package: str | None = None
    """Installed pip package with meshes: example-robot-data, rtb-data or pybullet."""
    only: Path | None = None
    """Text file with the names of the objects to use, one a line."""
    count: int = 100
    """Number of objects to generate."""
    object_seed: int = 0
    """Seed of the generator of objects."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_counts(self, "count")
        check_range(self, "object_seed")

    @classmethod
    def from_json(cls, described: dict[str, Any]) -> "ObjectSource":
        """The source from its ``asdict`` in a JSON file."""
        paths = {key: Path(described[key]) for key in ("meshes", "only") if described[key] is not None}
        return cls(**described | paths)

    def open(self) -> ObjectSet:
        """The object set. Raises ReorientError for a missing folder or package, and for an unknown name."""
        if self.meshes is not None and self.package is not None:
            raise ReorientError("both --meshes and --package given: expected one source of objects")
        if self.meshes is not None:
            objects = folder(self.meshes)
        elif self.package is not None:
            objects = package(self.package)
        else:
            objects = generated(self.count, self.object_seed)
        if self.only is None:
            return objects
        if not self.only.is_file():
            raise ReorientError(f"no file {str(self.only)!r}: expected object names, one a line")
        lines = self.only.read_text(encoding="utf-8-sig", errors="surrogateescape").splitlines()
        names = [line.strip() for line in lines if line.strip()]
        if not names:
            raise ReorientError(f"no names in {str(self.only)!r}: expected object names, one a line")
        return objects.only(names)


def _generate(name: str) -> trimesh.Trimesh:
    _, seed, index = name.rsplit("-", 2)
    return shapes.generate(int(seed), int(index))


def _load_file(files: dict[str, Path], name: str) -> trimesh.Trimesh:
    return load_mesh(files[name])
