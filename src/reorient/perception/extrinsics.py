"""Known results of a hand-eye calibration, from files of other programs, as a (4, 4) transform.

4 x 4 matrices as text, .npy, JSON or YAML; ROS transforms (translation and rotation x, y, z, w); easy_handeye and
easy_handeye2 YAML; OpenCV's matrices R and t, or rvec and tvec, in FileStorage YAML or .npz. Whether a file holds
T_base_camera or its inverse cannot be read from it: only a motion of the robot tells.
"""

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError, reason_of
from reorient.imaging.depth_image import MILLIMETRES_ABOVE
from reorient.se3 import Transform

_ROTATIONS = ("R", "rvec", "R_cam2gripper", "R_cam2base", "rotation_matrix", "rotation")
_TRANSLATIONS = ("t", "tvec", "T", "t_cam2gripper", "t_cam2base", "translation_vector", "translation")
_EXPECTED = (
    "expected a 4 x 4 matrix, a ROS transform (translation, rotation x y z w), easy_handeye YAML, or OpenCV's R and t"
)
_KEY = re.compile(r"^(\s*)(?:- )?([\w/]+):[ \t]*(.*?)\s*$", re.MULTILINE)
_OPENCV = re.compile(r"(\w+):\s*!!opencv-matrix.*?data:\s*\[(.*?)\]", re.DOTALL)


def read_hand_eye(path: str | Path) -> Transform:
    """The transform in a file, metres. Raises ReorientError where there is none, and for a camera on the hand."""
    path = Path(path)
    if not os.path.isfile(path):
        raise ReorientError(f"no hand-eye file {str(path)!r}: {_EXPECTED}")
    try:
        T = _transform(_entries(path))
    except Exception as error:
        raise ReorientError(f"cannot read a transform from {str(path)!r} ({reason_of(error)}): {_EXPECTED}") from error
    if not so3.is_rotation(T[:3, :3], 1e-2) or not np.allclose(T[3], [0, 0, 0, 1]):
        raise ReorientError(f"the matrix in {str(path)!r} is no rigid transform: {_EXPECTED}")
    if np.linalg.norm(T[:3, 3]) > MILLIMETRES_ABOVE:
        raise ReorientError(
            f"the translation in {str(path)!r} is {np.linalg.norm(T[:3, 3]):.0f}: this looks like millimetres, "
            "expected metres (times 0.001)"
        )
    u, _, vt = np.linalg.svd(T[:3, :3])
    return se3.transform(u @ vt, T[:3, 3])


def _entries(path: Path) -> dict[str, Any]:
    """The named values of a file, nested ones as ``outer.inner``; a bare array is named "matrix"."""
    if path.suffix.lower() == ".npy":
        return {"matrix": np.load(path)}
    if path.suffix.lower() == ".npz":
        with np.load(path) as arrays:
            return {name: arrays[name] for name in arrays}
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    try:
        data = json.loads(text)
        return _flat(data) if isinstance(data, dict) else {"matrix": data}
    except json.JSONDecodeError:
        pass
    if matrices := _OPENCV.findall(text):
        return {name: _numbers(numbers) for name, numbers in matrices}
    if not _KEY.search(text):
        return {"matrix": _numbers(text)}
    return _yaml(text)


def _yaml(text: str) -> dict[str, Any]:
    """The scalar and list entries of simple YAML: nesting by indentation, numbers in any kind of list."""
    found: dict[str, Any] = {}
    open_keys: list[tuple[int, str]] = []
    matches = list(_KEY.finditer(text))
    for match, after in zip(matches, [*(m.start() for m in matches[1:]), len(text)], strict=True):
        indent, key, value = len(match[1]), match[2], match[3]
        open_keys = [each for each in open_keys if each[0] < indent] + [(indent, key)]
        name = ".".join(each for _, each in open_keys)
        if value and not value.startswith("["):
            found[name] = value
        elif numbers := _numbers(value + text[match.end() : after]):
            found[name] = numbers
    return found


def _flat(data: dict[str, Any], before: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in data.items():
        found |= _flat(value, f"{before}{key}.") if isinstance(value, dict) else {f"{before}{key}": value}
    return found


def _numbers(text: str) -> list[float]:
    return [float(x) for x in re.findall(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", text)]


def _transform(entries: dict[str, Any]) -> Transform:
    for name, value in entries.items():
        last = name.rsplit(".", 1)[-1]
        on_hand = last == "eye_on_hand" and str(value).lower() == "true"
        if on_hand or (last == "calibration_type" and "in_hand" in str(value)):
            raise ReorientError("the camera is on the hand: expected a fixed camera (eye on base)")
    if (T := _matrix(entries)) is not None:
        return T
    if (quat_xyzw := _named(entries, ("qx", "qy", "qz", "qw"), "")) is not None:
        t_m = _named(entries, ("x", "y", "z"), "")
    else:
        quat_xyzw = _named(entries, ("x", "y", "z", "w"), "rotation")
        t_m = _named(entries, ("x", "y", "z"), "translation")
    if quat_xyzw is not None and t_m is not None:
        return _from_quat(t_m, quat_xyzw)
    return _opencv(entries)


def _matrix(entries: dict[str, Any]) -> Transform | None:
    """An array of 4 x 4 numbers, or of seven: x y z qx qy qz qw, as ROS's static_transform_publisher takes them."""
    for name, value in entries.items():
        if isinstance(value, str) or np.ndim(value) == 0:
            continue
        array = np.asarray(value, float)
        if array.size == 16:
            return array.reshape(4, 4)
        if array.size == 7 and name == "matrix":
            return _from_quat(array[:3], array[3:])
    return None


def _named(entries: dict[str, Any], names: tuple[str, ...], within: str) -> Float[np.ndarray, " n"] | None:
    """The numbers of these names in one table whose name ends so; None where one is missing."""
    for entry in entries:
        table, _, last = entry.rpartition(".")
        if last == names[0] and table.endswith(within):
            values = [entries.get(f"{table}.{name}".lstrip(".")) for name in names]
            return None if None in values else np.array(values, float)
    return None


def _from_quat(t_m: Float[np.ndarray, "3"], quat_xyzw: Float[np.ndarray, "4"]) -> Transform:
    return se3.transform(so3.matrix_from_quat(so3.normalize(np.roll(quat_xyzw, 1))), t_m)


def _opencv(entries: dict[str, Any]) -> Transform:
    R = next((np.asarray(entries[name], float).ravel() for name in _ROTATIONS if name in entries), None)
    t = next((np.asarray(entries[name], float).ravel() for name in _TRANSLATIONS if name in entries), None)
    if R is None or t is None or t.size != 3 or R.size not in (3, 9):
        raise ReorientError("no rotation and translation in it")
    return se3.transform(so3.exp(R) if R.size == 3 else R.reshape(3, 3), t)
