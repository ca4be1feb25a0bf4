"""The verb view."""

import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from reorient.cli.arguments import Metavar, Positional
from reorient.cli.robot import Replay
from reorient.cli.view_options import ViewOptions
from reorient.errors import ReorientError

if TYPE_CHECKING:
    from reorient.controller import OrientResult
    from reorient.viewing.viewer import Viewer


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
        goal, result = Replay(record, self.estimator).result()
        viewer = self.view.open(goal, f"Record {record.name}")
        show_all(viewer, result)
        return viewer


def show_all(viewer: "Viewer", result: "OrientResult") -> None:
    """Show the steps of a loop, and how it ended."""
    for step in result.steps:
        viewer(step)
    viewer.wait()
    viewer.say(f"{result.status.replace('_', ' ')}: {result.reason}")
