"""The verbs of goals: check, from-mesh; the contact sheet and the statement that ``capture`` prints as well."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from reorient import so3
from reorient.cli.arguments import Metavar, Positional
from reorient.errors import ReorientError, check_range
from reorient.formatting import format_probability

if TYPE_CHECKING:
    from reorient.imaging import DepthImage, Goal

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
SURE = 0.9  # confidence that a capture shows the mesh
_TILE_PX, _COLUMNS = 200, 3


@dataclass(frozen=True)
class Check:
    """State what a goal can and cannot tell.

    That is: remaining flips (other rotations under which its own views match nearly as well), a free axis, and the
    overlap of its views with a start in any orientation.

    Examples:
        reorient goal check goal.npz
    """

    goal: Positional[Path]
    """Goal of ``reorient capture`` or ``reorient goal from-mesh``, or a depth image of the isolated object."""
    picture: Path | None = None
    """Contact sheet of the views to draw (.png, .jpg)."""

    def run(self) -> None:
        """Read, align, print, draw."""
        from reorient.estimators.base import check_pair
        from reorient.imaging.goal_files import read_goal, read_provenance
        from reorient.registration.aligning import aligned_goal

        goal = read_goal(self.goal)
        check_pair(goal.image, goal)
        if provenance := read_provenance(self.goal):
            print(_origin(provenance))
        aligned, warnings = aligned_goal(goal)
        for warning in warnings:
            print(f"reorient: warning: {warning}", file=sys.stderr)
        print_statement(aligned)
        if self.picture is not None:
            write_sheet(self.picture, goal)


@dataclass(frozen=True)
class FromMesh:
    """Render a goal from a mesh.

    The goal has exact depth images of the mesh in the goal pose and around it, made without noise. Camera and place are
    those of a capture of the held object (--capture), which also checks the scale, or are given.

    Examples:
        reorient goal from-mesh part.stl --unit mm --rotation 0 90 0 --capture now.npz --out goal.npz
        reorient goal from-mesh part.stl --unit mm --camera camera.json --center 0 0 0.6 --out goal.npz
    """

    mesh: Positional[Path]
    """Mesh of any format that trimesh reads (.stl, .obj, .ply, ...)."""
    unit: Literal["m", "cm", "mm", "in"]
    """Unit of the file."""
    out: Path = Path("goal.npz")
    """Goal to write; the contact sheet is written beside it."""
    rotation: Annotated[tuple[float, ...], Metavar("DEG")] = ()
    """Goal orientation, from the axes of the mesh to camera axes (x right, y down, z forward): three degrees as a
    rotation vector, or nine entries of a rotation matrix row by row. By default none."""
    capture: Path | None = None
    """Isolated depth image of the held object, as of ``reorient capture``."""
    camera: Path | None = None
    """Camera file, as of ``reorient estimate --camera``, where there is no --capture."""
    center: Annotated[tuple[float, float, float] | None, Metavar(("X", "Y", "Z"))] = None
    """Centre of the mesh's bounding box, in camera axes, in metres, by default that of --capture."""
    views: int = 5
    """Number of further views."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range, and for neither or both of capture and camera."""
        check_range(self, "views")
        if (self.capture is None) == (self.camera is None):
            raise ReorientError(
                "expected one of --capture and --camera: where shall the object be, before which camera?"
            )
        if self.camera is not None and self.center is None:
            raise ReorientError("--camera without --center: expected the place of the object in camera axes, metres")

    def run(self) -> None:
        """Render, compare with the capture, write, print."""
        from reorient import se3
        from reorient.imaging import Goal
        from reorient.imaging.files import read_depth
        from reorient.imaging.goal_files import write_goal
        from reorient.imaging.intrinsics import read_pinhole
        from reorient.imaging.summary import check_scale
        from reorient.world.meshes import load_mesh

        R, unit_m = self._rotation(), UNITS_M[self.unit]
        bounds_m = load_mesh(self.mesh).bounds * unit_m
        real = None if self.capture is None else read_depth(self.capture)
        camera = read_pinhole(self.camera) if real is None else real.camera  # type: ignore[arg-type]

        def rendered(center_m: np.ndarray) -> Goal:
            T = se3.transform(R, center_m - R @ bounds_m.mean(axis=0))
            return Goal.from_mesh(self.mesh, T, camera, unit_m, self.views)

        center_m = np.array(self.center) if self.center is not None else _place_m(real)
        goal = rendered(center_m)
        if real is not None:
            check_scale(real, goal)
            shown_m = _shown_m(real, goal, center_m)
            goal = goal if shown_m is None or self.center is not None else rendered(shown_m)
        provenance = {"made": "mesh", "mesh": self.mesh.name, "unit_m": unit_m, "R_camera_mesh": R.tolist()}
        write_goal(self.out, goal, provenance)
        write_sheet(self.out.with_suffix(".png"), goal)
        print_statement(goal)
        print(self.out)

    def _rotation(self) -> np.ndarray:
        values = np.array(self.rotation, float)
        if values.size in (0, 3):
            return so3.exp(np.radians(values if values.size else np.zeros(3)))
        R = values.reshape(3, 3) if values.size == 9 else np.zeros((3, 3))
        if not so3.is_rotation(R, 1e-3):
            raise ReorientError(
                f"--rotation of {values.size} numbers: expected a rotation vector (3, degrees) or a rotation matrix (9)"
            )
        u, _, vt = np.linalg.svd(R)
        return np.asarray(u @ vt)


def print_statement(goal: "Goal") -> None:
    """Print what an aligned goal can and cannot tell."""
    from reorient.estimators.goal_report import report_on

    for sentence in report_on(goal).sentences():
        print(sentence)


def write_sheet(path: Path, goal: "Goal") -> None:
    """Draw all views of a goal in one picture."""
    from reorient.reporting.pictures import check_suffix, depth_range, framed, montage, shade
    from reorient.runs.files import replacing

    check_suffix(path)
    images = [goal.image, *(view.image for view in goal.views)]
    labels = ["goal", *(f"{np.degrees(so3.angle(view.R_goal_view)):.0f} deg from it" for view in goal.views)]
    tiles = [shade(image, _TILE_PX, depth_range([image])) for image in framed(images)]
    with replacing(path) as temporary:
        montage(tiles, min(_COLUMNS, len(tiles)), labels).save(temporary)


def _place_m(image: Any) -> np.ndarray:
    """Where the centre of an object is, roughly: half of its mean width behind its nearest returns."""
    low, high = np.percentile(image.points(), (1, 99), axis=0)
    middle_m = (low + high) / 2
    middle_m[2] = low[2] + float(np.mean((high - low)[:2])) / 2
    return np.asarray(middle_m)


def _shown_m(real: "DepthImage", goal: "Goal", center_m: np.ndarray) -> np.ndarray | None:
    """Where a capture shows the centre of the goal's object; None, with a warning, where that is not sure."""
    from reorient import se3
    from reorient.estimators import load_estimator

    estimate = load_estimator().estimate(real, goal)
    if (estimate.confidence or 0.0) < SURE:
        print(
            f"reorient: warning: the capture may not show this mesh (confidence "
            f"{format_probability(estimate.confidence)}): is it the same object, in this unit, not mirrored?",
            file=sys.stderr,
        )
        return None
    print(
        f"the capture shows this mesh (confidence {format_probability(estimate.confidence)}): the goal is at its place"
    )
    return se3.apply(se3.inverse(estimate.T_goal_current), center_m)


def _origin(provenance: Mapping[str, Any]) -> str:
    """Where a goal comes from, in words."""
    source = provenance.get("mesh") or provenance.get("station") or "unknown source"
    return f"made {provenance.get('date', 'at an unknown time')} by reorient {provenance.get('reorient')}, {source}"
