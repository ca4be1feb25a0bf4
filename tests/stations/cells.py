"""A small simulated cell for tests: the camera's frame is coarse, the object a corner of three arms."""

import numpy as np
import trimesh

from reorient.imaging import Camera
from reorient.perception.robot_calibration import RobotCalibration
from reorient.stations.guarded import GuardedArm, RobotLimits
from reorient.stations.simulated import SimulatedArm, SimulatedCamera, SimulatedCell
from reorient.world.sensing import Sensor

AT_ONCE = RobotLimits(settle_s=0.0)


def corner() -> trimesh.Trimesh:
    ends = ((1.0, 0.2, 0.2), (0.2, 0.7, 0.2), (0.2, 0.1, 0.5))
    arms = [trimesh.creation.box(bounds=[(-0.2, -0.2, -0.2), end]) for end in ends]
    return trimesh.boolean.union(arms, engine="manifold")


def small_cell(seed: int = 0, mesh: trimesh.Trimesh | None = None, noise_m: float = 0.0) -> SimulatedCell:
    cell = SimulatedCell(mesh or corner(), np.random.default_rng(seed), Sensor(noise_m=noise_m))
    cell.camera = Camera(160, 120, 165.0, 165.0, 80.0, 60.0)
    return cell


def true_calibration(cell: SimulatedCell) -> RobotCalibration:
    return RobotCalibration(cell.T_base_camera, cell.T_tool_object[:3, 3])


def drivers(cell: SimulatedCell, limits: RobotLimits = AT_ONCE) -> tuple[SimulatedCamera, GuardedArm]:
    return SimulatedCamera(cell), GuardedArm(SimulatedArm(cell), limits)
