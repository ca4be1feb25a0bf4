"""Any depth camera with a ROS 2 driver: sensor_msgs/Image and CameraInfo."""

import time
from dataclasses import dataclass
from threading import Condition
from typing import Any

import numpy as np

from reorient.errors import ReorientError, StationError, check_range
from reorient.extras import import_extra
from reorient.imaging import Camera, DepthImage
from reorient.stations.ros2_node import Ros2Node, seconds

_TYPES = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_MILLIMETRE = 0.001  # the unit of 16-bit depth (REP 118); 32-bit depth is metres


@dataclass(kw_only=True, eq=False)
class Ros2Camera:
    """The newest image of a depth topic: 16UC1 in millimetres or 32FC1 in metres, as REP 118 fixes.

    ``capture`` waits for an image that was stamped after the call. Camera axes are those of the optical frame (x right,
    y down, z forward). Pixels of 0 and NaN have no return.
    """

    topic: str
    """Topic of the images, such as ``/camera/depth/image_rect_raw``."""
    info_topic: str = ""
    """Topic of the intrinsics; empty: ``camera_info`` beside the images."""
    rectified: bool = False
    """Whether the images are rectified although the intrinsics state a distortion: then the matrix P holds."""
    timeout_s: float = 5.0
    """Longest wait for an image."""

    def __post_init__(self) -> None:
        """Raises ReorientError where rclpy is missing."""
        check_range(self, "timeout_s", above=True)
        self._ros = Ros2Node("reorient_camera")
        self._arrival = Condition()
        self._image: Any = None
        self._info: Any = None
        folder, slash, _ = self.topic.rpartition("/")
        self._info_topic = self.info_topic or f"{folder}{slash}camera_info"
        quality = import_extra("rclpy.qos").qos_profile_sensor_data
        messages = self._ros.messages["sensor"]
        self._ros.node.create_subscription(messages.Image, self.topic, self._received, quality)
        self._ros.node.create_subscription(messages.CameraInfo, self._info_topic, self._informed, quality)
        self._ros.start()

    def capture(self) -> DepthImage:
        """The next image. Raises StationError where none arrives, ReorientError for one that is no depth image."""
        called_s, deadline_s = self.clock_s(), time.monotonic() + self.timeout_s
        with self._arrival:
            while not (self._info and self._image and seconds(self._image.header.stamp) >= called_s):
                if not self._arrival.wait(max(0.0, deadline_s - time.monotonic())):
                    raise self._missing()
            message, info = self._image, self._info
        depth_m = depth_of(message)
        return DepthImage(depth_m, camera_of(info, message, self.rectified), seconds(message.header.stamp))

    def clock_s(self) -> float:
        """ROS time, in which images are stamped."""
        return self._ros.now_s()

    def close(self) -> None:
        """Leave the ROS network."""
        self._ros.close()

    def _received(self, message: Any) -> None:
        with self._arrival:
            self._image = message
            self._arrival.notify_all()

    def _informed(self, message: Any) -> None:
        with self._arrival:
            self._info = message
            self._arrival.notify_all()

    def _missing(self) -> StationError:
        """The error for an image that did not arrive."""
        if self._image is None:
            return StationError(f"no image on {self.topic} within {self.timeout_s:g} s: expected a running camera")
        if self._info is None:
            return StationError(f"no intrinsics on {self._info_topic}: expected sensor_msgs/CameraInfo")
        late_s = self.clock_s() - seconds(self._image.header.stamp)
        return StationError(
            f"no new image on {self.topic}: the last is stamped {late_s:.1f} s ago, before the call; expected a "
            "running camera, and its clock in step with this computer's (NTP)"
        )


def depth_of(message: Any) -> np.ndarray:
    """The depth in metres of a sensor_msgs/Image, NaN without return. Raises ReorientError for another encoding."""
    if message.encoding not in _TYPES:
        raise ReorientError(
            f"image of encoding {message.encoding!r}: expected depth, {', '.join(_TYPES)} (another topic?)"
        )
    kind = np.dtype((">" if message.is_bigendian else "<") + _TYPES[message.encoding])
    rows = np.frombuffer(message.data, np.uint8)
    if message.step < message.width * kind.itemsize or rows.size != message.height * message.step:
        raise ReorientError(
            f"image of {message.width} x {message.height} px with {rows.size} bytes, {message.step} a row: expected "
            f"{kind.itemsize} bytes a pixel"
        )
    rows = rows.reshape(message.height, message.step)[:, : message.width * kind.itemsize]
    depth = np.ascontiguousarray(rows).view(kind)
    unit_m = _MILLIMETRE if kind.kind == "u" else 1.0
    return np.where(depth == 0, np.nan, depth.astype(np.float64) * unit_m)


def camera_of(info: Any, image: Any, rectified: bool) -> Camera:
    """The camera of a sensor_msgs/CameraInfo, which counts pixel centres at integers.

    Raises ReorientError for lens distortion, and for intrinsics of another image size.
    """
    if np.any(info.d) and not rectified:
        raise ReorientError(
            f"lens distortion {list(info.d)} in the intrinsics: expected a rectified image (image_proc), and then "
            "rectified = true"
        )
    if (info.width, info.height) != (image.width, image.height) or max(info.binning_x, info.binning_y) > 1:
        raise ReorientError(
            f"intrinsics of {info.width} x {info.height} px (binning {info.binning_x}, {info.binning_y}) for an image "
            f"of {image.width} x {image.height} px: expected those of the image"
        )
    K = np.array(info.p).reshape(3, 4)[:, :3] if rectified else np.array(info.k).reshape(3, 3)
    return Camera.from_K(K, info.width, info.height)
