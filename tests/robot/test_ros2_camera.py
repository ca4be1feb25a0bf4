"""The ROS 2 camera driver on real middleware: a peer node publishes images and intrinsics."""

import time

import numpy as np
import pytest
import ros2_publisher
from peer import running

from reorient.errors import ReorientError, StationError
from reorient.stations.cameras.ros2 import Ros2Camera

SHAPE = ros2_publisher.HEIGHT, ros2_publisher.WIDTH


@pytest.fixture
def publisher(ros_domain):
    with running(ros2_publisher.main, ros_domain) as peer:
        yield peer


@pytest.fixture
def connect(publisher):
    cameras = []

    def make(**settings) -> Ros2Camera:
        cameras.append(Ros2Camera(**({"topic": "/camera/depth/image"} | settings)))
        return cameras[-1]

    yield make
    for camera in cameras:
        camera.close()


def publish(publisher, **fields) -> None:
    publisher.ask("set", {"depth": scene_mm(), "encoding": "16UC1"} | fields)


def scene_mm() -> np.ndarray:
    """600 mm and a bit in each pixel, and some pixels without return."""
    depth = 600.0 + np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    depth[:2] = 0
    return depth


@pytest.mark.parametrize(
    ("kind", "encoding", "unit", "nothing"),
    [
        ("<u2", "16UC1", 1.0, 0),
        (">u2", "16UC1", 1.0, 0),
        ("<u2", "mono16", 1.0, 0),
        ("<f4", "32FC1", 0.001, 0),
        (">f4", "32FC1", 0.001, np.nan),
    ],
)
@pytest.mark.parametrize("padding", [0, 8])
def test_every_encoding_is_metres(publisher, connect, kind, encoding, unit, nothing, padding):
    depth = scene_mm() * unit
    depth[:2] = nothing
    publish(publisher, depth=depth, kind=kind, encoding=encoding, bigendian=kind[0] == ">", padding=padding)
    image = connect().capture()
    assert np.allclose(image.depth_m, 0.001 * scene_mm(), atol=1e-6)
    assert np.array_equal(image.unknown, scene_mm() == 0)


def test_intrinsics_count_pixel_centres_at_integers(publisher, connect):
    publish(publisher)
    camera = connect().capture().camera
    assert (camera.width, camera.height) == (ros2_publisher.WIDTH, ros2_publisher.HEIGHT)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50.0, 51.0, 15.5, 12.5)


def test_an_image_is_stamped_after_the_call(publisher, connect):
    publish(publisher)
    camera = connect()
    for _ in range(3):
        called_s = camera.clock_s()
        image = camera.capture()
        assert called_s <= image.stamp_s <= camera.clock_s()
        assert abs(image.stamp_s - time.time()) < 1  # ROS time is the host's
        time.sleep(0.2)


def test_distortion_needs_a_rectified_image(publisher, connect):
    publish(publisher, d=(0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ReorientError, match=r"lens distortion \[0.1, .* rectified = true"):
        connect().capture()
    camera = connect(rectified=True).capture().camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (48.0, 49.0, 16.5, 11.5)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"late_s": 20.0}, "the last is stamped 20.* s ago, before the call"),
        ({"depth": None}, "no image on /camera/depth/image within 1 s"),
        ({"encoding": "rgb8"}, "encoding 'rgb8': expected depth, 16UC1"),
        ({"encoding": "32FC1"}, "expected 4 bytes a pixel"),
        ({"width": 64}, "intrinsics of 64 x 24 px .* for an image of 32 x 24 px"),
    ],
)
def test_what_is_no_depth_image(publisher, connect, fields, message):
    publish(publisher, **fields)
    with pytest.raises(ReorientError, match=message):
        connect(timeout_s=1.0).capture()


def test_no_intrinsics(publisher, connect):
    publish(publisher)
    with pytest.raises(StationError, match="no intrinsics on /nowhere: expected sensor_msgs/CameraInfo"):
        connect(info_topic="/nowhere", timeout_s=1.0).capture()


def test_a_camera_that_dies(publisher, connect):
    publish(publisher)
    camera = connect(timeout_s=1.0)
    camera.capture()
    publisher.kill()
    with pytest.raises(StationError, match="no new image on /camera/depth/image"):
        camera.capture()
