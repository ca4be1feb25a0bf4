"""Any arm with a Cartesian controller of ROS 2: poses as geometry_msgs/PoseStamped."""

import time
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import StationError
from reorient.se3 import Transform
from reorient.stations.arms.supervised import StraightPath, SupervisedArm
from reorient.stations.ros2_node import Ros2Node


@dataclass(kw_only=True, eq=False)
class Ros2Arm(SupervisedArm):
    """An arm whose controller follows a pose topic, and reports its pose on another.

    Such are cartesian_controllers (``target_frame``, ``current_pose``), crisp_controllers (``target_pose``,
    ``current_pose``) and MoveIt Servo with a pose broadcaster. In a move the poses of the path are published at
    ``rate_hz``, in the frame of the reported pose, which is the base. Nothing is published at rest: an arm stays where
    this program ends.
    """

    pose_topic: str
    """Topic of the measured pose of the tool."""
    command_topic: str
    """Topic of the pose to go to."""
    rate_hz: float = 100.0
    """Poses a second that are published in a move. Not tuned."""

    def __post_init__(self) -> None:
        """Raises StationError where no pose arrives, or nobody listens to the commands."""
        super().__post_init__()
        self._ros = Ros2Node("reorient_arm")
        self._lock = Lock()
        self._pose: tuple[Transform, str, float] | None = None
        """The measured pose, its frame, and the time of its arrival."""
        self._path: StraightPath | None = None
        self._start_s = 0.0
        self._message: Any = self._ros.messages["geometry"].PoseStamped
        self._ros.node.create_subscription(self._message, self.pose_topic, self._received, 1)
        self._publisher = self._ros.node.create_publisher(self._message, self.command_topic, 1)
        self._ros.node.create_timer(1 / self.rate_hz, self._publish)
        self._ros.start()
        try:
            self._await_controller()
        except BaseException:
            self.close()
            raise

    def pose(self) -> Transform:
        """The measured pose of the tool, T_base_tool. Raises StationError where none arrived for ``silent_s``."""
        with self._lock:
            pose = self._pose
        if pose is None or time.monotonic() - pose[2] > self.silent_s:
            raise StationError(
                f"no pose on {self.pose_topic} in the last {self.silent_s:g} s: connection lost, or controller stopped"
            )
        return pose[0]

    def stop(self) -> None:
        """Publish the measured pose as the one to go to."""
        with self._lock:
            self._path = None
            if self._pose is not None:
                self._command(self._pose[0])

    def close(self) -> None:
        """Leave the ROS network."""
        self._ros.close()

    def _begin(self, path: StraightPath) -> None:
        self._check_peers()
        with self._lock:
            self._path, self._start_s = path, time.monotonic()

    def _executing(self) -> bool:
        self._check_peers()
        with self._lock:
            return self._path is not None

    def _check_peers(self) -> None:
        """Raise StationError unless one controller listens, and nobody else commands."""
        if self._ros.node.count_subscribers(self.command_topic) == 0:
            raise StationError(f"nobody listens on {self.command_topic}: expected an active controller")
        if (count := self._ros.node.count_publishers(self.command_topic)) > 1:
            raise StationError(
                f"{count - 1} other programs publish on {self.command_topic}: expected none that commands the arm"
            )

    def _await_controller(self) -> None:
        deadline_s = time.monotonic() + self.timeout_s
        while True:
            try:
                self.pose()
                self._check_peers()
                return
            except StationError:
                if time.monotonic() > deadline_s:
                    raise
            time.sleep(0.02)

    def _received(self, message: Any) -> None:
        T = from_ros(message.pose)
        with self._lock:
            self._pose = T, message.header.frame_id, time.monotonic()

    def _publish(self) -> None:
        """A timer's call: the pose of this moment, in a move."""
        with self._lock:
            if self._path is None:
                return
            elapsed_s = time.monotonic() - self._start_s
            self._command(self._path.at(elapsed_s))
            if elapsed_s > self._path.duration_s:
                self._path = None

    def _command(self, T: Transform) -> None:
        message = self._message(pose=to_ros(T, self._ros.messages["geometry"]))
        message.header.stamp = self._ros.node.get_clock().now().to_msg()
        message.header.frame_id = self._pose[1] if self._pose is not None else ""
        self._publisher.publish(message)


def from_ros(pose: Any) -> Transform:
    """A pose in metres from geometry_msgs/Pose, whose quaternion is xyzw."""
    p, q = pose.position, pose.orientation
    quat_wxyz = so3.normalize(np.array([q.w, q.x, q.y, q.z], float))
    return se3.transform(so3.matrix_from_quat(quat_wxyz), np.array([p.x, p.y, p.z], float))


def to_ros(T: Transform, geometry: Any) -> Any:
    """The geometry_msgs/Pose of a pose in metres; ``geometry``: the module geometry_msgs.msg."""
    w, x, y, z = so3.quat_from_matrix(T[:3, :3]).tolist()
    px, py, pz = T[:3, 3].tolist()
    return geometry.Pose(position=geometry.Point(x=px, y=py, z=pz), orientation=geometry.Quaternion(x=x, y=y, z=z, w=w))
