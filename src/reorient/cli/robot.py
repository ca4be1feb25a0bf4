"""The verbs of the closed loop: orient, replay."""

import shutil
import sys
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reorient import __version__
from reorient.cli.arguments import Positional
from reorient.cli.isolating import GoalFrame
from reorient.cli.outputs import LoopOutputs, print_outcome
from reorient.cli.stations import StationChoice
from reorient.cli.viewing import ViewOptions, base_in_camera
from reorient.errors import ReorientError, check_range

if TYPE_CHECKING:
    from reorient.controller import Limits, OrientResult, Step, Strategy
    from reorient.estimators.base import Estimator
    from reorient.imaging import DepthImage
    from reorient.stations.replay import ReplayedStation
    from reorient.viewing.viewer import Viewer

OWN_STEP_DEG, OWN_ROTATION_DEG = 45.0, 720.0  # limits for a station of the user's own
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
        check_range(self, "max_images", low=1)
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


@dataclass(frozen=True)
class LimitChoice:
    """Limits of the moves."""

    max_step_deg: float | None = None
    """Largest angle of one move, above which it is made in parts, by default 45 for a station of your own and else
    180."""
    max_rotation_deg: float | None = None
    """Largest sum of the angles of all moves, by default 720 for a station of your own and else unlimited."""
    dry_run: bool = False
    """Capture, estimate and print the first move, but move nothing."""
    confirm_first_move: bool = False
    """Ask at the terminal before the first move, as it is done for a station of your own anyway."""
    yes: bool = False
    """Make the first move without asking."""
    timeout_s: float | None = None
    """Longest time of a capture or a move, after which the loop ends and the robot is stopped, by default unlimited."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "max_step_deg", "max_rotation_deg", "timeout_s", above=True)
        if self.yes and self.confirm_first_move:
            raise ReorientError("--yes and --confirm-first-move contradict each other: expected one of them")

    def of(self, own: bool) -> "LimitChoice":
        """The choice with its defaults for the user's own station, or for any other."""
        if not own:
            return self
        return replace(
            self,
            max_step_deg=OWN_STEP_DEG if self.max_step_deg is None else self.max_step_deg,
            max_rotation_deg=OWN_ROTATION_DEG if self.max_rotation_deg is None else self.max_rotation_deg,
            confirm_first_move=not self.yes,
        )

    def limits(self, wait_s: float = 0.5) -> "Limits":
        """The limits of the loop."""
        from reorient.controller import Limits

        return Limits(
            max_step_rad=np.radians(180.0 if self.max_step_deg is None else self.max_step_deg),
            max_rotation_rad=np.inf if self.max_rotation_deg is None else np.radians(self.max_rotation_deg),
            confirm=_confirmed if self.confirm_first_move else None,
            dry_run=self.dry_run,
            wait_s=wait_s,
            timeout_s=np.inf if self.timeout_s is None else self.timeout_s,
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
    """Depth image of the object as it should be, as written by ``reorient capture``."""
    frames: GoalFrame = field(default_factory=GoalFrame)
    isolate_station: bool = False
    """Isolate the images of the station by the same options, by the first of two values."""
    choice: StationChoice = field(default_factory=StationChoice)
    estimator: str = "rotation-search"
    """One of default (rotation-search), rotation-search, fast, thorough, gicp, icp, paper and swift, an .onnx file,
    or your own module:Class."""
    strategy_choice: StrategyChoice = field(default_factory=StrategyChoice)
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
        goal, estimator = self.frames.read(self.goal, goal=True).isolated, load_estimator(self.estimator)
        self.outputs.check()
        station = self.choice.open()
        if self.isolate_station:
            station = IsolatedStation(station, self.frames.isolation())
        if self.record is not None:
            weights = Path(self.estimator) if self.estimator.endswith(".onnx") else None
            about = {
                "estimator": weights.name if weights else self.estimator,
                "strategy": asdict(self.strategy_choice),
                "limits": asdict(chosen) | {"confirm_first_move": False, "timeout_s": None},
                "station": self.choice.station,
                "version": __version__,
                "commit": commit(),
            }
            station = RecordingStation(station, self.record, goal, about)
            if weights:
                shutil.copy(weights, self.record)
        title = f"Station {self.choice.station}"
        viewer = self.view_options.open(goal, title, base_in_camera(station)) if self.view else None
        return _close_loop(station, goal, estimator, strategy, limits, self.outputs, title, viewer)


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
        return _close_loop(*self.loop(), self.outputs, f"Record {self.record.name}")

    def result(self) -> "tuple[DepthImage, OrientResult]":
        """The goal and the loop, run in silence."""
        from reorient.controller import orient

        station, goal, estimator, strategy, limits = self.loop()
        return goal, orient(station, goal, estimator, strategy, limits=limits)

    def loop(self) -> "tuple[ReplayedStation, DepthImage, Estimator, Strategy | None, Limits]":
        """The station, the goal, the estimator, the strategy and the limits of the record."""
        from reorient.estimators import load_estimator
        from reorient.stations.replay import ReplayedStation

        station = ReplayedStation(self.record)
        try:
            estimator_name = self.estimator or self._recorded_estimator(station)
            strategy = StrategyChoice(**station.record["strategy"]).load()
            limits = LimitChoice(**station.record["limits"]).limits(wait_s=0.0)
        except (KeyError, TypeError, ValueError) as error:
            raise ReorientError(
                f"{str(self.record)!r} lacks valid settings ({error}): expected a folder of `reorient orient --record`"
            ) from error
        return station, station.goal(), load_estimator(estimator_name), strategy, limits

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


def _confirmed(R_step: np.ndarray) -> bool:
    """Ask at the terminal, below the reason for the move; no answer is a no."""
    from reorient import so3

    rotvec = np.degrees(so3.log(R_step))
    vector = " ".join(f"{x:.1f}" for x in rotvec)
    angle_deg = np.linalg.norm(rotvec)
    return confirmed(
        f"first move: {angle_deg:.1f} deg (rotation vector [{vector}] deg, camera axes)", "make this move?"
    )


def confirmed(plan: str, question: str) -> bool:
    """Print a plan and ask for it at the terminal; no answer is a no."""
    print(plan, file=sys.stderr)
    print(f"{question} [y/N]", file=sys.stderr, flush=True)
    try:
        return input().strip().lower() in ("y", "yes")
    except EOFError:
        print("no answer: --yes moves without asking", file=sys.stderr)
        return False


class _Printer:
    """A subscriber that prints each decision before the move is made."""

    def decided(self, step: "Step") -> None:
        """Print the decision."""
        print(f"[{step.index + 1}] {step.message}", flush=True)

    def __call__(self, step: "Step") -> None:
        """Nothing: errors are printed at the end."""


def _close_loop(
    station: Any,
    goal: Any,
    estimator: Any,
    strategy: "Strategy | None",
    limits: "Limits",
    outputs: LoopOutputs,
    title: str,
    viewer: "Viewer | None" = None,
) -> int:
    """Run the loop, print its decisions and its outcome, write what is asked for; the exit code."""
    from reorient.controller import orient
    from reorient.stations.replay import RecordingStation

    subscribers: list[Any] = [_Printer(), *([] if viewer is None else [viewer])]
    result = orient(station, goal, estimator, strategy, limits=limits, subscribers=subscribers)
    if isinstance(station, RecordingStation):
        station.finish(result)
    code = print_outcome(result)
    outputs.write(goal, result, [], title)
    if viewer is not None:
        viewer.wait()
        viewer.close()
    return code
