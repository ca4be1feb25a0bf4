"""The RealSense driver on pyrealsense2: a software device, recorded and played back."""

import time

import numpy as np
import pyrealsense2 as rs
import pytest
import realsense_device as device

from reorient.errors import ReorientError, StationError
from reorient.stations.cameras.realsense import RealSenseCamera


def scene(number: int) -> np.ndarray:
    """A plate at 0.6 m and a bit, of 200 px, in front of a wall at 1.2 m; some pixels without return."""
    raw = np.full((device.HEIGHT, device.WIDTH), 2400, np.uint16)
    raw[140:340, 220:420] = 1200 + number
    raw[:10] = 0
    return raw


@pytest.fixture
def recording(tmp_path):
    device.record(tmp_path / "x.db3", [scene(n) for n in range(4)])
    return str(tmp_path / "x.db3")


def test_a_recording_keeps_depth_intrinsics_units_and_stamps(recording):
    camera = RealSenseCamera(recording=recording, timeout_s=1.5)
    images = [camera.capture() for _ in range(4)]
    for number, image in enumerate(images):
        assert np.allclose(image.depth_m, scene(number) * device.UNITS_M, atol=1e-6)
        assert np.array_equal(image.unknown, scene(number) == 0)
        assert image.stamp_s == pytest.approx(number / device.RATE_HZ, abs=1e-3)
    optics = images[0].camera
    assert (optics.width, optics.height) == (device.WIDTH, device.HEIGHT)
    assert (optics.fx, optics.fy) == (device.DEPTH_F, device.DEPTH_F + 1)
    assert (optics.cx, optics.cy) == (321.5, 238.5)  # pixel centres at integers there, at +0.5 here
    with pytest.raises(StationError, match="the recording ended"):
        camera.capture()
    camera.close()


def test_a_recording_loses_no_frame_where_the_start_takes_long(recording, monkeypatch):
    class Slow(rs.pipeline):
        def start(self, *args):
            profile = super().start(*args)
            time.sleep(0.3)
            return profile

    monkeypatch.setattr(rs, "pipeline", Slow)
    camera = RealSenseCamera(recording=recording, timeout_s=1.5)
    assert [round(camera.capture().stamp_s * device.RATE_HZ) for _ in range(4)] == [0, 1, 2, 3]
    camera.close()


def test_a_live_camera_returns_no_frame_from_before_the_call(tmp_path):
    """A recording that is played in real time is as a live camera: frames wait in its queue."""
    device.record(tmp_path / "x.db3", [scene(n) for n in range(50)], pause_s=1 / device.RATE_HZ)
    camera = RealSenseCamera(recording=str(tmp_path / "x.db3"))
    camera._pipeline.get_active_profile().get_device().as_playback().set_real_time(True)
    camera.recording = ""
    first_s = camera.capture().stamp_s
    time.sleep(0.5)
    assert camera.capture().stamp_s > first_s + 0.5
    assert np.isnan(camera.clock_s())  # the hardware's clock is not the host's
    camera.close()


def test_depth_aligned_to_color_is_that_of_the_color_camera(recording):
    camera = RealSenseCamera(recording=recording, align_to_color=True, timeout_s=1.5)
    image = camera.capture()
    camera.close()
    assert image.camera.fx == device.COLOR_F
    row = image.depth_m[240]
    plate = np.flatnonzero((row > 0.55) & (row < 0.65))
    # the plate's edges through the depth camera, the baseline and the color camera
    for u, found in ((220, plate[0]), (419, plate[-1])):
        x_m = (u - 321) / device.DEPTH_F * 0.6 + device.BASELINE_M
        assert abs(found - (x_m / 0.6 * device.COLOR_F + 321)) < 1.1


def test_a_distorted_color_camera_is_refused(tmp_path):
    device.record(tmp_path / "x.db3", [scene(n) for n in range(4)], coeffs=(0.1, 0.0, 0.0, 0.0, 0.0))
    camera = RealSenseCamera(recording=str(tmp_path / "x.db3"), align_to_color=True, timeout_s=1.5)
    with pytest.raises(ReorientError, match=r"lens distortion .*align_to_color = false"):
        camera.capture()
    camera.close()


def test_no_camera_and_no_recording():
    with pytest.raises(StationError, match=r"no RealSense 0123: .* connected: none"):
        RealSenseCamera(serial="0123")
    with pytest.raises(ReorientError, match="expected an existing file"):
        RealSenseCamera(recording="nowhere.db3")
