"""The verb view, and the options of verbs that open the 3D view in a browser."""

import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from reorient.cli.arguments import Metavar, Positional
from reorient.errors import ReorientError, check_range

if TYPE_CHECKING:
    from reorient.controller import OrientResult
    from reorient.imaging import DepthImage
    from reorient.se3 import Transform
    from reorient.viewing.guide_view import GuideView
    from reorient.viewing.viewer import Viewer


@dataclass(frozen=True)
class ViewOptions:
    """The 3D view in a browser.

    It needs the extra view: pip install 'reorient[view]'.
    """

    host: str = "127.0.0.1"
    """Address that the view listens at. Any other than this computer's own is warned of: whoever reaches it sees the
    view and, with --station, commands the robot."""
    port: int = 8080
    """Port of the view; the next free one where it is taken."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "port", high=65535)

    def open(self, goal: "DepthImage", title: str, T_camera_base: "Transform | None" = None) -> "Viewer":
        """The view of a goal; prints its address. Raises ReorientError where the extra is not installed."""
        from reorient.viewing.viewer import Viewer

        viewer = Viewer(goal, title, self.host, self.port, T_camera_base)
        self._announce(viewer.address)
        return viewer

    def guide(self, goal: "DepthImage", title: str, tolerance_deg: float) -> "GuideView":
        """The view of a guide; prints its address. Raises ReorientError where the extra is not installed."""
        from reorient.viewing.guide_view import GuideView

        view = GuideView(goal, title, tolerance_deg, self.host, self.port)
        self._announce(view.address)
        return view

    def _announce(self, address: str) -> None:
        """Print the address, and a warning where others than this computer reach it."""
        from reorient.viewing.showing import LOOPBACK

        if self.host not in LOOPBACK:
            print(
                f"reorient: warning: the view listens at {self.host}: whoever reaches this address sees it and can use "
                "its buttons; there is no password",
                file=sys.stderr,
            )
        print(f"view: {address}", flush=True)


@dataclass(frozen=True)
class View:
    """Show a record, or a live station, in 3D in a browser.

    A record is run again, as by replay. Live, the view sets the isolation of robot.toml, teaches the goal, estimates,
    and moves: each move is asked for.

    Examples:
        reorient orient goal.npz --station rendered --start-deg 120 --record record && reorient view record
        reorient view --station robot.toml --goal goal.npz
    """

    record: Annotated[Positional[Path | None], Metavar("RECORD")] = None
    """Folder that ``reorient orient --record`` wrote."""
    station: Annotated[Path | None, Metavar("ROBOT_TOML")] = None
    """Show this cell live, in place of a record."""
    goal: Path = Path("goal.npz")
    """With --station: depth image of the object as it should be; "teach goal" writes it."""
    estimator: str | None = None
    """Estimator, as for ``orient``; of a record by default the recorded one."""
    view: ViewOptions = field(default_factory=ViewOptions)

    def run(self) -> int:
        """Serve the view until the keyboard interrupts."""
        if (self.record is None) == (self.station is None):
            raise ReorientError("view of nothing or of two things: expected a record, or --station robot.toml")
        with ExitStack() as opened, suppress(KeyboardInterrupt):
            if self.record is not None:
                opened.callback(self._recorded(self.record).close)
            elif self.station is not None:
                self._live(self.station, opened)
            while True:
                time.sleep(0.5)
        return 0

    def _live(self, station: Path, opened: ExitStack) -> None:
        """The view of a cell."""
        from reorient.viewing.live import LiveStation

        live = LiveStation(station, self.goal, self.estimator or "rotation-search")
        viewer = self.view.open(live.first_goal(), str(station), live.T_camera_base)
        opened.callback(viewer.close)
        live.attach(viewer)
        opened.callback(live.close)

    def _recorded(self, record: Path) -> "Viewer":
        """The view of all steps of a record."""
        from reorient.cli.robot import Replay

        goal, result = Replay(record, self.estimator).result()
        viewer = self.view.open(goal, f"Record {record.name}")
        show_all(viewer, result)
        return viewer


def base_in_camera(station: object) -> "Transform | None":
    """The pose of the robot's base in camera axes, where the station has a calibration."""
    from reorient import se3

    T_base_camera = getattr(getattr(station, "calibration", None), "T_base_camera", None)
    return None if T_base_camera is None else se3.inverse(T_base_camera)


def show_all(viewer: "Viewer", result: "OrientResult") -> None:
    """Show the steps of a loop, and how it ended."""
    for step in result.steps:
        viewer(step)
    viewer.wait()
    viewer.say(f"{result.status.replace('_', ' ')}: {result.reason}")
