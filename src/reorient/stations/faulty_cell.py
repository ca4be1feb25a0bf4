"""A simulated cell with one of the usual mistakes of a new robot cell: for tests of ``reorient check``."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import se3, so3
from reorient.imaging import Camera, DepthImage
from reorient.perception.robot_calibration import RobotCalibration
from reorient.se3 import Transform
from reorient.stations.drivers import ArmDriver, CameraDriver
from reorient.stations.mistakes import axis_swaps
from reorient.stations.simulated import SimulatedArm, SimulatedCamera, SimulatedCell

Drivers = tuple[CameraDriver, ArmDriver, RobotCalibration]
_PER_RADIAN = float(np.degrees(1.0))


class MistakenArm:
    """An arm whose stated poses are not the true ones."""

    def __init__(
        self, cell: SimulatedCell, stated: Callable[[Transform], Transform], true: Callable[[Transform], Transform]
    ) -> None:
        """``stated``: from true to stated poses; ``true``: its inverse."""
        self._arm, self._true = SimulatedArm(cell), true
        self._stated = stated(cell.T_base_tool)

    def pose(self) -> Transform:
        """The stated pose."""
        return self._stated

    def move_to(self, T_base_tool: Transform) -> Transform:
        """Move to a stated pose, and thus somewhere else."""
        self._arm.cell.T_base_tool = self._true(T_base_tool)
        self._stated = np.array(T_base_tool)
        return self._stated

    def stop(self) -> None:
        """Nothing to do."""


class MistakenCamera:
    """A camera whose frames are changed."""

    def __init__(self, camera: SimulatedCamera, changed: Callable[[DepthImage], DepthImage]) -> None:
        self._camera, self._changed = camera, changed

    def capture(self) -> DepthImage:
        """The next frame, changed."""
        return self._changed(self._camera.capture())


def planted(mistake: str, cell: SimulatedCell, calibration: RobotCalibration) -> Drivers:
    """Drivers and calibration with a mistake of that kind, drawn by the cell's generator; "": without any."""
    drivers = SimulatedCamera(cell), SimulatedArm(cell), calibration
    return drivers if not mistake else PLANTED[mistake](cell, *drivers)


def _swapped(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    swaps = axis_swaps()
    P = se3.transform(swaps[cell.rng.integers(len(swaps))], np.zeros(3))
    T = calibration.T_base_camera @ P if cell.rng.random() < 0.7 else P @ calibration.T_base_camera
    return camera, arm, replace(calibration, T_base_camera=T)


def _sign(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    first = cell.T_base_tool[:3, :3]
    if cell.rng.random() < 0.5:
        return camera, _rotated(cell, lambda R: (R @ first.T).T @ first), calibration
    return camera, _rotated(cell, lambda R: R.T), calibration


def _degrees(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    first, kind = cell.T_base_tool[:3, :3], cell.rng.integers(4)
    factor = _PER_RADIAN if kind % 2 else 1 / _PER_RADIAN
    if kind < 2:
        return (
            camera,
            _rotated(
                cell,
                lambda R: so3.exp(so3.log(R @ first.T) / factor) @ first,
                lambda R: so3.exp(so3.log(R @ first.T) * factor) @ first,
            ),
            calibration,
        )
    if factor < 1:  # then the arm is within 3 degrees of no rotation
        small = so3.exp(so3.log(first) * factor)
        cell.T_base_tool = _about_object(cell, small @ first.T) @ cell.T_base_tool
    return (
        camera,
        _rotated(cell, lambda R: so3.exp(so3.log(R) / factor), lambda R: so3.exp(so3.log(R) * factor)),
        calibration,
    )


def _millimetres(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    kind = cell.rng.integers(3)
    if kind == 0:
        scaled = [partial(_scaled_position, factor=factor) for factor in (1000.0, 0.001)]
        return camera, MistakenArm(cell, *scaled), calibration
    if kind == 1:
        p_m = calibration.p_tool_object_m  # 10 mm read as 10 m; above 20 m the calibration itself is refused
        return camera, arm, replace(calibration, p_tool_object_m=10 * p_m / np.linalg.norm(p_m))
    T = calibration.T_base_camera
    return camera, arm, replace(calibration, T_base_camera=se3.transform(T[:3, :3], T[:3, 3] / 1000))


def _flange(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    spin = so3.exp(np.array([0, 0, cell.rng.choice([0.0, np.pi / 4, np.pi / 2])]))
    F = se3.transform(spin, np.array([0, 0, cell.rng.uniform(0.1, 0.2)]))
    return camera, MistakenArm(cell, lambda T: T @ se3.inverse(F), lambda T: T @ F), calibration


def _quaternion(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    orders = [(3, 0, 1, 2), (1, 2, 3, 0)]
    one, other = orders if cell.rng.random() < 0.5 else orders[::-1]
    if cell.rng.random() < 0.7:
        return camera, _rotated(cell, partial(_reordered, order=one), partial(_reordered, order=other)), calibration
    T = calibration.T_base_camera
    return camera, arm, replace(calibration, T_base_camera=se3.transform(_reordered(T[:3, :3], one), T[:3, 3]))


def _inverse(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    return camera, arm, replace(calibration, T_base_camera=se3.inverse(calibration.T_base_camera))


def _stale(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    kind, known = cell.rng.integers(3), [camera.capture()]

    def late(image: DepthImage) -> DepthImage:  # the frame before, with the time of reading
        known.append(image)
        return replace(known[-2], stamp_s=image.stamp_s)

    changes = [late, lambda image: replace(known[0], stamp_s=image.stamp_s), lambda image: known[0]]
    return MistakenCamera(SimulatedCamera(cell), changes[kind]), arm, calibration


def _mirrored(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    rows, columns = [(1, -1), (-1, 1)][cell.rng.integers(2)]

    def flip(image: DepthImage) -> DepthImage:
        unknown = image.unknown[::rows, ::columns]
        return replace(image, depth_m=image.depth_m[::rows, ::columns], unknown=unknown)

    return MistakenCamera(SimulatedCamera(cell), flip), arm, calibration


def _intrinsics(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    factor = [1.1, 1 / 1.1][cell.rng.integers(2)]

    def with_focal_length(image: DepthImage) -> DepthImage:
        c: Camera = image.camera
        return replace(image, camera=replace(c, fx=c.fx * factor, fy=c.fy * factor))

    return MistakenCamera(SimulatedCamera(cell), with_focal_length), arm, calibration


def _camera_moved(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    axis, direction = so3.sample_axes(cell.rng, 2)
    R = so3.exp(axis * np.radians(cell.rng.uniform(5, 10)))
    T = calibration.T_base_camera
    moved = se3.transform(R @ T[:3, :3], T[:3, 3] + direction * cell.rng.uniform(0.02, 0.05))
    return camera, arm, replace(calibration, T_base_camera=moved)


def _nothing(cell: SimulatedCell, camera: CameraDriver, arm: ArmDriver, calibration: RobotCalibration) -> Drivers:
    if cell.rng.random() < 0.5:  # out of view
        cell.T_tool_object = se3.transform(np.eye(3), np.array([0, 0, 5.0])) @ cell.T_tool_object
        return camera, arm, calibration
    held = cell.T_base_tool @ cell.T_tool_object  # left where it was, on a stand
    return camera, _LeavingArm(cell, held), calibration


class _LeavingArm(SimulatedArm):
    """An arm that leaves the object where it is."""

    def __init__(self, cell: SimulatedCell, T_base_object: Transform) -> None:
        super().__init__(cell)
        self._T_base_object = T_base_object

    def move_to(self, T_base_tool: Transform) -> Transform:
        """Move without the object."""
        reached = super().move_to(T_base_tool)
        self.cell.T_tool_object = se3.inverse(reached) @ self._T_base_object
        return reached


PLANTED = {
    "axes swapped": _swapped,
    "sign": _sign,
    "degrees for radians": _degrees,
    "mm for m": _millimetres,
    "flange for tool": _flange,
    "quaternion order": _quaternion,
    "inverse extrinsics": _inverse,
    "stale frames": _stale,
    "mirrored image": _mirrored,
    "wrong intrinsics": _intrinsics,
    "camera moved": _camera_moved,
    "nothing held": _nothing,
}


def _rotated(
    cell: SimulatedCell,
    stated: Callable[[Float[np.ndarray, "3 3"]], Float[np.ndarray, "3 3"]],
    true: Callable[[Float[np.ndarray, "3 3"]], Float[np.ndarray, "3 3"]] | None = None,
) -> MistakenArm:
    """An arm whose rotations are changed; ``true`` None: the change is its own inverse."""
    return MistakenArm(
        cell,
        lambda T: se3.transform(stated(T[:3, :3]), T[:3, 3]),
        lambda T: se3.transform((true or stated)(T[:3, :3]), T[:3, 3]),
    )


def _scaled_position(T: Transform, factor: float) -> Transform:
    return se3.transform(T[:3, :3], T[:3, 3] * factor)


def _reordered(R: Float[np.ndarray, "3 3"], order: tuple[int, ...]) -> Float[np.ndarray, "3 3"]:
    return so3.matrix_from_quat(so3.quat_from_matrix(R)[list(order)])


def _about_object(cell: SimulatedCell, R: Float[np.ndarray, "3 3"]) -> Transform:
    center_m = se3.apply(cell.T_base_tool, cell.T_tool_object[:3, 3])
    return se3.transform(R, center_m - R @ center_m)


def random_calibration(cell: SimulatedCell, rng: Generator) -> RobotCalibration:
    """The cell's true calibration with the errors of a measured one: 0.3 degrees and 2 mm, and 1 cm of the place."""
    angle, shift, place = so3.sample_axes(rng, 3) * np.array([[np.radians(0.3)], [0.002], [0.01]])
    center_m = cell.T_base_tool[:3, :3] @ cell.T_tool_object[:3, 3] + cell.T_base_tool[:3, 3]
    R = so3.exp(angle)
    T = se3.transform(R, center_m - R @ center_m + shift) @ cell.T_base_camera
    return RobotCalibration(T, cell.T_tool_object[:3, 3] + place)
