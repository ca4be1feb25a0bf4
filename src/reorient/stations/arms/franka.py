"""Franka Research 3 and Panda through the Franka Control Interface (franky-control)."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from reorient.errors import StationError
from reorient.extras import import_extra
from reorient.se3 import Transform
from reorient.stations.arms.reach import follows, joint_limits
from reorient.stations.arms.supervised import StraightPath, SupervisedArm, connected, one_line

_JERK_PER_ACCELERATION = 20.0  # 1 / s: full acceleration after 50 ms, smooth for a grasped object. Not tuned


@dataclass(kw_only=True, eq=False)
class FrankaArm(SupervisedArm):
    """A Franka arm. The tool is the end effector frame that Desk configures (O_T_EE), the base is frame O.

    The motion is franky's Cartesian motion within the limits of this class. The controller accepts one client. It
    stops the arm by itself where this program ends or the connection breaks.
    """

    address: str
    """Host name or IP address of the controller."""
    realtime: bool = True
    """Whether a real-time kernel is demanded, as Franka does; False in simulation and for trials."""

    def __post_init__(self) -> None:
        """Raises StationError where the controller cannot be reached, or is not ready to move."""
        super().__post_init__()
        self._franky: Any = import_extra("franky")
        config = self._franky.RealtimeConfig
        self._robot: Any = connected(
            lambda: self._franky.Robot(
                self.address, realtime_config=config.Enforce if self.realtime else config.Ignore
            ),
            self.timeout_s,
            f"a Franka controller at {self.address} with FCI active and no other client, and a real-time kernel unless "
            "realtime = false",
        )
        for kind, speed, acceleration in (
            ("translation", self.speed_m_s, self.acceleration_m_s2),
            ("rotation", np.radians(self.speed_deg_s), np.radians(self.acceleration_deg_s2)),
        ):
            getattr(self._robot, f"{kind}_velocity_limit").set(speed)
            getattr(self._robot, f"{kind}_acceleration_limit").set(acceleration)
            getattr(self._robot, f"{kind}_jerk_limit").set(_JERK_PER_ACCELERATION * acceleration)
        self._joint_limits = joint_limits(self._robot.model_urdf, 7)
        self.pose()

    def pose(self) -> Transform:
        """The measured pose, T_base_tool. Raises StationError as the class describes."""
        state = self._asked(lambda: self._robot.state)
        if self._asked(lambda: self._robot.has_errors):
            raise StationError(f"the controller of {self.address} stopped the arm: {state.current_errors}")
        mode = state.robot_mode.name
        if mode not in ("Idle", "Move"):
            raise StationError(
                f"the Franka at {self.address} is in mode {mode}: expected Idle (release the user stop, unlock the "
                "joints, activate FCI)"
            )
        # By the measured joints: O_T_EE says the same on an arm, but is the desired pose in franky-sim 1.0.4.
        return self._pose_of(state, state.q)

    def reachable(self, T_base_tool: Transform) -> bool:
        """Whether the joints could follow the straight line to a pose within their limits."""
        state = self._asked(lambda: self._robot.state)
        frame, model = self._franky.Frame.EndEffector, self._robot.model
        return follows(
            self.path(self._pose_of(state, state.q), T_base_tool),
            np.array(state.q, float),
            self._joint_limits,
            lambda q: self._pose_of(state, q),
            lambda q: np.array(model.zero_jacobian(frame, q, state.F_T_EE, state.EE_T_K), float),
        )

    def _pose_of(self, state: Any, q: Any) -> Transform:
        """T_base_tool of joint angles, with the end effector of a state."""
        frame = self._franky.Frame.EndEffector
        return np.array(self._robot.model.pose(frame, q, state.F_T_EE, state.EE_T_K).matrix, float)

    def stop(self) -> None:
        """Stop the motion. The controller brakes the arm."""
        with suppress(self._franky.ControlException):  # the one that ends the preempted motion
            self._robot.stop()
            self._robot.join_motion(self.timeout_s)

    def close(self) -> None:
        """Disconnect: the controller accepts another client."""
        self._robot = None

    def _begin(self, path: StraightPath) -> None:
        motion = self._franky.CartesianMotion(self._franky.Affine(path.T_end))
        self._asked(lambda: self._robot.move(motion, asynchronous=True))

    def _executing(self) -> bool:
        executing = bool(self._robot.is_in_control)  # first: the motion may end between the two calls
        self._asked(self._robot.poll_motion)  # raises what ended the motion
        return executing

    def _asked(self, call: Any) -> Any:
        """The result of a call of franky. Its errors become StationError."""
        try:
            return call()
        except (self._franky.ControlException, self._franky.CommandException) as error:
            raise StationError(f"the controller of {self.address} stopped the arm: {one_line(error)}") from error
        except Exception as error:  # libfranka's NetworkException, or an error of the socket below it
            raise StationError(f"connection to the Franka at {self.address} lost: {one_line(error)}") from error
