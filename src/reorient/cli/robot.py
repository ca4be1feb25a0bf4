"""The robot's verbs: demo, orient, replay, capture."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tyro.conf import Positional

from reorient import __version__
from reorient.cli.estimating import Frames
from reorient.errors import ReorientError
from reorient.runs.files import make_folder

if TYPE_CHECKING:
    from reorient.controller import Limits, Strategy
    from reorient.controller.station import Station
    from reorient.estimators.base import Estimator
    from reorient.imaging import DepthImage


@dataclass(frozen=True)
class StationChoice:
    """Which station, and what the rendered one shows."""

    station: str = "rendered"
    """'rendered', or your own: my_module:MyStation (importable from here, made with no arguments)."""
    object_index: int = 0
    """Rendered: which generated object."""
    pose_seed: int = 0
    """Rendered: seeds its orientation and place."""
    turn_deg: float = 0.0
    """Rendered: turned this far away from that orientation, about a random axis."""
    noise_mm: float = 0.0
    """Rendered: depth noise."""

    def open(self) -> "Station":
        """The station, ready."""
        from reorient import so3
        from reorient.stations import load_station
        from reorient.stations.rendered import RenderedStation
        from reorient.world.objects import generated
        from reorient.world.rendering import load_world
        from reorient.world.sensing import randomised

        if self.station != "rendered":
            return load_station(self.station)
        if not all(0 <= x < np.inf for x in (self.object_index, self.pose_seed, self.turn_deg, self.noise_mm)):
            raise ReorientError("expected an object, a seed, a turn and noise from 0 on, all finite")
        objects = generated(self.object_index + 1)
        rng = np.random.default_rng(self.pose_seed)
        sensor = randomised(self.noise_mm / 1000)
        station = RenderedStation(objects.load(objects.names[-1]), load_world("benchmark"), sensor, rng)
        turn = np.radians(self.turn_deg)
        station.rotate(so3.matrix_from_quat(so3.sample_bounded(rng, 1, turn, turn))[0])
        return station


@dataclass(frozen=True)
class Demo:
    """Turn a generated object, seen only in depth images, to match a picture; leaves a GIF and an HTML page.

    For example: reorient demo --out out/demo
    or, another object and start: reorient demo --object-index 7 --start-deg 25 --noise-mm 0
    """

    out: Path = Path("out/demo")
    """Folder for the GIF and the page."""
    object_index: int = 51
    """Which generated object."""
    start_deg: float = 130.0
    """How far the start is from the goal."""
    noise_mm: float = 1.0
    """Depth noise."""
    estimator: str = "default"
    seed: int = 0

    def run(self) -> None:
        """Make the station, teach the goal, turn away, and close the loop."""
        from reorient import so3
        from reorient.controller import Step, orient
        from reorient.estimators import load_estimator
        from reorient.reporting import write_loop

        make_folder(self.out)
        estimator = load_estimator(self.estimator)
        station: Any = StationChoice("rendered", self.object_index, self.seed, 0.0, self.noise_mm).open()
        goal, R_goal = station.capture_goal(), station.R_camera_object
        turn = np.radians(self.start_deg)
        station.rotate(so3.matrix_from_quat(so3.sample_bounded(np.random.default_rng(self.seed), 1, turn, turn))[0])
        errors_deg = [self.start_deg]
        print(f"An object that nobody modelled, {self.start_deg:g} degrees from its goal. Estimator: {self.estimator}.")

        def tell(step: Step) -> None:
            seen_deg = np.degrees(step.estimate.angle_rad)
            print(
                f"image {step.index + 1:3d}: {seen_deg:6.2f} degrees to go by the images, {errors_deg[-1]:6.2f} truly. "
                f"{step.message}"
            )
            errors_deg.append(float(np.degrees(so3.angle_difference(R_goal, station.R_camera_object))))

        result = orient(station, goal, estimator, subscribers=[tell])
        print(f"{'Done' if result.converged else 'Stopped'} after {result.moves} moves: {result.reason}.")
        title = f"Generated object {self.object_index}, {self.start_deg:g} degrees away"
        for path in write_loop(self.out, goal, result, errors_deg, title):
            print(path)


@dataclass(frozen=True)
class Orient:
    """Turn the object at a station until it looks like GOAL.

    For example: reorient capture goal.npz && reorient orient goal.npz --turn-deg 30
    or, your own cell: reorient orient goal.npz --station my_cell:MyStation --out out/run
    """

    goal: Positional[Path]
    """Depth image as desired, as ``reorient capture`` writes it."""
    frames: Frames = field(default_factory=Frames)
    choice: StationChoice = field(default_factory=StationChoice)
    estimator: str = "default"
    strategy: str = "auto"
    """'fusing', 'algorithm1' (the paper's), or 'auto': fusing where the estimator's confidence is calibrated, else, or
    with --eta or --delta-deg, algorithm1."""
    max_images: int | None = None
    """Largest number of images; default: the strategy's own."""
    eta: float | None = None
    """Algorithm 1: share of the predicted rotation to turn at once; default 0.2."""
    delta_deg: float | None = None
    """Algorithm 1: done when the predicted angle is at most this; default 0.5."""
    largest_step_deg: float = 180.0
    """Larger moves are made in parts."""
    largest_total_deg: float = float("inf")
    """End rather than turn by more than this in all."""
    dry_run: bool = False
    """Capture, estimate and say the first move; move nothing."""
    confirm_first_move: bool = False
    """Ask before the first move."""
    record: Path | None = None
    """Folder, a new one, for all that the station sees and does: see ``reorient replay``."""
    out: Path | None = None
    """Folder for a page and a GIF of the run."""

    def run(self) -> None:
        """Close the loop; a loop that does not converge is an error, unless it was a dry run."""
        from dataclasses import replace

        from reorient.controller import Limits
        from reorient.estimators import load_estimator
        from reorient.runs.provenance import commit
        from reorient.stations.replay import RecordingStation

        strategy = _strategy(self.strategy, self.max_images, self.eta, self.delta_deg)
        limits = Limits(np.radians(self.largest_step_deg), np.radians(self.largest_total_deg), dry_run=self.dry_run)
        if self.confirm_first_move:
            limits = replace(limits, confirm=_confirmed)
        goal, estimator = self.frames.read(self.goal, 1), load_estimator(self.estimator)
        if self.out is not None:
            make_folder(self.out)
        station = self.choice.open()
        if self.record is not None:
            about = {
                "estimator": self.estimator,
                "strategy": {
                    "strategy": self.strategy,
                    "max_images": self.max_images,
                    "eta": self.eta,
                    "delta_deg": self.delta_deg,
                },
                "limits": {
                    "max_step_deg": self.largest_step_deg,
                    "max_rotation_deg": self.largest_total_deg,
                    "dry_run": self.dry_run,
                },
                "station": self.choice.station,
                "version": __version__,
                "commit": commit(),
            }
            station = RecordingStation(station, self.record, goal, about)
        title = f"Station {self.choice.station}"
        _close_loop(station, goal, estimator, strategy, limits, self.out, title)


@dataclass(frozen=True)
class Replay:
    """Run a recorded loop again, without its station: the same frames and answers, the decisions made anew.

    For example: reorient orient goal.npz --turn-deg 120 --record out/record && reorient replay out/record
    """

    record: Positional[Path]
    """What ``reorient orient --record`` wrote."""
    out: Path | None = None
    """Folder for a page and a GIF of the run."""

    def run(self) -> None:
        """Replay; a loop that does not converge is an error, as it was."""
        from reorient.controller import Limits
        from reorient.estimators import load_estimator
        from reorient.stations.replay import ReplayedStation

        station = ReplayedStation(self.record)
        try:
            estimator_name = station.record["estimator"]
            strategy = _strategy(**station.record["strategy"])
            limit = station.record["limits"]
            limits = Limits(
                np.radians(limit["max_step_deg"]),
                np.radians(limit["max_rotation_deg"]),
                dry_run=limit["dry_run"],
                wait_s=0.0,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ReorientError(
                f"the record does not say how it was made ({error}): expected one of `orient`"
            ) from error
        estimator = load_estimator(str(estimator_name))
        if self.out is not None:
            make_folder(self.out)
        title = f"Record {self.record.name}"
        _close_loop(station, station.goal(), estimator, strategy, limits, self.out, title)


def _strategy(
    strategy: str, max_images: int | None = None, eta: float | None = None, delta_deg: float | None = None
) -> "Strategy | None":
    """The strategy of a command line; None: the loop chooses. Settings of Algorithm 1 select it."""
    from reorient.controller import load_strategy

    delta_rad = None if delta_deg is None else float(np.radians(delta_deg))
    given = {"max_images": max_images, "eta": eta, "delta_rad": delta_rad}
    settings = {name: value for name, value in given.items() if value is not None}
    if strategy != "auto":
        return load_strategy(strategy, **settings)
    if set(settings) == {"max_images"}:
        raise ReorientError("--max-images is a setting of a strategy: expected --strategy with it")
    return load_strategy("algorithm1", **settings) if settings else None


def _confirmed(R_step: np.ndarray) -> bool:
    """Ask at the terminal; no answer is a no."""
    from reorient import so3

    rotvec = np.degrees(so3.log(R_step))
    turn = (
        f"{np.linalg.norm(rotvec):.1f} degrees (rotation vector [{' '.join(f'{x:.1f}' for x in rotvec)}], camera axes)"
    )
    try:
        return input(f"The first move is {turn}. Go? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        return False


def _close_loop(
    station: "Station",
    goal: "DepthImage",
    estimator: "Estimator",
    strategy: "Strategy | None",
    limits: "Limits",
    out: Path | None,
    title: str,
) -> None:
    """Run the loop, tell its decisions, write its page, and raise ReorientError where it did not converge."""
    from reorient.controller import Step, orient
    from reorient.reporting import write_loop
    from reorient.stations.replay import RecordingStation

    def tell(step: Step) -> None:
        seen_deg = np.degrees(step.estimate.angle_rad)
        print(f"image {step.index + 1:3d}: {seen_deg:6.2f} degrees to go. {step.message}", flush=True)

    result = orient(station, goal, estimator, strategy, limits=limits, subscribers=[tell])
    if isinstance(station, RecordingStation):
        station.finish(result)
    for error in result.errors:
        print(f"on the way: {error}")
    if out is not None and result.steps:
        for path in write_loop(out, goal, result, [], title):
            print(path)
    if result.status == "dry_run":
        print(result.reason)
        return
    if not result.converged:
        raise ReorientError(f"not converged after {result.moves} moves: {result.reason}")
    print(f"Done after {result.moves} moves: {result.reason}.")


@dataclass(frozen=True)
class Capture:
    """Teach a goal: write what the station's camera sees now.

    For example: reorient capture goal.npz --station my_cell:MyStation
    """

    out: Positional[Path]
    """File to write: .npz, .tif, or .png (in steps of 0.1 mm); all keep the camera."""
    choice: StationChoice = field(default_factory=StationChoice)

    def run(self) -> None:
        """Capture and write."""
        from reorient.controller.station import captured
        from reorient.imaging.files import write_depth

        station: Any = self.choice.open()
        try:  # a simulated gripper can be told to let go of the picture
            image = captured(station.capture_goal() if hasattr(station, "capture_goal") else station.capture())
        except ReorientError:
            raise
        except Exception as error:
            raise ReorientError(f"the station failed to capture ({type(error).__name__}: {error})") from error
        write_depth(self.out, image, scale_m=0.0001)
        print(self.out)
