"""The options that read depth frames and isolate an object in them."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import numpy as np

from reorient.cli.arguments import Metavar
from reorient.errors import ReorientError

if TYPE_CHECKING:
    from reorient.imaging import DepthImage, Goal, GoalView, Isolation

T = TypeVar("T")


@dataclass(frozen=True)
class Input:
    """A frame of the command line."""

    name: str
    """current or goal."""
    raw: "DepthImage"
    isolated: "DepthImage"
    views: "tuple[GoalView, ...]" = ()
    """Further views, of a goal."""

    @property
    def goal(self) -> "Goal":
        """The isolated image with its further views."""
        from reorient.imaging import Goal

        return Goal(self.isolated, self.views)


@dataclass(frozen=True)
class IsolationOptions:
    """Isolation of the images of the station, which are used as they are without these options.

    The isolation options combine; the largest cluster of what they leave is the object.
    """

    box: Annotated[tuple[int, ...], Metavar("PX")] = ()
    """Left, top, width and height of the box that holds the object: four numbers, or eight for two boxes."""
    box_xyxy: Annotated[tuple[int, ...], Metavar("PX")] = ()
    """The same box as left, top, right and bottom; the column and the row of right and bottom are outside."""
    near: Annotated[tuple[str, ...], Metavar("M")] = ()
    """Ignore returns nearer than this, in metres."""
    far: Annotated[tuple[str, ...], Metavar("M")] = ()
    """Ignore returns farther than this, in metres."""
    around: Annotated[tuple[float, ...], Metavar("X Y Z RADIUS")] = ()
    """Keep returns within a sphere, in camera axes, in metres: four numbers, or eight for two spheres."""
    remove_plane: bool = False
    """Remove planes that continue beyond what the other options leave, such as a table and walls."""
    background: Annotated[tuple[str, ...], Metavar("EMPTY_FRAME")] = ()
    """Depth frame of the same camera without the object; what it shows as well is removed."""
    allow_touching: bool = False
    """Accept an object that continues beyond the box, range or sphere, lies in a plane that continues, or is in two."""

    def isolation(self, goal: bool = False) -> "Isolation":
        """The options of one image; the background as a file, without its camera."""
        from reorient.imaging import Isolation

        near_m, far_m = _metres(self.near, goal, "--near"), _metres(self.far, goal, "--far")
        if near_m is not None and far_m is not None and near_m >= far_m:
            raise ReorientError(f"--near {near_m:g} --far {far_m:g}: expected --near below --far")
        background = _each(self.background, goal, "--background")
        around = _four(self.around, goal, "--around", "x y z radius in metres")
        return Isolation(
            box_px=self._box(goal),
            near_m=near_m,
            far_m=far_m,
            around_m=around and around[:3],
            radius_m=around and around[3],
            remove_plane=self.remove_plane,
            background=None if background in (None, "-") else background,
            allow_touching=self.allow_touching,
        )

    def _box(self, goal: bool) -> tuple[int, int, int, int] | None:
        if self.box and self.box_xyxy:
            raise ReorientError("--box with --box-xyxy: expected one of them")
        corners = _four(self.box_xyxy, goal, "--box-xyxy", "left top right bottom")
        if corners is None:
            return _four(self.box, goal, "--box", "left top width height")
        left, top, right, bottom = corners
        if right <= left or bottom <= top:
            raise ReorientError(f"--box-xyxy {left} {top} {right} {bottom}: expected left < right and top < bottom")
        return left, top, right - left, bottom - top


@dataclass(frozen=True)
class Frames(IsolationOptions):
    """Reading and isolation of the images.

    One value is for both images, two are for CURRENT and GOAL. For --camera, --mask, --background, --near and --far the
    value '-' is none: "--near 0.3 -" limits CURRENT. The isolation options combine; the largest cluster of what they
    leave is the object. A goal of several views is isolated already: none of the options is for it.
    """

    camera: Annotated[tuple[str, ...], Metavar("PATH")] = ()
    """Camera file of any tool that docs/formats.md lists, not needed where the image file has its camera; PATH#NAME
    chooses one of several cameras. Its lens distortion is undone."""
    depth_scale: Annotated[tuple[float, ...], Metavar("M")] = ()
    """Metres per unit of integer depth, by default the image's own, else the camera file's, else 0.001."""
    mask: Annotated[tuple[str, ...], Metavar("PATH")] = ()
    """Image or .npy array that is not zero on the object, or a cut-out whose transparent pixels are not the object."""

    def read(self, path: Path, *, goal: bool, show: Path | None = None) -> Input:
        """The frame, raw and isolated; ``goal``: by the options for GOAL, not those for CURRENT.

        A goal of several views is isolated already, so the options are not for it. ``show``: a picture to draw where
        the frame is refused, with what would have been kept.
        """
        from reorient.imaging.files import read_depth, read_mask
        from reorient.imaging.goal_files import read_goal

        name, camera_file = "goal" if goal else "current", _each(self.camera, goal, "--camera")
        camera = None if camera_file == "-" else camera_file
        isolation, scale_m = self.isolation(goal), _each(self.depth_scale, goal, "--depth-scale")
        if goal and (several := read_goal(path, camera, scale_m)).views:
            return Input(name, several.image, several.image, several.views)
        raw = read_depth(path, camera, scale_m)
        if isinstance(isolation.background, str):
            isolation = replace(isolation, background=read_depth(isolation.background, camera or raw.camera, scale_m))
        mask = _each(self.mask, goal, "--mask")
        mask_array = None if mask in (None, "-") else read_mask(mask, camera)
        try:
            return Input(name, raw, isolation(raw, mask_array))
        except ReorientError as error:
            if show is not None:
                _show_refused(name, raw, replace(isolation, allow_touching=True), mask_array, show)
            raise ReorientError(f"{path}: {error}") from error

    def read_pair(self, current: Path, goal: Path, show: Path | None = None) -> tuple[Input, Input]:
        """Both frames. ``show``: a picture of them to draw."""
        inputs = self.read(current, goal=False, show=show), self.read(goal, goal=True, show=show)
        if show is not None:
            _show(inputs, show)
        return inputs


@dataclass(frozen=True)
class GoalFrame(Frames):
    """Reading and isolation of GOAL.

    The images of the station are used as they are without --isolate-station.
    """


def _show(inputs: "tuple[Input, ...]", path: Path) -> None:
    from reorient.reporting.inputs import picture
    from reorient.runs.files import replacing

    with replacing(path) as temporary:
        picture([(each.name, each.raw, each.isolated) for each in inputs]).save(temporary)


def _show_refused(name: str, raw: "DepthImage", isolation: "Isolation", mask: np.ndarray | None, path: Path) -> None:
    """Draw what a refused frame would have kept, if anything."""
    try:
        isolated = isolation(raw, mask)
    except ReorientError:
        return
    _show((Input(f"{name} (refused)", raw, isolated),), path)


def _each(values: tuple[T, ...], goal: bool, flag: str) -> T | None:
    if len(values) > 2:
        raise ReorientError(f"{flag} with {len(values)} values: expected one for both images, or two")
    return (values[-1] if goal else values[0]) if values else None


def _four(values: tuple[T, ...], goal: bool, flag: str, expected: str) -> tuple[T, T, T, T] | None:
    if len(values) not in (0, 4, 8):
        raise ReorientError(f"{flag} with {len(values)} numbers: expected {expected}, once or twice")
    chosen = values[4:] if goal and len(values) == 8 else values[:4]
    return (chosen[0], chosen[1], chosen[2], chosen[3]) if chosen else None


def _metres(values: tuple[str, ...], goal: bool, flag: str) -> float | None:
    value = _each(values, goal, flag)
    if value in (None, "-"):
        return None
    try:
        metres = float(value)
    except ValueError:
        metres = -1.0
    if not metres >= 0:
        raise ReorientError(f"{flag} {value}: expected metres from 0, or '-' for none")
    return metres
