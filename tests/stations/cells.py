"""A small simulated cell for tests: the camera's frame is coarse, the object a corner of three arms."""

import numpy as np
import trimesh

from reorient import se3, so3
from reorient.estimators.base import RotationEstimate
from reorient.imaging import Camera
from reorient.perception.robot_calibration import RobotCalibration
from reorient.registration import Evidence
from reorient.stations.guarded import GuardedArm, RobotLimits
from reorient.stations.simulated import SimulatedArm, SimulatedCamera, SimulatedCell
from reorient.world.sensing import Sensor

EVIDENCE = Evidence(1.0, 0.0, 0.0, 0.0, 0.0)
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


class KnowingEstimator:
    """An estimator that knows the cell's true pose at each frame, by the frame's stamp; ``noise_rad``: its error."""

    def __init__(self, cell: SimulatedCell, noise_rad: float = 0.0) -> None:
        self.noise_rad, self.rng, self.poses = noise_rad, np.random.default_rng(1), {}
        frame = cell.frame

        def recorded():
            T = cell.T_camera_object
            image = frame()
            self.poses[image.stamp_s] = T
            return image

        cell.frame = recorded

    def estimate(self, current, goal, pivot_m=None, history=()):
        T = self.motion(current, goal)
        error = so3.exp(self.rng.normal(0, self.noise_rad, 3)) if self.noise_rad else np.eye(3)
        center_m = current.points().mean(axis=0)
        R = error @ T[:3, :3]
        return RotationEstimate(R, se3.apply(T, center_m) - R @ center_m, EVIDENCE)

    def motion(self, current, goal):
        return self.poses[goal.stamp_s] @ se3.inverse(self.poses[current.stamp_s])
