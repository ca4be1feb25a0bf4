"""Goals on disk: one .npz with the primary view, the further views, their motions, and how the goal was made.

The primary view is stored as ``write_depth`` stores a depth image, so ``read_depth`` reads it from any goal file.
"""

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from reorient import __version__
from reorient.errors import ReorientError
from reorient.imaging.depth_image import DepthImage
from reorient.imaging.documents import existing, parse_json
from reorient.imaging.files import CameraChoice, read_depth, write_depth
from reorient.imaging.goal import Goal, GoalView
from reorient.imaging.intrinsics import camera_data, intrinsics_from
from reorient.runs.files import replacing

_EXPECTED = "expected a file of `reorient capture --views` or `reorient goal from-mesh`, or a depth image"
_MOTIONS = "R_goal_view"  # the array that only goals of several views have


def read_goal(path: str | Path, camera: CameraChoice = None, scale_m: float | None = None) -> Goal:
    """A goal from a file of ``write_goal``; any other depth image is a goal of one view, read as by ``read_depth``.

    ``camera`` and ``scale_m``: of such a depth image; a goal of several views holds its own. Raises ReorientError for a
    missing or broken file, and as ``read_depth``.
    """
    path = existing(path, "goal")
    image = read_depth(path, None if _has_views(path) else camera, scale_m)
    if not _has_views(path):
        return Goal(image)
    try:
        with np.load(path, allow_pickle=False) as arrays:
            R, t_m = arrays[_MOTIONS], arrays["t_goal_view_m"]
            stated = parse_json(str(arrays["stated"]))["views"]
            if R.shape != (len(stated), 3, 3) or t_m.shape != (len(stated), 3):
                raise ValueError(f"{len(stated)} views with motions of shapes {R.shape} and {t_m.shape}")
            views = [_view(arrays[_name(i)], stated[i], R[i], t_m[i]) for i in range(len(stated))]
        return Goal(image, tuple(views))
    except Exception as error:  # of a broken archive: zlib's, zipfile's and numpy's own kinds
        reason = f"no {error}" if isinstance(error, KeyError) else " ".join(str(error).split())[:200]
        raise ReorientError(f"broken goal file {str(path)!r} ({reason}): {_EXPECTED}") from error


def read_provenance(path: str | Path) -> dict[str, Any]:
    """How the goal in a file was made, as ``write_goal`` was told; empty for any other depth image."""
    path = existing(path, "goal")
    if path.suffix.lower() != ".npz":
        return {}
    try:
        with np.load(path, allow_pickle=False) as arrays:
            stated = parse_json(str(arrays["stated"])) if "stated" in arrays else {}
        return dict(stated.get("provenance", {}))
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ReorientError(f"broken goal file {str(path)!r} ({reason}): {_EXPECTED}") from error


def write_goal(path: str | Path, goal: Goal, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a goal as .npz; one of a single view also as the other files of ``write_depth``, without provenance.

    ``provenance``: how the goal was made, as JSON; version and date are added. Raises ReorientError for another suffix.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        if goal.views:
            raise ReorientError(f"cannot write a goal of {1 + len(goal.views)} views as {path.name!r}: expected .npz")
        write_depth(path, goal.image, scale_m=0.0001)
        return
    made = {"reorient": __version__, "date": datetime.now().astimezone().isoformat(timespec="seconds")}
    stated = _stated(goal.image) | {"provenance": made | dict(provenance or {})}
    arrays: dict[str, Any] = {"depth_m": _depth(goal.image)}
    if goal.views:
        unknown = np.full(3, np.nan)
        stated["views"] = [_stated(view.image) for view in goal.views]
        arrays |= {_name(i): _depth(view.image) for i, view in enumerate(goal.views)}
        arrays[_MOTIONS] = np.stack([view.R_goal_view for view in goal.views])
        arrays["t_goal_view_m"] = np.stack(
            [unknown if view.t_goal_view_m is None else view.t_goal_view_m for view in goal.views]
        )
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, stated=json.dumps(stated), **arrays)


def _has_views(path: Path) -> bool:
    """Whether a file is a goal of several views. A broken archive is left to ``read_depth``, which names the reason."""
    if path.suffix.lower() != ".npz":
        return False
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return _MOTIONS in arrays
    except Exception:
        return False


def _name(i: int) -> str:
    return f"view_{i + 1}_depth_m"


def _depth(image: DepthImage) -> np.ndarray:
    return np.where(image.unknown, np.float32(np.nan), image.depth_m)


def _stated(image: DepthImage) -> dict[str, Any]:
    stamp = {} if image.stamp_s is None else {"stamp_s": image.stamp_s}
    return {"camera": camera_data(image.camera)} | stamp


def _view(depth_m: np.ndarray, stated: Mapping[str, Any], R: np.ndarray, t_m: np.ndarray) -> GoalView:
    camera = intrinsics_from(stated["camera"], "the view").camera()
    image = DepthImage(depth_m, camera, stated.get("stamp_s"))
    return GoalView(image, R, None if np.isnan(t_m).all() else t_m)
