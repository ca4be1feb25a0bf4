"""A ROS 2 node as a depth camera, 20 images a second."""

from multiprocessing.connection import Connection

import numpy as np
import rclpy
from sensor_msgs.msg import CameraInfo, Image

WIDTH, HEIGHT = 32, 24
K = (50.0, 0.0, 15.0, 0.0, 51.0, 12.0, 0.0, 0.0, 1.0)
P = (48.0, 0.0, 16.0, 0.0, 0.0, 49.0, 11.0, 0.0, 0.0, 0.0, 1.0, 0.0)


def main(connection: Connection, domain: int) -> None:
    """("set", {field: value}) changes what is published: depth, kind (dtype), late_s, d, ..."""
    rclpy.init(domain_id=domain)
    node = rclpy.create_node("camera")
    state = {
        "depth": None,
        "kind": "<u2",
        "encoding": "",
        "bigendian": False,
        "padding": 0,
        "late_s": 0.0,
        "d": (),
        "width": WIDTH,
    }
    images = node.create_publisher(Image, "/camera/depth/image", 1)
    infos = node.create_publisher(CameraInfo, "/camera/depth/camera_info", 1)

    def step() -> None:
        stamp = (node.get_clock().now() - rclpy.duration.Duration(seconds=state["late_s"])).to_msg()
        info = CameraInfo(width=state["width"], height=HEIGHT, k=list(K), p=list(P), d=list(state["d"]))
        info.header.stamp = stamp
        infos.publish(info)
        if state["depth"] is not None:
            image = packed(state)
            image.header.stamp = stamp
            images.publish(image)

    node.create_timer(0.05, step)
    connection.send(domain)
    while True:
        rclpy.spin_once(node, timeout_sec=0.01)
        if connection.poll():
            state |= connection.recv()[1]
            connection.send("set")


def packed(state: dict) -> Image:
    depth = state["depth"].astype(state["kind"])  # here: numpy's pickles lose the byte order
    rows = depth.view(np.uint8).reshape(HEIGHT, -1)
    rows = np.pad(rows, ((0, 0), (0, state["padding"])))
    return Image(
        height=HEIGHT,
        width=depth.shape[1],
        encoding=state["encoding"],
        is_bigendian=int(state["bigendian"]),
        step=rows.shape[1],
        data=rows.tobytes(),
    )
