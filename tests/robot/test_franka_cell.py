"""The whole loop on the simulated Franka cell, by the command line: real drivers, MuJoCo's truth."""

import json
import subprocess
import sys
import time

import motions
import numpy as np
import pytest

from reorient import se3, so3
from reorient.cli import main
from reorient.imaging.averaging import mean_image
from reorient.imaging.files import write_depth
from reorient.perception.robot_calibration import RobotCalibration, write_robot_calibration
from reorient.stations.arms.supervised import apart
from reorient.stations.franka_cell import FrankaCell, scene
from reorient.stations.robot import around_pivot
from reorient.stations.robot_file import read_robot_file

SEED = 2


@pytest.fixture
def cell(tmp_path):
    with FrankaCell(tmp_path, SEED) as running:
        yield running


def calibrated(cell: FrankaCell) -> None:
    """Write the true calibration."""
    place_m = scene(SEED).T_tool_object[:3, 3]
    write_robot_calibration(cell.folder / "calibration.json", RobotCalibration(cell.T_base_camera, place_m))


def teach(cell: FrankaCell, rotvec_deg: tuple[float, ...]) -> tuple[str, np.ndarray]:
    """A goal image of the object, rotated about its centre (camera axes) from its present pose; and that pose."""
    view = scene(SEED)
    start = cell.T_camera_object
    goal = se3.transform(so3.exp(np.radians(rotvec_deg)) @ start[:3, :3], start[:3, 3])
    view.T_base_tool = view.T_base_camera @ goal @ se3.inverse(view.T_tool_object)
    isolation = read_robot_file(cell.robot_file).isolation
    path = cell.folder / "goal.npz"
    isolated = around_pivot(isolation, goal[:3, 3])
    write_depth(path, mean_image([isolated(view.frame()) for _ in range(5)]))  # as `reorient capture` does
    return str(path), goal


def orient(cell: FrankaCell, goal: str) -> list[str]:
    return ["orient", goal, "--station", str(cell.robot_file), "--record", str(cell.folder / "record"), "--yes"]


def status(cell: FrankaCell) -> str:
    return json.loads((cell.folder / "record" / "record.json").read_text())["status"]


def test_the_loop_ends_at_the_goal(cell):
    goal, T_goal = teach(cell, (30.0, -30.0, 20.0))
    calibrated(cell)
    assert apart(cell.T_camera_object, T_goal)[1] > 40
    assert not main(orient(cell, goal))
    assert apart(cell.T_camera_object, T_goal)[1] < 1.0
    assert status(cell) == "converged"


@pytest.mark.parametrize("device", ["arm", "camera"])
def test_a_device_that_is_killed_in_a_move(cell, device):
    """The loop ends in one line, with a readable record."""
    goal, _ = teach(cell, (30.0, -30.0, 20.0))
    calibrated(cell)
    robot = cell.robot_file.read_text()
    cell.robot_file.write_text(robot.replace("timeout_s = 20.0", "timeout_s = 3.0"))
    motions.once_moving(lambda: cell.T_camera_object, getattr(cell, device).kill)
    run = subprocess.run([sys.executable, "-m", "reorient", *orient(cell, goal)], capture_output=True, text=True)
    assert run.returncode == 1
    (message,) = run.stderr.splitlines()
    assert "station_failed" in message
    assert ("connection to the Franka" if device == "arm" else "no new frame in") in message
    assert status(cell) == "station_failed"


def test_a_loop_that_is_killed_leaves_an_arm_at_rest(cell):
    goal, T_goal = teach(cell, (30.0, -30.0, 20.0))
    calibrated(cell)
    start = cell.T_camera_object
    loop = subprocess.Popen([sys.executable, "-m", "reorient", *orient(cell, goal)])
    while apart(cell.T_camera_object, start)[1] < 5:
        assert loop.poll() is None
        time.sleep(0.02)
    loop.kill()
    loop.wait()
    time.sleep(2)
    T = cell.T_camera_object
    time.sleep(0.5)
    assert motions.close(cell.T_camera_object, T, 1e-4, 0.05)
    assert apart(T, T_goal)[1] > 5
    assert "acts" in json.loads((cell.folder / "record" / "record.json").read_text())
