"""Imports of the package run one way, transitively, and heavy packages stay outside until they are needed."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from reorient.extras import LIBRARIES

SOURCE = Path(__file__).parent.parent / "src" / "reorient"

# A package (or top-level module) imports only those listed before it.
ORDER = [
    *(
        "errors",
        "extras",
        "formatting",
        "so3",
        "se3",
        "plugins",
        "runs",
        "imaging",
        "world",
        "registration",
        "estimators",
    ),
    *("controller", "perception", "stations", "learning", "experiments", "reporting", "reproducing", "viewing"),
    *("cli", "__main__"),
    "",  # the package itself
]
# Imports inside a function that break the order: a goal from a mesh is rendered, where somebody asks for one.
EXCEPTIONS = {("imaging/goal", "world.mesh_goal")}
# What a package must not reach, directly or through any other module: by prefixes, with exceptions.
UNREACHABLE = {
    "controller": (("estimators.", "world"), {"estimators.base"}),
    "estimators": (("world",), set[str]()),
    "registration": (("world",), set[str]()),
}


parsed = cache(ast.parse)


def package_of(module: str) -> str:
    return module.split(".")[0]


def within(module: str, prefix: str) -> bool:
    return module.startswith(prefix) if prefix.endswith(".") else f"{module}.".startswith(f"{prefix}.")


def imports(name: str, sources: dict[str, str], everywhere: bool = True) -> Iterator[str]:
    """Modules of the package that a file imports; ``everywhere``: inside functions, too. Keys: "stations/__init__"."""
    package = name.split("/")[:-1]
    tree = parsed(sources[name])
    for node in ast.walk(tree) if everywhere else tree.body:
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = ["reorient", *package[: len(package) - node.level + 1]] if node.level else []
            base = ".".join(above + ([node.module] if node.module else []))
            # the version is a name of the package that any module may read
            targets = [f"{base}.{alias.name}" for alias in node.names if alias.name != "__version__"]
        else:
            continue
        for target in targets:
            path = target.split(".")
            if path[0] == "reorient":
                inside = "/".join(path[1:])
                is_module = inside in sources or f"{inside}/__init__" in sources or isinstance(node, ast.Import)
                module = ".".join(path[1:] if is_module else path[1:-1])
                if (name, module) not in EXCEPTIONS or node in tree.body:
                    yield module


def file_of(module: str, sources: dict[str, str]) -> str | None:
    path = module.replace(".", "/")
    return next((name for name in (path, f"{path}/__init__".lstrip("/")) if name in sources), None)


def reached(name: str, sources: dict[str, str]) -> dict[str, str]:
    """Every module that a file leads to, with the module that imports it.

    Importing ``a.b`` also runs the top level of ``a/__init__``; what that imports inside functions is not reached.
    """
    found: dict[str, str] = {}
    open_files = [(name, True)]
    done = set()
    while open_files:
        file, everywhere = open_files.pop()
        if (file, everywhere) in done:
            continue
        done.add((file, everywhere))
        for target in imports(file, sources, everywhere):
            found.setdefault(target, file)
            if (target_file := file_of(target, sources)) is not None:
                open_files.append((target_file, not target_file.endswith("__init__")))
            parents = target.split(".")[:-1]
            for n in range(1, len(parents) + 1):
                if (parent := file_of(".".join(parents[:n]), sources)) is not None:
                    open_files.append((parent, False))
    return found


def violations(sources: dict[str, str]) -> list[str]:
    """Every import that must not be, in words."""
    found, graph = [], {}
    for name in sources:
        module = name.replace("/", ".").removesuffix("__init__").rstrip(".")
        targets = set(imports(name, sources))
        graph[module] = targets - {module}
        unplaced = {package_of(x) for x in (module, *targets)} - set(ORDER)
        if unplaced:
            found += [f"{name}: {package!r} has no place in ORDER" for package in sorted(unplaced)]
            continue
        for target in targets:
            if ORDER.index(package_of(target)) > ORDER.index(package_of(module)):
                found.append(f"{name} imports {target or 'reorient'}, which is listed after it")
        prefixes, allowed = UNREACHABLE.get(package_of(module), ((), set()))
        if prefixes:
            for target, by in reached(name, sources).items():
                if any(within(target, prefix) for prefix in prefixes) and target not in allowed:
                    found.append(f"{name} reaches {target} through {by}")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append(f"a cycle: {' -> '.join(error.args[1])}")
    return found


def test_imports_run_one_way():
    sources = {str(path.relative_to(SOURCE).with_suffix("")): path.read_text() for path in SOURCE.rglob("*.py")}
    assert violations(sources) == []


SOUND = {
    "__init__": "from reorient.controller import orient\n__version__ = '1'",
    "errors": "import numpy",
    "so3": "from reorient.errors import ReorientError",
    "imaging/__init__": "from reorient import so3",
    "imaging/goal": "def late():\n    from reorient.world.mesh_goal import mesh_goal",
    "world/mesh_goal": "from reorient.imaging.goal import Goal",
    "world/meshes": "",
    "world/rendering": "from reorient import imaging, __version__",
    "registration/scores": "from reorient.imaging import DepthImage",
    "estimators/__init__": "def load():\n    from reorient.estimators.icp import ICP",
    "estimators/base": "from reorient.imaging import DepthImage",
    "estimators/icp": "from .base import Estimator\nfrom .. import so3\nfrom reorient.registration.scores import score",
    "controller/__init__": "from reorient.estimators.base import Estimator\nfrom reorient.controller import arrival",
    "controller/arrival": "from reorient.registration import scores",
    "stations/rendered": "import reorient.world.rendering\nfrom reorient.controller import orient",
}


def test_a_sound_package_has_no_violations():
    assert violations(SOUND) == []


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("so3", "from reorient.imaging import Camera", "so3 imports imaging, which is listed after it"),
        ("so3", "import reorient.imaging", "so3 imports imaging, which is listed after it"),
        ("so3", "from reorient import imaging", "so3 imports imaging, which is listed after it"),
        ("so3", "from . import imaging", "so3 imports imaging, which is listed after it"),
        ("so3", "def late():\n    from .imaging import Camera", "so3 imports imaging, which is listed after it"),
        ("imaging/goal", "from reorient.world.mesh_goal import x", "imaging/goal imports world.mesh_goal, which is"),
        (
            "imaging/goal",
            "def late():\n    from reorient.world import meshes",
            "imaging/goal imports world.meshes, which",
        ),
        ("imaging/__init__", "from reorient import orient", "imaging/__init__ imports reorient, which is listed after"),
        ("imaging/__init__", "import reorient", "imaging/__init__ imports reorient, which is listed after it"),
        ("estimators/icp", "from ..world.rendering import X", "icp reaches world.rendering through estimators/icp"),
        ("estimators/icp", "from reorient.estimators import load", "a cycle: "),
        ("registration/scores", "import reorient.world.rendering", "icp reaches world.rendering through registration"),
        ("controller/arrival", "from reorient.estimators import icp", "reaches estimators.icp through controller/arri"),
        ("controller/arrival", "from reorient.world import rendering", "reaches world.rendering through controller/ar"),
        # one import deeper than the controller's own files
        (
            "estimators/base",
            "def late():\n    from . import icp",
            "arrival reaches estimators.icp through estimators/b",
        ),
        ("registration/scores", "from reorient.estimators.icp import X", "arrival reaches estimators.icp through reg"),
        ("estimators/__init__", "from reorient.estimators import icp", "arrival reaches estimators.icp through est"),
        ("controller/__init__", "from reorient.stations import rendered", "imports stations.rendered, which is listed"),
        ("controller/__init__", "from reorient.cellar import wine", "'cellar' has no place in ORDER"),
        ("cellar", "", "'cellar' has no place in ORDER"),
    ],
)
def test_planted_violations_are_found(name, line, message):
    sources = SOUND | {name: SOUND.get(name, "") + "\n" + line}
    if name == "estimators/base":  # the loop's other files lead to the base
        sources["controller/arrival"] += "\nfrom reorient.estimators.base import Estimator"
    if name == "estimators/__init__":
        sources["controller/arrival"] += "\nimport reorient.estimators.base"
    found = violations(sources)
    assert any(message in sentence for sentence in found), found


# Packages and modules that are imported only where an extra is installed; of these, what the base install needs.
WITH_EXTRAS = {
    "cli": ("cell", "evaluating", "learning", "loops", "objects", "progress", "reproducing", "verifier"),
    "estimators": ("icp",),
    "experiments": (),
    "learning": (),
    "perception": ("filling", "frame", "recalibration", "segmentation"),
    "reporting": (),
    "reproducing": (),
    "stations": ("cell", "faulty_cell", "franka_cell", "rendered", "rendered_hand", "simulated"),
    "world": (),
}
IN_BASE = {"learning.recipes"} | {f"reporting.{name}" for name in ("explaining", "inputs", "loop", "page", "pictures")}


def needs_extras(module: str) -> bool:
    package, _, rest = module.partition(".")
    some = WITH_EXTRAS.get(package)
    inside = some is not None and bool(rest) and (not some or any(within(rest, prefix) for prefix in some))
    return inside and module not in IN_BASE


def libraries(name: str, sources: dict[str, str]) -> set[str]:
    """The libraries beyond the standard one that a file imports when it is imported itself."""
    found = set()
    for node in parsed(sources[name]).body:
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            found.add(node.module.split(".")[0])
    return found - sys.stdlib_module_names - {"reorient"}


def loaded(name: str, sources: dict[str, str]) -> dict[str, str]:
    """Every library that is imported with a file, with the file that imports it."""
    found: dict[str, str] = {}
    open_files, done = [name], set[str]()
    while open_files:
        file = open_files.pop()
        if file in done:
            continue
        done.add(file)
        found |= {library: file for library in libraries(file, sources) if library not in found}
        for module in {file.replace("/", ".").removesuffix(".__init__"), *imports(file, sources, everywhere=False)}:
            path = module.split(".")
            parts = (file_of(".".join(path[:n]), sources) for n in range(1, len(path) + 1))
            open_files += [part for part in parts if part is not None]
    return found


def heavy_imports(sources: dict[str, str]) -> list[str]:
    """Every module of the base install that is not imported without an extra, in words."""
    extra_of = {library: extra for extra, libraries in LIBRARIES.items() for library in libraries}
    found = []
    for name in sources:
        if not needs_extras(name.replace("/", ".").removesuffix(".__init__")):
            late = {library: by for library, by in loaded(name, sources).items() if library in extra_of}
            found += [f"{name} needs {library} of the extra {extra_of[library]}: {by}" for library, by in late.items()]
    return found


def test_the_base_install_imports_no_library_of_an_extra():
    sources = {str(path.relative_to(SOURCE).with_suffix("")): path.read_text() for path in SOURCE.rglob("*.py")}
    assert heavy_imports(sources) == []


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("so3", "import matplotlib.pyplot", "so3 needs matplotlib of the extra sim: so3"),
        ("estimators/base", "from reorient.estimators import icp", "controller/arrival needs trimesh of the extra sim"),
        ("controller/__init__", "from torch import nn", "controller/arrival needs torch of the extra train"),
        ("estimators/__init__", "from .icp import ICP", "estimators/base needs trimesh of the extra sim"),
    ],
)
def test_planted_heavy_imports_are_found(name, line, message):
    sources = SOUND | {"estimators/icp": "import trimesh", "world/meshes": "import trimesh"}
    assert heavy_imports(sources) == []
    sources[name] += "\n" + line
    if name == "estimators/base":
        sources["controller/arrival"] += "\nimport reorient.estimators.base"
    assert any(message in sentence for sentence in heavy_imports(sources))


EXTRAS = "viser mcap torch mujoco mink open3d matplotlib embreex trimesh onnxruntime sklearn"
RECORDER = f"""
import sys

class Recorder:
    asked = set()
    def find_spec(self, name, path=None, target=None):
        self.asked.add(name)

sys.meta_path.insert(0, Recorder())
{{code}}
print(*sorted(set("reorient {EXTRAS}".split()) & Recorder.asked))
print(*sorted(x for x in sys.modules if x.startswith("reorient.estimators.") and not x.endswith(".base")))
"""


@pytest.mark.parametrize(
    "code",
    [
        "import reorient",
        "import reorient.cli",
        "from reorient.cli import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass",
        "from reorient.cli import main\ntry:\n    main(['estimate', '--help'])\nexcept SystemExit:\n    pass",
    ],
)
def test_no_extra_and_no_estimator_is_imported_before_it_is_needed(code):
    """Attempts count, so that the test also holds where the extras are not installed."""
    run = subprocess.run([sys.executable, "-c", RECORDER.format(code=code)], capture_output=True, text=True)
    assert run.stdout.splitlines()[-2:] == ["reorient", ""], run.stdout + run.stderr


def test_the_recorder_sees_an_import():
    code = "import reorient.estimators.icp"
    run = subprocess.run([sys.executable, "-c", RECORDER.format(code=code)], capture_output=True, text=True)
    asked, loaded = run.stdout.splitlines()[-2:]
    assert "trimesh" in asked.split()
    assert loaded == "reorient.estimators.icp"
