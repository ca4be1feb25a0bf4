"""Dynamics of the arm in MuJoCo: servos that sag under gravity, joints with backlash, encoders, a grasp that can slip.

Each hinge of the arm consists of a motor and a small free play behind it. The encoders are on the motors, so readings
contain neither the play nor the zero errors of the encoders. The true state is for scoring.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import se3
from reorient.se3 import Transform
from reorient.stations.cell.arm import Arm, Part

_PERIOD_S = 0.002
_SPEED_SHARE = 0.5  # peak speed of a move, over the speed limit of the joints
_SETTLE_S = 0.4  # waiting time after a move
_ARMATURE_KG_M2 = 0.1  # of a motor, behind its gear
_RATE_HZ = 12.0  # natural frequency of an undamped servo; with the load it determines the sag
_SERVO_NM_RAD = 4000.0
_HARD = [0.9999, 0.9999, 0.0001, 0.5, 2.0]  # solimp; MuJoCo's default constraints are too soft for a gear or a grip


@dataclass(frozen=True)
class Errors:
    """Errors of the arm's motion."""

    backlash_rad: float = 0.0005
    """Free play of each joint, end to end."""
    encoder_zero_rad: float = 0.0005
    """Standard deviation of the zero errors of the encoders."""
    encoder_noise_rad: float = 0.00005
    """Standard deviation of a reading."""
    slip_nm: float | None = None
    """Torque about the line between the fingertips above which the object slips; None: never."""


@dataclass(frozen=True, eq=False)
class Load:
    """The held object as a mass in the tool frame."""

    mass_kg: float
    center_m: Float[np.ndarray, "3"]
    """Centre of mass relative to the tool centre, tool axes."""
    gyration_m: float
    """Radius of gyration."""


class Drive:
    """An arm at ``joints_rad`` that holds a load, with each finger ``fingers_m`` from closed."""

    def __init__(
        self,
        arm: Arm,
        joints_rad: Float[np.ndarray, " n"],
        fingers_m: float,
        load: Load | None,
        errors: Errors,
        zero_rad: Float[np.ndarray, " n"],
        rng: Generator,
    ) -> None:
        """``zero_rad``: reading of each encoder when its motor is at 0."""
        self.arm, self.errors, self._zero_rad, self._rng = arm, errors, zero_rad, rng
        self.fingers_m = fingers_m
        self.model = _with_errors(arm, load, errors)
        self.data = mujoco.MjData(self.model)
        names = [arm.model.joint(j).name for j in arm.joints]
        self._motor = np.array([self.model.joint(name).qposadr[0] for name in names])
        plays = [f"{name} play" for name in names] if errors.backlash_rad > 0 else []
        self._play = np.array([self.model.joint(name).qposadr[0] for name in plays], int)
        self._tcp = self.model.site("tcp").id
        self._held = self.model.site("held").id
        self._target = np.array(joints_rad, float)
        self.data.qpos[self._motor] = joints_rad - self._zero_rad
        for finger in arm.fingers:
            self.data.qpos[self.model.joint(arm.model.joint(finger).name).qposadr[0]] = fingers_m
        self._run(self._target, _SETTLE_S)

    def move(self, joints_rad: Float[np.ndarray, " n"]) -> None:
        """Drive the encoders to these positions within the joints' speeds, as well as the servos can; then settle."""
        way = joints_rad - self._target
        duration_s = float(np.max(np.abs(way) * np.pi / 2 / (self.arm.speed_rad_s * _SPEED_SHARE)))
        begin = self._target.copy()
        for t in np.arange(_PERIOD_S, duration_s, _PERIOD_S):
            self._run(begin + way * (1 - np.cos(np.pi * t / duration_s)) / 2, _PERIOD_S)
        self._target = np.array(joints_rad, float)
        self._run(self._target, _SETTLE_S)

    def wait(self, seconds: float) -> None:
        """Hold the present target."""
        self._run(self._target, seconds)

    def read(self) -> Float[np.ndarray, " n"]:
        """Joint positions from the encoders."""
        noise = self.errors.encoder_noise_rad * self._rng.standard_normal(len(self._motor))
        return np.asarray(self.data.qpos[self._motor] + self._zero_rad + noise)

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self.data.time)

    def true_joints(self) -> Float[np.ndarray, " n"]:
        """True joint positions, for scoring."""
        joints_rad = self.data.qpos[self._motor]
        return np.asarray(joints_rad + self.data.qpos[self._play] if len(self._play) else joints_rad)

    def true_tcp(self) -> Transform:
        """True T_world_tcp, for scoring and for the cameras."""
        return self._site(self._tcp)

    def true_held(self) -> Transform:
        """T_world_held, the tool frame that moves with the held object: ``true_tcp`` plus the slip."""
        return self._site(self._held)

    def true_parts(self) -> list[Part]:
        """The parts of the cell at their true poses, without the object."""
        mujoco.mj_fwdPosition(self.model, self.data)
        return self.arm.posed(self.data)

    def _site(self, site: int) -> Transform:
        mujoco.mj_fwdPosition(self.model, self.data)
        return se3.transform(self.data.site_xmat[site].reshape(3, 3), self.data.site_xpos[site])

    def _run(self, target_rad: Float[np.ndarray, " n"], seconds: float) -> None:
        self.data.ctrl[: len(self._motor)] = target_rad - self._zero_rad
        self.data.ctrl[len(self._motor) :] = self.fingers_m
        mujoco.mj_step(self.model, self.data, max(1, round(seconds / _PERIOD_S)))


def _with_errors(arm: Arm, load: Load | None, errors: Errors) -> mujoco.MjModel:
    """The arm's model with a servo and a free play for each hinge, and the held object."""
    spec = mujoco.MjSpec.from_file(str(arm.mjcf))
    for old in [*spec.actuators, *spec.keys]:
        spec.delete(old)
    spec.option.timestep = _PERIOD_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT  # Arm.solve returns collision-free paths
    half = errors.backlash_rad / 2
    for index in arm.joints:
        joint = spec.joint(arm.model.joint(index).name)
        joint.armature = _ARMATURE_KG_M2
        if half == 0:
            continue
        play = joint.parent.add_joint(
            name=f"{joint.name} play", type=joint.type, axis=joint.axis, pos=joint.pos, range=[-half, half]
        )
        play.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        play.damping = [1.0, 0.0, 0.0]
        play.solref_limit, play.solimp_limit = [0.006, 1.0], _HARD
    for index in [*arm.joints, *arm.fingers]:
        name = arm.model.joint(index).name
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=_SERVO_NM_RAD, kv=2 * _SERVO_NM_RAD / (2 * np.pi * _RATE_HZ))
    tcp = spec.site("tcp")
    held = tcp.parent.add_body(name="held", pos=tcp.pos, quat=tcp.quat)
    held.add_site(name="held")
    held.explicitinertial = True
    held.mass, held.inertia = 1e-6, np.full(3, 1e-9)
    if load is not None:
        held.mass, held.ipos = load.mass_kg, load.center_m
        held.inertia = np.full(3, load.mass_kg * load.gyration_m**2)
        if errors.slip_nm is not None:
            slip = held.add_joint(name="slip", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
            slip.frictionloss, slip.solimp_friction = errors.slip_nm, _HARD
    return spec.compile()
