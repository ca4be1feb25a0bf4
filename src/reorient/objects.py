"""Sets of objects: generated ones, a folder of meshes, or a pip package that ships meshes."""

import importlib.util
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path

import trimesh

from reorient import shapes
from reorient.errors import ReorientError, unknown_name
from reorient.meshes import load_mesh

PACKAGES = ("example-robot-data", "rtb-data", "pybullet")  # pip packages that ship meshes
MESH_SUFFIXES = (".npz", ".obj", ".stl", ".ply", ".dae", ".off", ".glb", ".gltf", ".3mf")


@dataclass(frozen=True)
class ObjectSet:
    """Named meshes, each loaded when asked for; units and origin are the source's own."""

    source: str
    names: tuple[str, ...]
    load: Callable[[str], trimesh.Trimesh]
    """The mesh of a name; raises ReorientError where the file is broken."""

    def only(self, names: Sequence[str]) -> "ObjectSet":
        """The subset with these names, in this order. Raises ReorientError for a name the set does not have."""
        known = set(self.names)
        for name in names:
            if name not in known:
                raise unknown_name("object", name, list(self.names))
        return ObjectSet(self.source, tuple(names), self.load)

    def split(self, share: float) -> tuple["ObjectSet", "ObjectSet"]:
        """Two disjoint sets by a hash of the name, so that an object stays on its side when the set grows."""
        first = tuple(name for name in self.names if zlib.crc32(name.encode()) < share * 2**32)
        chosen = set(first)
        return self.only(first), self.only([name for name in self.names if name not in chosen])


def generated(count: int, seed: int = 0) -> ObjectSet:
    """The first ``count`` objects of the procedural generator's sequence ``seed``."""
    if count < 1 or seed < 0:
        raise ReorientError(f"{count} generated objects of seed {seed}: expected at least 1, of a seed from 0")
    names = tuple(f"generated-{seed}-{index:06d}" for index in range(count))
    return ObjectSet("generated", names, _generate)


def folder(path: str | Path) -> ObjectSet:
    """All meshes below a folder, named by their path, without suffix where that is enough.

    Raises ReorientError where there is none.
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
    """The meshes that an installed pip package ships. Raises ReorientError where it is not installed."""
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


def _generate(name: str) -> trimesh.Trimesh:
    _, seed, index = name.rsplit("-", 2)
    return shapes.generate(int(seed), int(index))


def _load_file(files: dict[str, Path], name: str) -> trimesh.Trimesh:
    return load_mesh(files[name])
