"""Without extras the base install works, and a missing extra is one line that holds the command."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from reorient.errors import ReorientError
from reorient.extras import LIBRARIES, MissingExtra, extras_named, import_extra, imported_on_use, require

ROOT = Path(__file__).parent.parent
DISTRIBUTIONS = {  # of modules with another name
    "OpenEXR": "openexr",
    "PIL": "pillow",
    "abb_robot_client": "abb-robot-client",
    "franky": "franky-control",
    "geometry_msgs": "ros-geometry-msgs",
    "google": "onnx",  # protobuf
    "rclpy": "ros-rclpy",
    "rtde_control": "ur-rtde",
    "rtde_receive": "ur-rtde",
    "sensor_msgs": "ros-sensor-msgs",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}
WITHOUT = f"""
from importlib.machinery import PathFinder

ABSENT = {[module for modules in LIBRARIES.values() for module in modules]!r}
found = PathFinder.find_spec
PathFinder.find_spec = staticmethod(lambda name, *rest: None if name.split(".")[0] in ABSENT else found(name, *rest))
"""
CELL = """
import numpy as np
from reorient import Camera, DepthImage

CENTRES_M = np.array([[-0.03, 0, 0], [0.03, 0, 0.01], [0, 0.035, -0.01], [0.01, -0.03, 0.02], [0.02, 0.01, -0.035]])
RADII_M = np.array([0.03, 0.022, 0.018, 0.025, 0.016])
CAMERA = Camera(96, 96, 250.0, 250.0, 48.0, 48.0)

class MyStation:
    pivot_m = np.array([0.0, 0.0, 0.6])

    def __init__(self):
        self.R = np.eye(3)

    def capture(self):
        rays = CAMERA.rays()[..., None, :]
        along = np.sum(rays * rays, axis=-1)
        centres = CENTRES_M @ self.R.T + self.pivot_m
        b = np.sum(rays * centres, axis=-1)
        inside = b**2 - along * (np.sum(centres**2, axis=-1) - RADII_M**2)
        depth = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / along, np.inf).min(axis=-1)
        return DepthImage(np.where(np.isfinite(depth), depth, 0.0), CAMERA)

    def rotate(self, R_step):
        self.R = R_step @ self.R
        return R_step

class Rotated(MyStation):
    def __init__(self):
        c, s = np.cos(0.4), np.sin(0.4)
        self.R = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
"""


def without_extras(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", WITHOUT + code], cwd=folder, capture_output=True, text=True)


def test_the_base_install_estimates_and_orients(tmp_path):
    """Every line is what a user with a robot does; none of it may load a library of an extra."""
    (tmp_path / "cell.py").write_text(CELL)
    run = without_extras(
        """
from reorient.cli import main

def reorient(line):
    try:
        main(line.split())
    except SystemExit as end:
        assert not end.code, (line, end.code)

reorient("capture goal.npz --station cell:MyStation")
reorient("capture now.npz --station cell:Rotated")
reorient("estimate now.npz goal.npz --explain picture.png --show-input inputs.png")
reorient("estimate now.npz goal.npz --explain page.html --json")
reorient("orient goal.npz --station cell:Rotated --yes --record record --out run")
reorient("replay record")
reorient("new-robot robot.toml")
import reorient as package
print(sorted(package.__all__) == sorted(name for name in package.__all__ if getattr(package, name) is not None))
""",
        tmp_path,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.splitlines()[-1] == "True"
    for name in ("inputs.png", "page.html", "picture.png", "run/loop.gif", "run/loop.html", "robot.toml"):
        assert (tmp_path / name).stat().st_size > 100, name


@pytest.mark.parametrize(
    ("line", "command"),
    [
        ("evaluate out", "pip install 'reorient[sim]'"),
        ("demo", "pip install 'reorient[sim]'"),
        ("goal from-mesh part.stl --camera camera.json --unit mm --center 0 0 0.6", "pip install 'reorient[sim]'"),
        ("objects list", "pip install 'reorient[sim]'"),
        ("generate pairs", "pip install 'reorient[sim]'"),
    ],
)
def test_verbs_name_the_extra_that_they_lack(line, command, tmp_path):
    (tmp_path / "part.stl").write_text("solid part\nendsolid part\n")
    (tmp_path / "camera.json").write_text('{"width": 64, "height": 64, "fx": 99, "fy": 99, "cx": 32, "cy": 32}')
    run = without_extras(f"from reorient.cli import main\nmain({line.split()!r})", tmp_path)
    assert run.returncode == 2
    assert re.fullmatch(rf"reorient: needs \w+: {re.escape(command)}\n", run.stderr), run.stdout + run.stderr


@pytest.mark.parametrize(
    ("code", "extra"),
    [
        ("from reorient import load_estimator; load_estimator('icp')", "sim"),
        ("from reorient.perception import isolate_object", "sim"),
        ("from reorient.reporting import write_report", "sim"),
        ("from reorient.stations.drivers import make_camera; make_camera('simulated', {})", "sim"),
        ("from reorient.stations.drivers import make_arm; make_arm('ur', {'address': '127.0.0.1'})", "ur"),
        ("from reorient.runs.pool import Pool; Pool(-1, 'ray').count", "cluster"),
        ("from reorient.cli.outputs import LoopOutputs, Path; LoopOutputs(mcap=Path('run.mcap')).check()", "view"),
        ("from reorient.cli.outputs import LoopOutputs, Path; LoopOutputs(out=Path('.'), format='svg').check()", "sim"),
    ],
)
def test_python_names_the_extra_that_it_lacks(code, extra, tmp_path):
    run = without_extras(f"from reorient.errors import ReorientError\n{code}", tmp_path)
    assert run.stderr.splitlines()[-1].endswith(f": pip install 'reorient[{extra}]'"), run.stderr


def test_a_library_that_is_missing_or_broken_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtra, match=r"^needs viser: pip install 'reorient\[view\]'$") as caught:
        import_extra("viser")
    assert isinstance(caught.value, ReorientError)
    assert isinstance(caught.value, ImportError)

    def broken(name):
        raise ImportError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.setattr("reorient.extras.import_module", broken)
    with pytest.raises(MissingExtra, match=r"^cannot import pyrealsense2 \(libusb.*\): pip install 'reorient\[rea"):
        import_extra("pyrealsense2")


def test_errors_of_other_modules_pass():
    with pytest.raises(ModuleNotFoundError, match="no_such_module") as caught, extras_named():
        import no_such_module  # noqa: F401
    assert not isinstance(caught.value, MissingExtra)
    with pytest.raises(MissingExtra, match=r"^needs mujoco: pip install 'reorient\[cell\]'$"), extras_named():
        raise ModuleNotFoundError("No module named 'mujoco.viewer'", name="mujoco.viewer")


def test_required_libraries_are_looked_for(monkeypatch):
    monkeypatch.setattr("reorient.extras.find_spec", lambda name: None if name == "zarr" else object())
    require("torch")
    with pytest.raises(MissingExtra, match=r"needs zarr: pip install 'reorient\[train\]'"):
        require("torch", "zarr")


def test_names_are_imported_on_use():
    attribute = imported_on_use("reorient", {"so3": ("exp",)})
    from reorient import so3

    assert attribute("exp") is so3.exp
    with pytest.raises(AttributeError, match="module 'reorient' has no attribute 'log'"):
        attribute("log")


def test_the_extras_install_what_they_are_named_for():
    """Every library that the package imports is installed by the base or by the extra that the error names."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    def installs(requirements: list[str]) -> set[str]:
        return {re.match(r"[\w.-]+", each)[0].lower().replace("_", "-") for each in requirements}

    def distribution(module: str) -> str:
        return DISTRIBUTIONS.get(module, module.lower().replace("_", "-"))

    extras = {name: installs(requirements) for name, requirements in project["optional-dependencies"].items()}
    base = installs(project["dependencies"])
    mcap = {"mcap-protobuf": "mcap-protobuf-support"}
    for extra, modules in LIBRARIES.items():
        needed = {mcap.get(distribution(module), distribution(module)) for module in modules}
        assert needed <= extras[extra], extra
        assert not needed & base, extra
    known = {module for modules in LIBRARIES.values() for module in modules}
    for path in (ROOT / "src" / "reorient").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and not node.level and node.module else []
            for module in {name.split(".")[0] for name in names} - sys.stdlib_module_names - {"reorient"} - known:
                assert distribution(module) in base, f"{path} imports {module}"
