"""A ROS 2 node with a context and a thread of its own, for the camera and the arm driver."""

from threading import Thread
from typing import Any

from reorient.extras import import_extra


class Ros2Node:
    """Topics of the ROS 2 network, whose callbacks run in a thread.

    Domain and network are those of the environment (ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, ...).
    """

    def __init__(self, name: str) -> None:
        """Raises ReorientError where rclpy is missing."""
        self._rclpy = import_extra("rclpy")
        import_extra("rclpy.executors")
        self.messages = {
            name: import_extra(f"{package}.msg")
            for name, package in (("sensor", "sensor_msgs"), ("geometry", "geometry_msgs"))
        }
        self._context = self._rclpy.Context()
        # rclpy's own handler of Ctrl-C would shut the context down, and an arm could not be told to stop any more
        handlers = import_extra("rclpy.signals").SignalHandlerOptions.NO
        self._rclpy.init(context=self._context, signal_handler_options=handlers)
        self.node: Any = self._rclpy.create_node(name, context=self._context)
        self._executor = self._rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = Thread(target=self._executor.spin, daemon=True)

    def start(self) -> None:
        """Run the callbacks from now on."""
        self._thread.start()

    def now_s(self) -> float:
        """ROS time in seconds."""
        return float(self.node.get_clock().now().nanoseconds) * 1e-9

    def close(self) -> None:
        """Leave the network."""
        self._executor.shutdown()
        self._thread.join(1.0)
        self.node.destroy_node()
        self._context.try_shutdown()


def seconds(stamp: Any) -> float:
    """A builtin_interfaces/Time in seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
