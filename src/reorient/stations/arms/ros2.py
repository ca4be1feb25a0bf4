"""Any arm with a Cartesian controller of ROS 2: poses as geometry_msgs/PoseStamped."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from reorient import se3, so3
from reorient.errors import StationError
from reorient.se3 import Transform
from reorient.stations.arms.streamed import StreamedArm
from reorient.stations.ros2_node import Ros2Node


@dataclass(kw_only=True, eq=False)
class Ros2Arm(StreamedArm):
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
        self._message: Any = self._ros.messages["geometry"].PoseStamped
        self._ros.node.create_subscription(self._message, self.pose_topic, self._measured, 1)
        self._publisher = self._ros.node.create_publisher(self._message, self.command_topic, 1)
        self._ros.node.create_timer(1 / self.rate_hz, self._follow)
        self._ros.start()
        self._await_controller()

    def stop(self) -> None:
        """Publish the measured pose as the one to go to."""
        with self._lock:
            super().stop()
            if self._latest is not None:
                self._publish(self._latest[0])

    def close(self) -> None:
        """Leave the ROS network."""
        self._ros.close()

    def _silence(self) -> str:
        return f"no pose on {self.pose_topic} within {self.silent_s:g} s"

    def _check_ready(self) -> None:
        """Raise StationError also unless one controller listens, and nobody else commands."""
        super()._check_ready()
        if self._ros.node.count_subscribers(self.command_topic) == 0:
            raise StationError(f"nobody listens on {self.command_topic}: expected an active controller")
        if (count := self._ros.node.count_publishers(self.command_topic)) > 1:
            raise StationError(
                f"{count - 1} other programs publish on {self.command_topic}: expected none that commands the arm"
            )

    def _executing(self) -> bool:
        self._check_ready()
        return super()._executing()

    def _measured(self, message: Any) -> None:
        self._received(from_ros(message.pose), message)

    def _follow(self) -> None:
        """A timer's call: publish the pose that is due."""
        with self._lock:
            if (T := self._due()) is not None:
                self._publish(T)

    def _publish(self, T: Transform) -> None:
        message = self._message(pose=to_ros(T, self._ros.messages["geometry"]))
        message.header.stamp = self._ros.node.get_clock().now().to_msg()
        message.header.frame_id = "" if self._latest is None else self._latest[1].header.frame_id
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
