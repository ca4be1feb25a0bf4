"""A simulated Franka cell behind the interfaces of a real one, for demonstrations and tests.

The arm is franky-sim: libfranka's protocol on the dynamics of MuJoCo. The camera ray-casts the held object over a
table, and writes its frames to a folder. Each is a process of its own; the camera learns the pose of the hand alone.
Run it with ``python -m reorient.stations.franka_cell FOLDER``, and use FOLDER/robot.toml meanwhile.
"""

import multiprocessing
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import StationError
from reorient.extras import import_extra
from reorient.imaging import Camera, DepthImage
from reorient.imaging.files import write_depth
from reorient.runs.files import make_folder
from reorient.se3 import Transform
from reorient.stations.simulated import HOME_M, SimulatedCell
from reorient.world.objects import generated

FRAME_S = 0.25  # between two frames
_KEPT = 20  # frames in the folder
_STEPS = 10  # milliseconds of simulation between two poses that the camera learns
_CAMERA = Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
_RADIUS_M = 0.08  # of the object's bounding sphere
_T_HAND_TOOL = se3.transform(np.eye(3), np.array([0.0, 0.0, 0.1034]))  # between the fingertips, as Franka's hand has it
_T_HOME = se3.transform(np.diag([1.0, -1.0, -1.0]), np.array([0.554, 0.0, 0.521]))  # of the tool
_HELD_M = (0.0, 0.0, 0.05)  # the object's centre in tool axes: beyond the fingertips
_READY_S = 60.0


class FrankaCell:
    """The running cell. Its truth is MuJoCo's. Use it in a ``with`` statement."""

    def __init__(self, folder: str | Path, seed: int = 0) -> None:
        """Start the processes and write ``robot.toml``. ``seed``: draws the object, its grasp and the camera's pose.

        Raises ReorientError where franky-sim is missing, StationError where a process does not start.
        """
        import_extra("franky_sim")
        self.folder = make_folder(folder)
        self._scene = scene(seed)
        context = multiprocessing.get_context("spawn")
        self._hand = context.Array("d", 16)
        ours, theirs = context.Pipe()
        frames = make_folder(self.folder / "frames")
        self.arm = context.Process(target=_run_arm, args=(self._hand, theirs), daemon=True)
        self.camera = context.Process(target=_run_camera, args=(self._hand, str(frames), seed), daemon=True)
        self.arm.start()
        if not ours.poll(_READY_S):
            self.close()
            raise StationError(f"franky-sim did not start within {_READY_S:g} s")
        self.address: str = ours.recv()
        self.camera.start()
        self.robot_file = self.folder / "robot.toml"
        self.robot_file.write_text(self._robot_toml(frames), encoding="utf-8")

    @property
    def T_camera_object(self) -> Transform:
        """The true pose of the object, now."""
        self._scene.T_base_tool = _tool(self._hand)
        return self._scene.T_camera_object

    @property
    def T_base_camera(self) -> Transform:
        """The camera's true pose."""
        return self._scene.T_base_camera

    def close(self) -> None:
        """End the processes."""
        for process in (self.camera, self.arm):
            if process.pid is not None:
                process.kill()
                process.join()

    def __enter__(self) -> "FrankaCell":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _robot_toml(self, frames: Path) -> str:
        x, y, z = self.T_camera_object[:3, 3]
        return f"""calibration = "calibration.json"

[camera]
driver = "folder"
frames = "{frames.resolve()}"
host_clock = true
timeout_s = 20.0

[arm]
driver = "franka"
address = "{self.address}"
realtime = false            # a simulation
speed_m_s = 0.2
speed_deg_s = 60.0
acceleration_m_s2 = 1.0
acceleration_deg_s2 = 200.0
timeout_s = 60.0            # the simulation may be slower than real time

[tool]
point_m = [{", ".join(map(str, _HELD_M))}]

[isolation]
around_m = [{x:.2f}, {y:.2f}, {z:.2f}]
radius_m = 0.15

[limits]
box_low_m = [0.2, -0.5, 0.15]
box_high_m = [0.8, 0.5, 0.9]
settle_s = 0.5
"""


def scene(seed: int) -> SimulatedCell:
    """The object, its grasp and the camera of a number, with the tool in Franka's home pose."""
    rng = np.random.default_rng(seed)
    objects = generated(seed + 1)
    cell = SimulatedCell(objects.load(objects.names[seed]), rng, radius_m=_RADIUS_M, table=True)
    cell.camera = _CAMERA
    cell.T_tool_object = se3.transform(so3.sample_uniform(rng, 1)[0], np.array(_HELD_M))
    cell.T_base_tool = _T_HOME
    cell.T_base_camera = se3.transform(np.eye(3), se3.apply(_T_HOME, np.array(_HELD_M)) - HOME_M) @ cell.T_base_camera
    return cell


def _tool(hand: Any) -> Transform:
    """T_base_tool of the shared pose of the hand."""
    with hand.get_lock():
        T_base_hand = np.array(hand[:]).reshape(4, 4)
    return np.asarray(T_base_hand @ _T_HAND_TOOL)


def _run_arm(hand: Any, ready: Connection) -> None:
    """The process of the arm: steps the simulation, and shares the pose of the hand."""
    simulators = import_extra("franky_sim.mujoco_simulator")
    servers = import_extra("franky_sim")
    with simulators.MujocoSimulator(enable_visualization=False) as simulator:
        robot = simulator.add_robot()
        with servers.SimulationServer(simulator) as server:
            step = 0
            while True:
                server.run_once()
                if step % _STEPS == 0:
                    body = simulator.data.body("robot0_hand")
                    with hand.get_lock():
                        hand[:] = se3.transform(body.xmat.reshape(3, 3), body.xpos).ravel()
                if step == 0:
                    ready.send(robot.hostname)
                step += 1


def _run_camera(hand: Any, folder: str, seed: int) -> None:
    """The process of the camera: renders the object, and writes numbered frames, stamped with the host's clock."""
    cell = scene(seed)
    frames = Path(folder)
    number = 0
    while True:
        stamp_s = time.time()
        cell.T_base_tool = _tool(hand)
        image = cell.frame()
        write_depth(frames / f"{number:06d}.npz", DepthImage(image.depth_m, image.camera, stamp_s, image.unknown))
        (frames / f"{number - _KEPT:06d}.npz").unlink(missing_ok=True)
        number += 1
        time.sleep(max(0.0, FRAME_S - (time.time() - stamp_s)))


if __name__ == "__main__":
    with FrankaCell(sys.argv[1] if len(sys.argv) > 1 else "out/robot") as running:
        print(running.robot_file, flush=True)
        while running.arm.is_alive():
            time.sleep(0.2)
