"""The verbs of the closed loop: orient, replay."""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reorient import __version__
from reorient.cli.arguments import Positional
from reorient.cli.isolating import GoalFrame
from reorient.cli.limits import LimitChoice
from reorient.cli.outputs import LoopOutputs, print_outcome
from reorient.cli.stations import StationChoice
from reorient.cli.view_options import ViewOptions, base_in_camera
from reorient.errors import ReorientError, check_counts, check_range, reason_of

if TYPE_CHECKING:
    from reorient.controller import Limits, OrientResult, Step, Strategy
    from reorient.imaging import DepthImage, Goal
    from reorient.stations.replay import ReplayedStation
    from reorient.viewing.viewer import Viewer

_OWNERS = {"eta": ("algorithm1",), "delta_deg": ("algorithm1", "direct")}  # options that not every strategy has


@dataclass(frozen=True)
class StrategyChoice:
    """Choice of the strategy."""

    strategy: str = "auto"
    """One of fusing, algorithm1, direct and auto, which is fusing for a calibrated estimator and else algorithm1."""
    max_images: int | None = None
    """Largest number of images, by default the strategy's own. Needs --strategy."""
    eta: float | None = None
    """Share of the estimated rotation that algorithm1 makes at once, by default 0.2."""
    delta_deg: float | None = None
    """Estimated angle at which algorithm1 and direct have converged, by default 0.5."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_counts(self, "max_images")
        check_range(self, "eta", high=1, above=True)
        check_range(self, "delta_deg", high=180)

    def load(self) -> "Strategy | None":
        """The strategy; None leaves the choice to the loop. Raises ReorientError for a wrong name or setting."""
        from reorient.controller import load_strategy
        from reorient.controller.strategies import STRATEGY_NAMES

        for name, owners in _OWNERS.items():
            if getattr(self, name) is not None and self.strategy in set(STRATEGY_NAMES) - set(owners):
                flag = "--" + name.replace("_", "-")
                raise ReorientError(f"{flag} is an option of {' and '.join(owners)}, not of {self.strategy}")
        delta_rad = None if self.delta_deg is None else float(np.radians(self.delta_deg))
        given = {"max_images": self.max_images, "eta": self.eta, "delta_rad": delta_rad}
        settings = {name: value for name, value in given.items() if value is not None}
        if self.strategy != "auto":
            return load_strategy(self.strategy, **settings)
        if not settings:
            return None
        if set(settings) == {"max_images"}:
            raise ReorientError(f"--max-images {self.max_images}: expected --strategy with it")
        return load_strategy("algorithm1", **settings)


@dataclass(frozen=True, eq=False)
class _Loop:
    """All that a loop needs."""

    station: Any
    goal: "Goal"
    estimator: Any
    strategy: "Strategy | None"
    limits: "Limits"
    translation: bool

    def run(self, subscribers: Sequence[Any] = ()) -> "OrientResult":
        """Close it."""
        from reorient.controller import orient

        return orient(
            self.station,
            self.goal,
            self.estimator,
            self.strategy,
            limits=self.limits,
            subscribers=subscribers,
            translation=self.translation,
        )


@dataclass(frozen=True)
class Orient:
    """Rotate the object at a station until it matches the goal image.

    The exit code is 0 where the loop converged, also after --dry-run, and 1 where it did not converge.
    At a station of your own the first move is printed and must be confirmed (--yes does not ask).

    Examples:
        reorient capture goal.npz && reorient orient goal.npz --station rendered --start-deg 30
        reorient orient goal.npz --station my_cell:MyStation --record record --out run
    """

    goal: Positional[Path]
    """Depth image of the object as it should be, or a goal of several views, as written by ``reorient capture``."""
    frames: GoalFrame = field(default_factory=GoalFrame)
    isolate_station: bool = False
    """Isolate the images of the station by the same options, by the first of two values."""
    choice: StationChoice = field(default_factory=StationChoice)
    estimator: str = "rotation-search"
    """One of default (rotation-search), rotation-search, fast, normal, gicp, icp, paper and swift, an .onnx file,
    or your own module:Class."""
    strategy_choice: StrategyChoice = field(default_factory=StrategyChoice)
    translation: bool = False
    """Bring the object to the place of the goal, too, where the station can move it; at most 0.3 m at once."""
    limit_choice: LimitChoice = field(default_factory=LimitChoice)
    record: Path | None = None
    """New folder for a recording of all images and moves, which ``reorient replay`` reads."""
    outputs: LoopOutputs = field(default_factory=LoopOutputs)
    view: bool = False
    """Show the running loop in 3D in a browser. Closing the browser changes nothing."""
    view_options: ViewOptions = field(default_factory=ViewOptions)

    def run(self) -> int:
        """Close the loop; the exit code."""
        from reorient.estimators import load_estimator
        from reorient.runs.provenance import commit
        from reorient.stations.isolated import IsolatedStation
        from reorient.stations.replay import RecordingStation

        chosen = self.limit_choice.of(self.choice.own)
        strategy, limits = self.strategy_choice.load(), chosen.limits()
        self.choice.check()
        goal, estimator = self.frames.read(self.goal, goal=True).goal, load_estimator(self.estimator)
        self.outputs.check()
        station = self.choice.open()
        if self.isolate_station:
            station = IsolatedStation(station, self.frames.isolation())
        if self.record is not None:
            weights = Path(self.estimator) if self.estimator.endswith(".onnx") else None
            about = {
                "estimator": weights.name if weights else self.estimator,
                "strategy": asdict(self.strategy_choice),
                "translation": self.translation,
                "limits": asdict(chosen) | {"confirm_first_move": False, "timeout_s": None},
                "station": self.choice.station,
                "version": __version__,
                "commit": commit(),
            }
            station = RecordingStation(station, self.record, goal, about)
            if weights:
                shutil.copy(weights, self.record)
        title = f"Station {self.choice.station}"
        viewer = self.view_options.open(goal.image, title, base_in_camera(station)) if self.view else None
        loop = _Loop(station, goal, estimator, strategy, limits, self.translation)
        return _close_loop(loop, self.outputs, title, viewer)


@dataclass(frozen=True)
class Replay:
    """Run a recorded loop again, without its station.

    The images and the answers of the station are those of the recording; estimates and decisions are made anew. A
    record runs no code: name a class of your own by --estimator.

    Examples:
        reorient orient goal.npz --station rendered --start-deg 120 --record record && reorient replay record
        reorient replay record --estimator my_estimators:Mine
    """

    record: Positional[Path]
    """Folder that ``reorient orient --record`` wrote."""
    estimator: str | None = None
    """Estimator in place of the recorded one, as for ``orient``."""
    outputs: LoopOutputs = field(default_factory=LoopOutputs)

    def run(self) -> int:
        """Close the loop on the recording; the exit code, as of ``orient``."""
        self.outputs.check()
        return _close_loop(self._loop(), self.outputs, f"Record {self.record.name}")

    def result(self) -> "tuple[DepthImage, OrientResult]":
        """The goal's primary view and the loop, run in silence."""
        loop = self._loop()
        return loop.goal.image, loop.run()

    def _loop(self) -> "_Loop":
        """Raises ReorientError for a record without valid settings."""
        from reorient.estimators import load_estimator
        from reorient.stations.replay import ReplayedStation

        station = ReplayedStation(self.record)
        try:
            estimator_name = self.estimator or self._recorded_estimator(station)
            strategy = StrategyChoice(**station.record["strategy"]).load()
            limits = LimitChoice(**station.record["limits"]).limits(wait_s=0.0)
        except (KeyError, TypeError, ValueError) as error:
            raise ReorientError(
                f"{str(self.record)!r} lacks valid settings ({reason_of(error)}): expected a folder of "
                "`reorient orient --record`"
            ) from error
        translation = bool(station.record.get("translation", False))
        return _Loop(station, station.goal(), load_estimator(estimator_name), strategy, limits, translation)

    def _recorded_estimator(self, station: "ReplayedStation") -> str:
        """The estimator that the record names: of the package, or weights within the record."""
        name = str(station.record["estimator"])
        if name.endswith(".onnx"):
            return str(station.file(name))
        if ":" in name:
            raise ReorientError(
                f"{str(self.record)!r} names the estimator {name!r}, but a record runs no code: expected --estimator "
                f"{name} to use that class"
            )
        return name


class _Printer:
    """A subscriber that prints each decision before the move is made."""

    def decided(self, step: "Step") -> None:
        """Print the decision."""
        print(f"[{step.index + 1}] {step.message}", flush=True)

    def __call__(self, step: "Step") -> None:
        """Nothing: errors are printed at the end."""


def _close_loop(loop: _Loop, outputs: LoopOutputs, title: str, viewer: "Viewer | None" = None) -> int:
    """Run the loop, print its decisions and its outcome, write what is asked for; the exit code."""
    from reorient.stations.replay import RecordingStation

    subscribers: list[Any] = [_Printer(), *([] if viewer is None else [viewer])]
    result = loop.run(subscribers)
    if isinstance(loop.station, RecordingStation):
        loop.station.finish(result)
    code = print_outcome(result)
    outputs.write(loop.goal.image, result, [], title)
    if viewer is not None:
        viewer.wait()
        viewer.close()
    return code
