"""The verb estimate, the options that isolate an object, and the text of an estimate."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np

from reorient import so3
from reorient.cli.arguments import Metavar, Positional
from reorient.errors import ReorientError
from reorient.formatting import format_number, format_probability, format_share
from reorient.plugins import in_one_line

if TYPE_CHECKING:
    from reorient.estimators.base import RotationEstimate
    from reorient.imaging import DepthImage
    from reorient.registration import Evidence

T = TypeVar("T")


@dataclass(frozen=True)
class Frames:
    """Reading and isolation of the images.

    One value is for both images, two are for CURRENT and GOAL. For --camera, --mask, --near and --far the value '-' is
    none: "--near 0.3 -" limits CURRENT.
    """

    camera: Annotated[tuple[str, ...], Metavar("PATH")] = ()
    """Camera file of any tool that docs/formats.md lists, not needed where the image file has its camera; PATH#NAME
    chooses one of several cameras. Its lens distortion is undone."""
    depth_scale: Annotated[tuple[float, ...], Metavar("M")] = ()
    """Metres per unit of integer depth, by default the image's own, else the camera file's, else 0.001."""
    mask: Annotated[tuple[str, ...], Metavar("PATH")] = ()
    """Image or .npy array that is not zero on the object."""
    box: Annotated[tuple[int, ...], Metavar("PX")] = ()
    """Left, top, width and height of the box that holds the object: four numbers, or eight for two boxes."""
    near: Annotated[tuple[str, ...], Metavar("M")] = ()
    """Ignore returns nearer than this, in metres."""
    far: Annotated[tuple[str, ...], Metavar("M")] = ()
    """Ignore returns farther than this, in metres."""

    def read(self, path: Path, *, goal: bool) -> "DepthImage":
        """The isolated image; ``goal``: by the options for GOAL, not those for CURRENT."""
        from reorient.imaging import isolate
        from reorient.imaging.files import read_depth, read_mask

        camera_file, mask = _each(self.camera, goal, "--camera"), _each(self.mask, goal, "--mask")
        if len(self.box) not in (0, 4, 8):
            raise ReorientError(f"--box with {len(self.box)} numbers: expected left top width height, once or twice")
        box = self.box[4:] if goal and len(self.box) == 8 else self.box[:4]
        near_m, far_m = _metres(self.near, goal, "--near"), _metres(self.far, goal, "--far")
        if near_m is not None and far_m is not None and near_m >= far_m:
            raise ReorientError(f"--near {near_m:g} --far {far_m:g}: expected --near below --far")
        camera = None if camera_file == "-" else camera_file
        image = read_depth(path, camera, _each(self.depth_scale, goal, "--depth-scale"))
        mask_array = None if mask in (None, "-") else read_mask(mask, camera)
        box_px = (box[0], box[1], box[2], box[3]) if box else None
        try:
            return isolate(image, mask_array, box_px, near_m, far_m)
        except ReorientError as error:
            raise ReorientError(f"{path}: {error}") from error


@dataclass(frozen=True)
class GoalFrame(Frames):
    """Reading and isolation of GOAL.

    The images of the station are used as they are.
    """


def _each(values: tuple[T, ...], goal: bool, flag: str) -> T | None:
    if len(values) > 2:
        raise ReorientError(f"{flag} with {len(values)} values: expected one for both images, or two")
    return (values[-1] if goal else values[0]) if values else None


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


@dataclass(frozen=True)
class Estimate:
    """Estimate the rotation between two depth images of one object.

    The rotation takes the object from its pose in CURRENT to its pose in GOAL, in camera axes: x right, y down,
    z forward.

    Examples:
        reorient estimate now.npz goal.npz
        reorient estimate now.png goal.png --camera camera.json --box 200 120 256 256 --far 0.9
    """

    current: Positional[Path]
    """Depth image of the object as it is now: .png, .tif, .npy, .npz, .exr, .pgm, .pfm, .pcd or .ply."""
    goal: Positional[Path]
    """Depth image of the object as it should be."""
    frames: Frames = field(default_factory=Frames)
    estimator: str = "rotation-search"
    """One of default (rotation-search), rotation-search, fast, thorough, gicp, icp, paper and swift, an .onnx file,
    or your own module:Class."""
    pivot: Annotated[tuple[float, float, float] | None, Metavar(("X", "Y", "Z"))] = None
    """Rotation centre in camera axes, in metres, if known to about 1 cm."""
    json: bool = False
    """Print a JSON object instead of text."""
    explain: Path | None = None
    """Draw both images and the evidence for the estimate (.png, .jpg)."""

    def run(self) -> None:
        """Read, isolate, estimate, print, draw."""
        from reorient.estimators import load_estimator
        from reorient.estimators.base import as_estimate

        if self.explain is not None:
            from reorient.reporting.pictures import check_suffix

            check_suffix(self.explain)
        estimator = load_estimator(self.estimator)
        current, goal = self.frames.read(self.current, goal=False), self.frames.read(self.goal, goal=True)
        pivot_m = None if self.pivot is None else np.array(self.pivot)
        with in_one_line("the estimator failed"):
            estimate = as_estimate(estimator.estimate(current, goal, pivot_m), current, goal)
        if self.explain is not None:
            from reorient.reporting.explaining import picture
            from reorient.runs.files import replacing

            with replacing(self.explain) as temporary:
                picture(current, goal, estimate).save(temporary)
        print(json.dumps(as_data(estimate), indent=2) if self.json else in_words(estimate))


def as_data(estimate: "RotationEstimate") -> dict[str, Any]:
    """The estimate as JSON has it, with the names of the Python interface."""
    evidence = estimate.evidence
    shares = asdict(evidence) | {"covisible_inlier_ratio": evidence.covisible_inlier_ratio, "score": evidence.score}
    return {
        "R_goal_current": estimate.R_goal_current.tolist(),
        "t_goal_current_m": estimate.t_goal_current_m.tolist(),
        "quat_wxyz": estimate.quat_wxyz.tolist(),
        "rotvec_rad": estimate.rotvec_rad.tolist(),
        "angle_deg": float(np.degrees(estimate.angle_rad)),
        "axis": so3.quat_axis(estimate.quat_wxyz).tolist(),
        "confidence": estimate.confidence,
        "alternatives": [{"R_goal_current": R.tolist(), "probability": p} for R, p in estimate.alternatives],
        "covariance_rad2": None if estimate.covariance_rad2 is None else estimate.covariance_rad2.tolist(),
        "evidence": {name: None if x != x else x for name, x in shares.items()},  # JSON has no NaN
    }


def in_words(estimate: "RotationEstimate") -> str:
    """The estimate as text, a line for each part."""
    evidence, rows = estimate.evidence, estimate.R_goal_current
    lines = [
        f"rotation      {_rotation(estimate.R_goal_current)} (camera axes)",
        f"quaternion    {_vector(estimate.quat_wxyz, 6)} (wxyz)",
        *(f"{'' if i else 'matrix':13s} {' '.join(f'{x:z9.6f}' for x in row)}" for i, row in enumerate(rows)),
        f"translation   {_vector(estimate.t_goal_current_m, 4)} m",
        f"confidence    {confidence_in_words(estimate.confidence)}",
        f"inliers       {inliers_in_words(evidence)}, residual {format_number(1000 * evidence.residual_m)} mm",
        f"violations    free space {format_share(evidence.free_space_violation)}, "
        f"silhouette {format_share(evidence.silhouette_violation)}",
        f"occluded      {format_share(evidence.occluded)}",
    ]
    for R, probability in estimate.alternatives:
        away = _rotation(R @ estimate.R_goal_current.T)
        lines.append(f"alternative   {format_probability(probability)}: the estimate rotated by {away}")
    return "\n".join(lines)


def confidence_in_words(confidence: float | None) -> str:
    """The probability that the error is small, or why there is none."""
    if confidence is None:
        return "not available (estimator is not calibrated)"
    return f"{format_probability(confidence)} (error below 5 deg)"


def inliers_in_words(evidence: "Evidence") -> str:
    """The share of inliers among all points and among those that both cameras see."""
    covisible = format_share(evidence.covisible_inlier_ratio)
    return f"{format_share(evidence.inlier_ratio)} ({covisible} of co-visible points)"


def _rotation(R: np.ndarray) -> str:
    quat_wxyz = so3.quat_from_matrix(R)
    return f"{np.degrees(so3.angle(R)):.2f} deg about {_vector(so3.quat_axis(quat_wxyz), 4)}"


def _vector(values: np.ndarray, decimals: int) -> str:
    return f"[{' '.join(f'{x:z.{decimals}f}' for x in values)}]"
