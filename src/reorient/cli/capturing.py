"""The verb capture: one goal image, or a goal of several views."""

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from reorient.cli.arguments import Metavar, Positional
from reorient.cli.goals import print_statement, write_sheet
from reorient.cli.isolating import IsolationOptions
from reorient.cli.limits import LimitChoice
from reorient.cli.stations import StationChoice
from reorient.controller.station import Forwarding
from reorient.errors import ReorientError, check_counts, check_range
from reorient.imaging import DepthImage
from reorient.plugins import in_one_line


@dataclass(frozen=True)
class Capture:
    """Capture the goal at a station.

    With --views the robot rotates the held object away from its present pose, which is the goal pose, and returns it;
    the first move must be confirmed at a station of your own (--yes does not ask). The views are aligned to each other,
    a contact sheet is written beside the goal, and it is stated what the goal can and cannot tell.

    Examples:
        reorient capture goal.npz --station my_cell:MyStation
        reorient capture goal.npz --station robot.toml --views 5
        reorient capture goal.npz --station my_cell:RawCamera --around 0 0 0.5 0.15 --remove-plane
    """

    out: Annotated[Positional[Path], Metavar("GOAL")]
    """File to write: .npz, or of a single view also .tif, or .png with steps of 0.1 mm. Each also holds the camera."""
    views: int = 0
    """Number of further views from other sides; 5 show the object all round, as far as the arm reaches."""
    captures: int = 5
    """Number of images that each view is the mean of."""
    choice: StationChoice = field(default_factory=StationChoice)
    isolation: IsolationOptions = field(default_factory=IsolationOptions)
    limit_choice: LimitChoice = field(default_factory=LimitChoice)

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "views")
        check_counts(self, "captures")
        if self.views and self.out.suffix.lower() != ".npz":
            raise ReorientError(f"cannot write a goal of several views as {self.out.name!r}: expected .npz")

    def run(self) -> None:
        """Capture, isolate, align, write, print."""
        from reorient.imaging import Isolation
        from reorient.imaging.goal_files import write_goal
        from reorient.stations.isolated import IsolatedStation
        from reorient.stations.teaching import teach

        isolation = self.isolation.isolation()
        choice = replace(self.choice, station=self.choice.station or "rendered")
        limits = self.limit_choice.of(choice.own).limits()
        if not self.out.parent.is_dir():  # before anything moves
            raise ReorientError(f"cannot write {str(self.out)!r}: expected an existing folder {str(self.out.parent)!r}")
        station: Any = choice.open()
        if hasattr(station, "capture_goal"):
            station = _WithoutOcclusion(station)
        if isolation != Isolation():
            station = IsolatedStation(station, isolation)
        with in_one_line("the station failed to capture"):
            taught = teach(station, self.views, self.captures, limits, lambda line: print(line, file=sys.stderr))
        for warning in taught.warnings:
            print(f"reorient: warning: {warning}", file=sys.stderr)
        write_goal(self.out, taught.goal, {"station": choice.station} | taught.provenance)
        if self.views:
            write_sheet(self.out.with_suffix(".png"), taught.goal)
            print_statement(taught.goal)
        print(self.out if self.choice.station else f"{self.out} (simulated: no --station was given)")


class _WithoutOcclusion(Forwarding):
    """A simulated station whose gripper is left out of the images."""

    def capture(self) -> DepthImage:
        """The goal image."""
        image: DepthImage = self.capture_goal()
        return image
