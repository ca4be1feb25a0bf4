"""The robot's verbs: demo, estimate, orient, capture."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from tyro.conf import Positional

from reorient.errors import ReorientError
from reorient.files import make_folder

if TYPE_CHECKING:
    from reorient.depth import Camera, DepthImage
    from reorient.estimators.base import RotationEstimate
    from reorient.stations.base import Station

T = TypeVar("T")


@dataclass(frozen=True)
class Frames:
    """How raw camera frames become images of one isolated object. One value serves both images, two are for CURRENT
    and GOAL; '-' is none (--near 0.3 -)."""

    camera: tuple[str, ...] = ()
    """Intrinsics JSON (reorient, Open3D or RealSense style); not needed where the image file states its camera."""
    depth_scale: tuple[float, ...] = ()
    """Metres per unit of integer depth; default: what the file states, else 0.001."""
    mask: tuple[str, ...] = ()
    """Picture or .npy, not zero on the object."""
    box: tuple[int, ...] = ()
    """Left, top, width, height in px: keep what is inside; four numbers, or eight."""
    near: tuple[str, ...] = ()
    """Keep returns at least this far, m."""
    far: tuple[str, ...] = ()
    """Keep returns at most this far, m."""

    def read(self, path: Path, which: int) -> "DepthImage":
        """The isolated image; ``which``: 0 current, 1 goal."""
        from reorient.depth import isolate
        from reorient.depth_files import read_depth, read_mask

        camera_file, mask = _each(self.camera, which, "--camera"), _each(self.mask, which, "--mask")
        if len(self.box) not in (0, 4, 8):
            raise ReorientError(f"--box with {len(self.box)} numbers: expected left top width height, once or twice")
        box = self.box[4:] if which and len(self.box) == 8 else self.box[:4]
        image = read_depth(path, self._camera(camera_file), _each(self.depth_scale, which, "--depth-scale"))
        return isolate(
            image,
            mask=None if mask in (None, "-") else read_mask(mask),
            box_px=(box[0], box[1], box[2], box[3]) if box else None,
            near_m=_metres(self.near, which, "--near"),
            far_m=_metres(self.far, which, "--far"),
        )

    def _camera(self, file: str | None) -> "Camera | None":
        from reorient.depth_files import read_camera

        return None if file in (None, "-") else read_camera(file)


def _each(values: tuple[T, ...], which: int, flag: str) -> T | None:
    if len(values) > 2:
        raise ReorientError(f"{flag} with {len(values)} values: expected one for both images, or two")
    return values[which if len(values) == 2 else 0] if values else None


def _metres(values: tuple[str, ...], which: int, flag: str) -> float | None:
    value = _each(values, which, flag)
    try:
        return None if value in (None, "-") else float(value)
    except ValueError as error:
        raise ReorientError(f"{flag} {value}: expected metres, or '-' for none") from error


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
        from reorient.objects import generated
        from reorient.rendering import load_world
        from reorient.sensing import randomised
        from reorient.stations import load_station
        from reorient.stations.rendered import RenderedStation

        if self.station != "rendered":
            return load_station(self.station)
        if min(self.object_index, self.pose_seed, self.turn_deg, self.noise_mm) < 0:
            raise ReorientError("expected an object, a seed, a turn and noise from 0 on")
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
    or, another object and start: reorient demo --object-index 7 --start-deg 25 --noise-mm 1
    """

    out: Path = Path("out/demo")
    """Folder for the GIF and the page."""
    object_index: int = 51
    """Which generated object."""
    start_deg: float = 45.0
    """How far the start is from the goal."""
    noise_mm: float = 0.0
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
                f"image {step.index + 1:3d}: {seen_deg:6.2f} degrees to go by the images, {errors_deg[-1]:6.2f} truly"
            )
            if step.R_executed is not None:
                errors_deg.append(float(np.degrees(so3.angle_difference(R_goal, station.R_camera_object))))

        result = orient(station, goal, estimator, subscribers=[tell])
        print(f"{'Done' if result.converged else 'Stopped'} after {result.moves} moves: {result.reason}.")
        title = f"Generated object {self.object_index}, {self.start_deg:g} degrees away"
        for path in write_loop(self.out, goal, result, errors_deg, title):
            print(path)


@dataclass(frozen=True)
class Estimate:
    """The rotation that turns the object in CURRENT into the one in GOAL (camera axes: x right, y down, z forward).

    For example: reorient estimate now.npz goal.npz
    or, raw frames: reorient estimate now.png goal.png --camera camera.json --box 200 120 256 256 --far 0.9
    """

    current: Positional[Path]
    """Depth image now: .png, .tif, .npy or .npz."""
    goal: Positional[Path]
    """Depth image as desired."""
    frames: Frames = field(default_factory=Frames)
    estimator: str = "default"
    pivot: tuple[float, float, float] | None = None
    """Rotation centre in camera axes, m, good to about 1 cm, if known."""
    json: bool = False
    """Print one JSON object instead of words."""
    explain: Path | None = None
    """Draw current, goal, current turned by the answer, and where they disagree (.png)."""

    def run(self) -> None:
        """Read, isolate, estimate, print, draw."""
        from reorient.estimators import load_estimator

        estimator = load_estimator(self.estimator)
        current, goal = self.frames.read(self.current, 0), self.frames.read(self.goal, 1)
        pivot_m = None if self.pivot is None else np.array(self.pivot)
        estimate = estimator.estimate(current, goal, pivot_m)
        if self.explain is not None:
            from reorient.explaining import picture
            from reorient.files import replacing

            with replacing(self.explain) as temporary:
                picture(current, goal, estimate).save(temporary)
        print(json.dumps(_as_data(estimate), indent=2) if self.json else _in_words(estimate))


def _as_data(estimate: "RotationEstimate") -> dict[str, Any]:
    from dataclasses import asdict

    from reorient import so3

    evidence = {k: None if v != v else v for k, v in asdict(estimate.evidence).items()}  # JSON has no NaN
    return {
        "quat_wxyz": estimate.quat_wxyz.tolist(),
        "angle_deg": float(np.degrees(estimate.angle_rad)),
        "axis": so3.quat_axis(estimate.quat_wxyz).tolist(),
        "R_goal_current": estimate.R_goal_current.tolist(),
        "t_goal_current_m": estimate.t_goal_current_m.tolist(),
        "covariance_rad2": None if estimate.covariance_rad2 is None else estimate.covariance_rad2.tolist(),
        "confidence": estimate.confidence,
        "alternatives": [{"R_goal_current": R.tolist(), "probability": p} for R, p in estimate.alternatives],
        "evidence": evidence | {"agreement": estimate.evidence.agreement},
    }


def _in_words(estimate: "RotationEstimate") -> str:
    from reorient.explaining import in_words

    data, evidence = _as_data(estimate), estimate.evidence
    rows = "\n           ".join(" ".join(f"{x:9.6f}" for x in row) for row in data["R_goal_current"])
    return "\n".join(
        [
            f"angle      {data['angle_deg']:.3f} degrees about [{' '.join(f'{x:.4f}' for x in data['axis'])}]",
            f"wxyz       {' '.join(f'{x:.6f}' for x in data['quat_wxyz'])}",
            f"matrix     {rows}",
            f"confidence {in_words(estimate)}",
            f"evidence   {evidence.fit:.0%} of points fit (rms {1000 * evidence.residual_m:.2f} mm), "
            f"{evidence.in_front:.0%} in front, {evidence.outside:.0%} outside, {evidence.behind:.0%} hidden",
        ]
    )


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
    max_steps: int = 100
    """K: largest number of images."""
    eta: float = 0.2
    """Share of the predicted rotation to turn at once."""
    delta_deg: float = 0.5
    """Done when the predicted angle is at most this."""
    out: Path | None = None
    """Folder for a page and a GIF of the run."""

    def run(self) -> None:
        """Close the loop; a loop that does not converge is an error."""
        from reorient.controller import Proportional, Step, orient
        from reorient.estimators import load_estimator
        from reorient.reporting import write_loop

        strategy = Proportional(self.max_steps, self.eta, float(np.radians(self.delta_deg)))
        if self.out is not None:
            make_folder(self.out)
        estimator = load_estimator(self.estimator)
        goal = self.frames.read(self.goal, 1)

        def tell(step: Step) -> None:
            print(f"image {step.index + 1:3d}: {np.degrees(step.estimate.angle_rad):6.2f} degrees to go", flush=True)

        result = orient(self.choice.open(), goal, estimator, strategy, subscribers=[tell])
        if self.out is not None and result.steps:
            for path in write_loop(self.out, goal, result, [], f"Station {self.choice.station}"):
                print(path)
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
        from reorient.depth_files import write_depth

        station: Any = self.choice.open()
        try:  # a simulated gripper can be told to let go of the picture
            image = station.capture_goal() if hasattr(station, "capture_goal") else station.capture()
        except ReorientError:
            raise
        except Exception as error:
            raise ReorientError(f"the station failed to capture ({type(error).__name__}: {error})") from error
        write_depth(self.out, image, scale_m=0.0001)
        print(self.out)
