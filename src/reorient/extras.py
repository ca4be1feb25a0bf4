"""Libraries that extras install: the error that names the extra, and names of the package imported on first use."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from reorient.errors import ReorientError

LIBRARIES = {
    "sim": ("trimesh", "embreex", "manifold3d", "matplotlib", "rich"),
    "train": (
        *("torch", "lightning_fabric", "zarr", "fsspec", "safetensors", "tensorboard", "onnx", "onnxscript"),
        *("google", "sklearn"),
    ),
    "cluster": ("ray",),
    "exr": ("OpenEXR",),
    "cell": ("mujoco", "mink"),
    "view": ("viser", "mcap", "mcap_protobuf", "foxglove_schemas_protobuf", "tomlkit"),
    "realsense": ("pyrealsense2",),
    "franka": ("franky",),
    "franka-sim": ("franky_sim",),
    "ur": ("rtde_control", "rtde_receive"),
    "abb": ("abb_robot_client",),
    "ros2": ("rclpy", "sensor_msgs", "geometry_msgs"),
}
"""By extra, the top-level modules of the libraries that this package imports and only the extra installs."""
_EXTRA_OF = {module: extra for extra, modules in LIBRARIES.items() for module in modules}


class MissingExtra(ReorientError, ImportError):
    """A library of an extra is not installed, or cannot be loaded; the message holds the command that installs it."""


def _error(module: str, error: ImportError) -> MissingExtra:
    library = module.split(".")[0]
    absent = isinstance(error, ModuleNotFoundError) and (error.name or library).split(".")[0] == library
    needs = f"needs {library}" if absent else f"cannot import {module} ({error})"
    return MissingExtra(f"{needs}: pip install 'reorient[{_EXTRA_OF[library]}]'")


@contextmanager
def extras_named() -> Iterator[None]:
    """A block that imports modules of this package: MissingExtra where a library of an extra is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        library = (error.name or "").split(".")[0]
        if isinstance(error, MissingExtra) or library not in _EXTRA_OF:
            raise
        raise _error(library, error) from error


def import_extra(module: str) -> Any:
    """The library ``module`` of an extra. Raises MissingExtra where it is not installed or cannot be loaded."""
    try:
        return import_module(module)
    except ImportError as error:
        raise _error(module, error) from error


def require(*modules: str) -> None:
    """Raise MissingExtra for the first of these libraries that is not installed, without importing any."""
    for module in modules:
        if find_spec(module) is None:
            raise _error(module, ModuleNotFoundError(name=module))


def imported_on_use(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package whose names are imported from its modules when they are first used.

    ``modules``: by module within the package, the names that it exports.
    """
    module_of = {name: module for module, names in modules.items() for name in names}

    def attribute(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        with extras_named():
            value = getattr(import_module(f"{package}.{module_of[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute
