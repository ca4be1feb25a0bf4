"""The verbs that set a robot cell up: new-robot, calibrate, check."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from reorient.cli.arguments import Positional
from reorient.cli.robot import confirmed
from reorient.errors import ReorientError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from reorient.estimators.base import Estimator
    from reorient.perception.robot_calibration import RobotCalibration
    from reorient.stations.calibrating import View
    from reorient.stations.guarded import GuardedArm

_LARGE = "rotate by up to 35 deg about the tool point, 8 times"
_SMALL = "rotate by 5 deg about three axes, either way, and move by 4 cm along them"


@dataclass(frozen=True)
class NewRobot:
    """Write a commented robot.toml to fill in.

    Examples:
        reorient new-robot robot.toml
    """

    out: Positional[Path] = Path("robot.toml")
    """File to write; an existing one is kept."""

    def run(self) -> None:
        """Write it."""
        from reorient.stations.robot_file import TEMPLATE

        try:
            with self.out.open("x", encoding="utf-8") as file:
                file.write(TEMPLATE)
        except FileExistsError as error:
            raise ReorientError(f"{str(self.out)!r} exists: expected the name of a new file") from error
        print(self.out)


@dataclass(frozen=True)
class Calibrate:
    """Find the camera's pose and the pivot by rotating the held object.

    No calibration board is needed. The arm rotates the tool by up to 35 degrees, 8 times, about the tool point of
    robot.toml, and returns; it needs an object without symmetry in the gripper, in view of the camera. The plan is
    printed and must be confirmed (--yes does not ask).

    Examples:
        reorient calibrate robot.toml
        reorient calibrate robot.toml --hand-eye easy_handeye.yaml
    """

    robot: Positional[Path]
    """File that ``reorient new-robot`` wrote."""
    hand_eye: Path | None = None
    """Known result to use instead: 4 x 4 matrix, ROS transform, easy_handeye YAML, or OpenCV. Small motions decide
    whether it is T_base_camera or its inverse."""
    estimator: str = "default"
    """Estimator of the rotations, as of ``reorient orient``."""
    yes: bool = False
    """Move without asking."""

    def run(self) -> int:
        """Calibrate, print the result with its standard errors, and write it; the exit code."""
        from reorient.estimators import load_estimator
        from reorient.perception.extrinsics import read_hand_eye
        from reorient.perception.robot_calibration import RobotCalibration, write_robot_calibration
        from reorient.stations.calibrating import calibrate
        from reorient.stations.checking import observe
        from reorient.stations.guarded import FreshFrames
        from reorient.stations.robot_file import read_robot_file

        robot, estimator = read_robot_file(self.robot), load_estimator(self.estimator)
        known = None if self.hand_eye is None else RobotCalibration(read_hand_eye(self.hand_eye), robot.point_m)
        camera, arm = robot.open_camera(), robot.open_arm()
        if not (self.yes or _confirmed(arm, _LARGE if known is None else _SMALL)):
            return 1
        if known is None:
            found = calibrate(camera, arm, robot.isolation, estimator, robot.point_m)
            _print(found)
        else:
            views = observe(FreshFrames(camera, robot.isolation), arm, known)
            found = _in_its_direction(views, known, estimator, str(self.hand_eye))
        write_robot_calibration(robot.calibration, found)
        print(robot.calibration)
        return 0


@dataclass(frozen=True)
class Check:
    """Check a robot cell by small motions, and name a mistake in words.

    The arm rotates the tool by 5 degrees about three axes, either way, moves it by 4 cm along them, and returns. The
    plan is printed and must be confirmed (--yes does not ask). The exit code is 0 where the cell is right, and 1 where
    it is not.

    Examples:
        reorient check robot.toml
    """

    robot: Positional[Path]
    """File that ``reorient new-robot`` wrote."""
    estimator: str = "fast"
    """Estimator of the rotations, as of ``reorient orient``."""
    yes: bool = False
    """Move without asking."""

    def run(self) -> int:
        """Check and print; the exit code."""
        from reorient.estimators import load_estimator
        from reorient.stations.checking import check
        from reorient.stations.robot_file import read_robot_file

        robot, estimator = read_robot_file(self.robot), load_estimator(self.estimator)
        calibration = robot.read_calibration()
        camera, arm = robot.open_camera(), robot.open_arm(calibration.p_tool_object_m)
        if not (self.yes or _confirmed(arm, _SMALL)):
            return 1
        result = check(camera, arm, calibration, robot.isolation, estimator)
        if result.rotation_deg is not None and result.position_m is not None:
            print(
                f"camera and arm differ by {result.rotation_deg:.2f} deg and {1000 * result.position_m:.1f} mm (RMS "
                "over the motions)"
            )
        print(f"{'passed' if result.passed else 'failed'}: {result.message}")
        return 0 if result.passed else 1


def _confirmed(arm: "GuardedArm", motions: str) -> bool:
    """Ask at the terminal for the motions of a verb."""
    x, y, z = arm.pose()[:3, 3]
    if confirmed(f"the tool at ({x:.3f}, {y:.3f}, {z:.3f}) m will {motions}, and return", "make these moves?"):
        return True
    print("reorient: not confirmed, nothing was moved", file=sys.stderr)
    return False


def _in_its_direction(
    views: "Sequence[View]", known: "RobotCalibration", estimator: "Estimator", source: str
) -> "RobotCalibration":
    """A known calibration in the direction that the motions confirm. Raises ReorientError where neither is."""
    from reorient import se3
    from reorient.stations.checking import diagnose

    result = diagnose(views, known, estimator)
    if result.mistake == "inverse extrinsics":
        known = replace(known, T_base_camera=se3.inverse(known.T_base_camera))
        result = diagnose(views, known, estimator)
        print(f"{source} holds T_camera_base, by the motions of the object: inverted")
    if not result.passed:
        raise ReorientError(f"the motions of the object contradict {source!r}: {result.message}")
    print(f"the motions of the object confirm {source}: {result.message}")
    return known


def _print(found: "RobotCalibration") -> None:
    x, y, z = found.T_base_camera[:3, 3]
    u, v, w = 1000 * found.p_tool_object_m
    se_mm = 1000 * (found.pivot_se_m or 0.0)
    print(
        f"motions used          {found.motions} of {found.motions_tried}, residual {found.residual_deg:.2f} deg (RMS)"
    )
    print(f"camera in base axes   ({x:.3f}, {y:.3f}, {z:.3f}) m, rotation +- {found.rotation_se_deg:.2f} deg")
    print(f"object in tool axes   ({u:.0f}, {v:.0f}, {w:.0f}) mm; rotation centre in camera axes +- {se_mm:.1f} mm")
    if np.linalg.norm(found.p_tool_object_m) > 0.3:
        print("the object is more than 30 cm from the tool's origin: is the tool point of the arm set?")
