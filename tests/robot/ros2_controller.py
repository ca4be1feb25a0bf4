"""A ROS 2 node as a Cartesian controller: follows PoseStamped, and publishes its pose at 100 Hz."""

from multiprocessing.connection import Connection

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped

GAIN = 0.3  # of the way to the commanded pose in each period


def main(connection: Connection, domain: int) -> None:
    """Answers ("truth",) with position and xyzw, ("commands",) with their number and the last one, ("set", ...)."""
    rclpy.init(domain_id=domain)
    node = rclpy.create_node("controller")
    robot = {"pos": np.array([0.5, -0.1, 0.4]), "quat": np.array([0.0, 1.0, 0.0, 0.0])}
    state = {"publishing": True, "following": True}
    commands: list[PoseStamped] = []
    publisher = node.create_publisher(PoseStamped, "current_pose", 1)
    subscription = node.create_subscription(PoseStamped, "target_frame", commands.append, 1)

    def step() -> None:
        if commands and state["following"]:
            follow(robot, commands[-1])
        if state["publishing"]:
            message = PoseStamped()
            message.header.frame_id = "base_link"
            write(message, robot)
            publisher.publish(message)

    node.create_timer(0.01, step)
    connection.send(domain)
    while True:
        rclpy.spin_once(node, timeout_sec=0.01)
        if not connection.poll():
            continue
        what, *arguments = connection.recv()
        if what == "set":
            (robot if arguments[0] in robot else state)[arguments[0]] = arguments[1]
        elif what == "deaf":
            node.destroy_subscription(subscription)
        elif what == "other_publisher":
            node.create_publisher(PoseStamped, "target_frame", 1)
        connection.send((len(commands), read(commands[-1])) if what == "commands" else (robot["pos"], robot["quat"]))


def read(message: PoseStamped) -> tuple[str, np.ndarray, np.ndarray]:
    p, q = message.pose.position, message.pose.orientation
    return message.header.frame_id, np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])


def write(message: PoseStamped, robot: dict[str, np.ndarray]) -> None:
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = robot["pos"].tolist()
    q.x, q.y, q.z, q.w = robot["quat"].tolist()


def follow(robot: dict[str, np.ndarray], message: PoseStamped) -> None:
    _, pos, quat = read(message)
    robot["pos"] = robot["pos"] + GAIN * (pos - robot["pos"])
    mixed = robot["quat"] + GAIN * (quat * np.sign(quat @ robot["quat"]) - robot["quat"])
    robot["quat"] = mixed / np.linalg.norm(mixed)
