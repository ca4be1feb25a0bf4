"""Arrows between the rooms of the package run one way, and heavy packages stay outside until they are asked for."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src" / "reorient"

# Top to bottom: a room may import those above it. A room of several files is one name; files that others build on
# come before the rest of theirs.
ROOMS = [
    "errors",
    "processes",
    "plugins",
    "files",
    "provenance",
    "so3",
    "depth",
    "depth_files",
    "virtual_camera",
    "calibration",
    "colour",
    "planes",
    "meshes",
    "shapes",
    "objects",
    "rendering",
    "sensing",
    "symmetry",
    "paper_filter",
    "estimators.evidence",
    "estimators.base",
    "estimators",
    "pairs",
    "pair_store",
    "batches",
    "recipes",
    "network",
    "losses",
    "training",
    "export",
    "perception",
    "recalibration",
    "stations.base",
    "stations",
    "recognition",
    "controller.base",
    "controller",
    "evaluation",
    "judging",
    "statistics",
    "loop_trials",
    "cell_trials",
    "experiment",
    "pictures",
    "explaining",
    "reporting",
    "reproducing",
    "cli",
    "__main__",
    "",  # the package itself
]
NEVER = {"estimators": {"meshes", "shapes", "objects", "rendering", "sensing", "symmetry", "paper_filter"}}
_INTERFACES = {"errors", "so3", "depth", "estimators.base", "stations.base", "recognition", "controller.base"}
ONLY = {room: _INTERFACES | {room} for room in ("controller", "controller.base")}


def room_of(module: str) -> str:
    """The most particular room that holds a module (named without ``reorient.``); KeyError if none does."""
    parts = module.split(".") if module else []
    names = [".".join(parts[:n]) for n in range(len(parts), 0, -1)] or [""]
    for name in names:
        if name in ROOMS:
            return name
    raise KeyError(module)


def imported(name: str, sources: dict[str, str]) -> Iterator[str]:
    """Modules of the package that a file imports, anywhere in it. Keys are files: ``depth``, ``stations/__init__``."""
    package = name.split("/")[:-1]
    for node in ast.walk(ast.parse(sources[name])):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = ["reorient", *package[: len(package) - node.level + 1]] if node.level else []
            base = ".".join(above + ([node.module] if node.module else []))
            # the version is a name of the package that any room may read
            targets = [f"{base}.{alias.name}" for alias in node.names if alias.name != "__version__"]
        else:
            continue
        for target in targets:
            path = target.split(".")
            if path[0] == "reorient":
                inside = "/".join(path[1:])
                is_module = inside in sources or f"{inside}/__init__" in sources or isinstance(node, ast.Import)
                yield ".".join(path[1:] if is_module else path[1:-1])


def violations(sources: dict[str, str]) -> list[str]:
    """Every arrow that must not be, in words."""
    found, graph = [], {}
    for name in sources:
        module = name.replace("/", ".").removesuffix("__init__").rstrip(".")
        targets = set(imported(name, sources))
        graph[module] = targets - {module}
        try:
            room = room_of(module)
            rooms = {target: room_of(target) for target in targets}
        except KeyError as error:
            found.append(f"{name}: no room for module {error}; give it a place in ROOMS")
            continue
        family = room.split(".")[0]
        for target, other in rooms.items():
            if ROOMS.index(other) > ROOMS.index(room):
                found.append(f"{name} imports {target or 'reorient'}, which lies below it")
            if other in NEVER.get(family, ()) or (room in ONLY and other not in ONLY[room]):
                found.append(f"{name} must not import {target}")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append(f"a circle: {' -> '.join(error.args[1])}")
    return found


def test_arrows_run_one_way():
    sources = {str(path.relative_to(SOURCE).with_suffix("")): path.read_text() for path in SOURCE.rglob("*.py")}
    assert violations(sources) == []


SOUND = {
    "__init__": "from reorient.controller import orient\n__version__ = '1'",
    "errors": "import numpy",
    "so3": "from reorient.errors import ReorientError",
    "depth": "from reorient import so3",
    "rendering": "from reorient import depth, __version__",
    "estimators/__init__": "def load():\n    from reorient.estimators.icp import ICP",
    "estimators/base": "from reorient.depth import DepthImage",
    "estimators/icp": "from .base import Estimator\nfrom .. import so3",
    "stations/base": "from reorient.depth import DepthImage",
    "stations/rendered": "import reorient.rendering",
    "controller": "from reorient.estimators.base import Estimator\nfrom reorient.stations import base",
}


def test_a_sound_package_has_no_violations():
    assert violations(SOUND) == []


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("so3", "from reorient.depth import Camera", "so3 imports depth, which lies below it"),
        ("so3", "import reorient.depth", "so3 imports depth, which lies below it"),
        ("so3", "from reorient import depth", "so3 imports depth, which lies below it"),
        ("so3", "from . import depth", "so3 imports depth, which lies below it"),
        ("so3", "def late():\n    from .depth import Camera", "so3 imports depth, which lies below it"),
        ("depth", "from reorient import orient", "depth imports reorient, which lies below it"),
        ("depth", "import reorient", "depth imports reorient, which lies below it"),
        ("depth", "from reorient.estimators import load", "depth imports estimators, which lies below it"),
        ("estimators/base", "from .icp import ICP", "estimators/base imports estimators.icp, which lies below it"),
        ("estimators/icp", "from ..rendering import Renderer", "estimators/icp must not import rendering"),
        ("estimators/icp", "from reorient.estimators import load", "a circle: "),
        ("controller", "from reorient.stations.rendered import X", "controller must not import stations.rendered"),
        ("controller", "from reorient.estimators import load", "controller must not import estimators"),
        ("controller", "from reorient import rendering", "controller must not import rendering"),
        ("controller", "from reorient.cellar import wine", "no room for module 'cellar'"),
        ("cellar", "", "cellar: no room for module 'cellar'"),
    ],
)
def test_planted_violations_are_found(name, line, message):
    found = violations(SOUND | {name: SOUND.get(name, "") + "\n" + line})
    assert any(message in sentence for sentence in found), found


ATTEMPTS = """
import sys

class Recorder:
    asked = set()
    def find_spec(self, name, path=None, target=None):
        self.asked.add(name)

sys.meta_path.insert(0, Recorder())
import reorient, reorient.estimators
print(*sorted({"reorient.so3", "torch", "mujoco", "open3d", "matplotlib"} & Recorder.asked))
"""

HELP = """
from reorient.cli import main
try:
    main(["estimate", "--help"])
except SystemExit:
    pass
"""


def test_the_command_line_asks_for_no_extra():
    script = ATTEMPTS.replace("import reorient, reorient.estimators", "import reorient.cli").replace(
        "matplotlib", "mink"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert run.stdout.split() == ["reorient.so3"], run.stderr


def test_the_package_asks_for_no_heavy_package():
    """Attempts count, so that the test also holds where they are not installed."""
    run = subprocess.run([sys.executable, "-c", ATTEMPTS], capture_output=True, text=True)
    assert run.stdout.split() == ["reorient.so3"], run.stderr


def test_a_verb_of_the_robot_brings_no_meshes_and_no_rays():
    """Nothing but the file of the verb asked for is imported."""
    script = ATTEMPTS.replace("import reorient, reorient.estimators", HELP).replace("torch", "trimesh", 1)
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert run.stdout.splitlines()[-1].split() == ["reorient.so3"], run.stderr
