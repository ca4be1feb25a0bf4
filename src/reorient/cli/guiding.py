"""The verb guide: a person rotates the object by hand."""

import shutil
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from reorient.cli.arguments import Metavar, Positional
from reorient.cli.isolating import GoalFrame
from reorient.cli.stations import StationChoice
from reorient.cli.view_options import ViewOptions
from reorient.errors import ReorientError, check_counts, check_range
from reorient.formatting import format_probability

if TYPE_CHECKING:
    from reorient.controller.guide_log import GuideLog
    from reorient.controller.guiding import Frames, Guidance, GuideState, GuideSubscriber
    from reorient.stations.guarded import Isolate
    from reorient.stations.rendered_hand import RenderedHand

HAND = "rendered-hand"
HAND_S = 120.0  # longest trial of the simulated hand
_BAR = 24  # characters
_CLEAR, _PLAIN = "\r\x1b[K", "\x1b[0m"  # to the start of an empty line; no colour
_GREEN, _YELLOW, _RED, _MAGENTA = "\x1b[1;32m", "\x1b[33m", "\x1b[31m", "\x1b[35m"
_EVERY_S = 1.0  # between two lines of the same status where the output is no terminal


@dataclass(frozen=True)
class GuideStation(StationChoice):
    """Choice of the camera."""

    station: Annotated[str | None, Metavar("STATION")] = None
    """A robot.toml, whose camera and isolation are used; a camera driver such as realsense; a class of your own as
    module:Class, with capture(); a folder of a recording; or 'rendered-hand' for a simulated person."""
    start_deg: float = 40.0
    """Angle by which the simulated object is rotated from the goal at first, about a random axis."""
    noise_mm: float = 1.0
    """Standard deviation of the simulated depth noise."""

    def frames(self, isolate: "Isolate | None") -> "tuple[Frames, RenderedHand | None]":
        """The images, and the simulated hand where it makes them. Raises ReorientError for a wrong name."""
        from reorient.stations.watching import replay, watch

        if self.station is None:
            raise ReorientError(f"--station is missing: expected a robot.toml, a camera driver, or {HAND!r} to try it")
        if self.station == HAND:
            hand = self._hand()
            return hand.frames(), hand
        if Path(self.station).is_dir():
            return replay(Path(self.station), isolate), None
        return watch(*self._camera(self.station, isolate)), None

    def _camera(self, name: str, isolate: "Isolate | None") -> "tuple[object, Isolate | None]":
        """A camera and what isolates its images."""
        from reorient.controller.station import missing_members
        from reorient.plugins import make_own
        from reorient.stations.drivers import CAMERAS, make_camera

        if name.endswith(".toml"):
            from reorient.stations.robot_file import read_robot_file

            file = read_robot_file(name)
            return file.open_camera(), isolate or file.isolation
        if ":" not in name:
            if name not in CAMERAS:
                expected = f"a robot.toml, one of {', '.join(CAMERAS)}, my_module:MyCamera, a folder or {HAND!r}"
                raise ReorientError(f"station {name!r}: expected {expected}")
            return make_camera(name, {}), isolate
        camera = make_own("station", name)
        if missing_members(camera, ("capture",)):
            raise ReorientError(f"station {name!r} has no capture: expected capture() -> DepthImage")
        return camera, isolate

    def _hand(self) -> "RenderedHand":
        from reorient.stations.rendered_hand import RenderedHand
        from reorient.world.objects import generated
        from reorient.world.rendering import load_world
        from reorient.world.sensing import randomised

        objects, sensor = generated(self.object_index + 1), randomised(self.noise_mm / 1000)
        rng = np.random.default_rng(self.pose_seed)
        mesh = objects.load(objects.names[-1])
        return RenderedHand(mesh, load_world("benchmark"), sensor, rng, np.radians(self.start_deg))


@dataclass(frozen=True)
class GuideOptions:
    """When an object matches, and the words for the worker."""

    tolerance_deg: float = 1.0
    """Largest angle to the goal that is a match, at least 0.5."""
    hold_s: float = 0.5
    """How long the object must stay within it."""
    opposite: bool = False
    """The worker looks towards the camera, not from it: left and right, and the senses of tilt and roll, change."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "tolerance_deg", low=0.5, high=180)
        check_range(self, "hold_s")

    def guidance(self) -> "Guidance":
        """The settings of the guide."""
        from reorient.controller.guiding import Guidance

        return Guidance(tolerance_rad=float(np.radians(self.tolerance_deg)), hold_s=self.hold_s, opposite=self.opposite)


@dataclass(frozen=True)
class Guide:
    """Guide a person who rotates the object by hand until it matches the goal image.

    The exit code is 0 where all objects matched, 1 where the images or the time ended before.

    Examples:
        reorient capture goal.npz --station rendered && reorient guide goal.npz --station rendered-hand
        reorient guide goal.npz --station robot.toml --parts 20 --log quality.csv --name housing
    """

    goal: Positional[Path]
    """Depth image of the object as it should be, as written by ``reorient capture``."""
    frames: GoalFrame = field(default_factory=GoalFrame)
    isolate_station: bool = False
    """Isolate the images of the camera by the same options, by the first of two values."""
    choice: GuideStation = field(default_factory=GuideStation)
    options: GuideOptions = field(default_factory=GuideOptions)
    estimator: str = "rotation-search"
    """Estimator that finds the rotation at first and after a loss, and checks a match: a name as for ``orient``."""
    parts: int = 1
    """Number of objects to match, one after another."""
    timeout_s: float | None = None
    """Longest time in all, by default unlimited, and 120 for the simulated hand."""
    log: Path | None = None
    """CSV file to which a line for each object is appended: date, start angle, time to match, final angle."""
    name: str = ""
    """Name of the objects in the log."""
    view: bool = False
    """Show in a browser how to rotate the object."""
    view_options: ViewOptions = field(default_factory=ViewOptions)

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_counts(self, "parts")
        check_range(self, "timeout_s", above=True)

    def run(self) -> int:
        """Guide; the exit code."""
        from reorient.controller import guiding
        from reorient.controller.guide_log import GuideLog
        from reorient.estimators import load_estimator
        from reorient.estimators.tracking import Tracker

        log = GuideLog(self.log, self.name)
        goal = self.frames.read(self.goal, goal=True).goal
        tracker = Tracker(load_estimator(self.estimator), goal)
        frames, hand = self.choice.frames(self.frames.isolation() if self.isolate_station else None)
        limit_s = self.timeout_s or (HAND_S if hand else float("inf"))
        states = guiding.Guide(tracker, self.options.guidance()).states(frames)
        tolerance_deg = self.options.tolerance_deg
        view = self.view_options.guide(goal.image, f"Guide to {self.goal.name}", tolerance_deg) if self.view else None
        with Terminal(tolerance_deg) as terminal:
            subscribers: list[GuideSubscriber] = [terminal, log, *([hand] if hand else []), *([view] if view else [])]
            try:
                _follow(states, subscribers, log, self.parts, limit_s)
            finally:
                log.finish()
                if view is not None:
                    view.close()
        return _print_outcome(log, self.parts)


def _follow(
    states: "Iterable[GuideState]",
    subscribers: "list[GuideSubscriber]",
    log: "GuideLog",
    parts: int,
    limit_s: float,
) -> None:
    """Pass all states to the subscribers, until enough objects matched or the time is over."""
    begin_s: float | None = None
    for state in states:
        begin_s = state.time_s if begin_s is None else begin_s
        for subscriber in subscribers:
            subscriber(state)
        if len(log.matched) >= parts or state.time_s - begin_s >= limit_s:
            return


def _print_outcome(log: "GuideLog", parts: int) -> int:
    """Print a line for each object; the exit code."""
    for trial in log.matched:
        assert trial.last is not None
        assert trial.last.angle_rad is not None
        assert trial.begin_s is not None
        print(
            f"matched in {trial.last.time_s - trial.begin_s:.1f} s: from {trial.start_deg:.1f} deg to "
            f"{np.degrees(trial.last.angle_rad):.2f} deg, confidence {format_probability(trial.last.confidence)}"
        )
    if len(log.matched) >= parts:
        return 0
    state = log.trial.last
    where = "no object was recognised" if state is None else f"the last estimate is {_angle(state)}"
    print(f"reorient: {len(log.matched)} of {parts} objects matched: {where}", file=sys.stderr)
    return 1


class Terminal:
    """A subscriber that draws one line, or prints a line for each change where the output is no terminal."""

    def __init__(self, tolerance_deg: float) -> None:
        self._tolerance_deg = tolerance_deg
        self._live = sys.stdout.isatty()
        self._printed: tuple[str, float] = ("", -np.inf)

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            print(_CLEAR, end="", flush=True)

    def __call__(self, state: "GuideState") -> None:
        """Show a state."""
        line, colour = self._line(state)
        if self._live:
            width = shutil.get_terminal_size().columns - 1
            print(f"{_CLEAR}{colour}{line[:width]}{_PLAIN}", end="", flush=True)
            return
        status, time_s = self._printed
        if state.status != status or state.time_s >= time_s + _EVERY_S:
            self._printed = state.status, state.time_s
            print(line, flush=True)

    def _line(self, state: "GuideState") -> tuple[str, str]:
        """Bar, angle, instruction and confidence, and their colour."""
        if state.angle_rad is None:
            return f"[{'?' * _BAR}] {state.status.replace('_', ' ')}: {state.instruction}", _MAGENTA
        angle_deg = float(np.degrees(state.angle_rad))
        colour = _GREEN if angle_deg <= self._tolerance_deg else _YELLOW if angle_deg <= 10 else _RED
        filled = int(np.ceil(_BAR * np.sqrt(angle_deg / 180)))  # fine near the goal
        bar = f"[{'#' * filled}{'-' * (_BAR - filled)}]"
        return f"{bar} {_angle(state)}  {state.instruction}", colour


def _angle(state: "GuideState") -> str:
    assert state.angle_rad is not None
    return f"{np.degrees(state.angle_rad):5.1f} deg ({format_probability(state.confidence)})"
