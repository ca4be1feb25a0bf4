"""The verb transfer: taught tool poses for where the object is now."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from reorient.cli.arguments import Metavar, Positional
from reorient.cli.estimating import confidence_in_words
from reorient.cli.isolating import Frames
from reorient.errors import ReorientError, check_range
from reorient.formatting import format_number
from reorient.plugins import in_one_line

if TYPE_CHECKING:
    from reorient.perception.transfer import Transferred
    from reorient.se3 import Transform


@dataclass(frozen=True)
class Transfer:
    """Transfer taught tool poses to where the object is now.

    POSES were taught while the object was in the pose of GOAL: a CSV file with a row x,y,z,qw,qx,qy,qz for each (other
    orders with a header), or 4 x 4 matrices, in base axes and metres. Nothing moves. Where the confidence is too low
    nothing is written, and the exit code is 1.

    Examples:
        reorient transfer now.npz goal.npz poses.csv --calibration robot.toml --out now.csv
    """

    current: Positional[Path]
    """Depth image of the object as it is now."""
    goal: Positional[Path]
    """Goal that the poses were taught with: a depth image, or a goal of several views."""
    poses: Positional[Path]
    """Taught tool poses."""
    calibration: Annotated[Path, Metavar("PATH")]
    """Pose of the fixed camera: a robot.toml, a calibration of ``reorient calibrate``, or T_base_camera as a 4 x 4
    matrix or a ROS transform."""
    frames: Frames = field(default_factory=Frames)
    estimator: str = "rotation-search"
    """Estimator as of ``reorient estimate``."""
    pivot: Annotated[tuple[float, float, float] | None, Metavar(("X", "Y", "Z"))] = None
    """Rotation centre in camera axes, in metres, where the object only rotated about it."""
    least_confidence: float = 0.9
    """Least confidence of the estimate; 0 accepts any, and an estimator that is not calibrated."""
    out: Path | None = None
    """CSV file for the transferred poses, x,y,z,qw,qx,qy,qz; by default they are printed."""

    def __post_init__(self) -> None:
        """Raises ReorientError for a confidence out of range."""
        check_range(self, "least_confidence", high=1)

    def run(self) -> int:
        """Read, estimate, transfer, write; the exit code."""
        from reorient.estimators import load_estimator
        from reorient.estimators.base import as_estimate
        from reorient.perception.transfer import read_tool_poses, tool_poses_text, transfer, write_tool_poses

        taught, T_base_camera = read_tool_poses(self.poses), _camera_pose(self.calibration)
        estimator = load_estimator(self.estimator)
        current, goal = self.frames.read_pair(self.current, self.goal)
        pivot_m = None if self.pivot is None else np.array(self.pivot)
        with in_one_line("the estimator failed"):
            answer = estimator.estimate(current.isolated, goal.goal, pivot_m)
            estimate = as_estimate(answer, current.isolated, goal.isolated)
        for warning in estimate.warnings:
            print(f"reorient: warning: {warning}", file=sys.stderr)
        if (estimate.confidence or 0.0) < self.least_confidence:
            print(
                f"reorient: confidence {confidence_in_words(estimate.confidence)}, expected at least "
                f"{self.least_confidence:g}: capture the object from another side, or teach a goal of more views "
                "(--least-confidence 0 accepts any)",
                file=sys.stderr,
            )
            return 1
        result = transfer(estimate, T_base_camera, taught)
        out = sys.stderr if self.out is None else sys.stdout
        print(f"confidence    {confidence_in_words(estimate.confidence)}", file=out)
        print(_deviations(result), file=out)
        if self.out is None:
            print(tool_poses_text(result.T_base_tool), end="")
        else:
            write_tool_poses(self.out, result.T_base_tool)
            print(self.out)
        return 0


def _camera_pose(path: Path) -> "Transform":
    """T_base_camera of a robot.toml, a calibration file, or a hand-eye file."""
    from reorient.perception.extrinsics import read_hand_eye
    from reorient.perception.robot_calibration import read_robot_calibration
    from reorient.stations.robot_file import read_robot_file

    if path.suffix.lower() == ".toml":
        return read_robot_file(path).read_calibration().T_base_camera
    try:
        return read_robot_calibration(path).T_base_camera
    except ReorientError:
        return read_hand_eye(path)


def _deviations(result: "Transferred") -> str:
    """The standard deviations in words: of the worst pose."""
    if result.position_std_m is None or result.rotation_std_rad is None:
        return "deviation     not available (the estimator gives no covariance)"
    position_mm, rotation_deg = 1000 * result.position_std_m.max(), np.degrees(result.rotation_std_rad.max())
    return (
        f"deviation     {format_number(position_mm)} mm and {format_number(rotation_deg)} deg at most (standard "
        "deviation of the estimate, without the errors of calibration and arm)"
    )
