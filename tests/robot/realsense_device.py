"""A RealSense device made of software: records depth and colour, or streams them from a process of its own."""

import time
from pathlib import Path

import numpy as np
import pyrealsense2 as rs

WIDTH, HEIGHT, RATE_HZ, UNITS_M = 640, 480, 30, 0.0005
DEPTH_F, COLOR_F, BASELINE_M = 610.0, 615.0, 0.015


class Device:
    """Depth and colour sensors of a software device, the colour camera BASELINE_M to the left of the depth camera."""

    def __init__(self, coeffs: tuple[float, ...] = (0.0,) * 5) -> None:
        self.device = rs.software_device()
        self.depth, self.color = self.device.add_sensor("Depth"), self.device.add_sensor("Color")
        self.depth.add_read_only_option(rs.option.depth_units, UNITS_M)
        self.depth_profile = self.depth.add_video_stream(stream(rs.stream.depth, rs.format.z16, 2, 0, DEPTH_F))
        self.color_profile = self.color.add_video_stream(stream(rs.stream.color, rs.format.rgb8, 3, 1, COLOR_F, coeffs))
        extrinsics = rs.extrinsics()
        extrinsics.rotation, extrinsics.translation = np.eye(3).ravel().tolist(), [BASELINE_M, 0, 0]
        self.depth_profile.register_extrinsics_to(self.color_profile, extrinsics)

    def send(self, number: int, raw: np.ndarray) -> None:
        color = np.full((HEIGHT, WIDTH, 3), number, np.uint8)
        for sensor, profile, data in (
            (self.depth, self.depth_profile, raw),
            (self.color, self.color_profile, color),
        ):
            frame = rs.software_video_frame()
            frame.bpp = 2 if data is raw else 3
            frame.stride = WIDTH * frame.bpp
            frame.timestamp, frame.frame_number = 1000.0 * number / RATE_HZ, number
            frame.domain = rs.timestamp_domain.hardware_clock
            frame.profile = profile.as_video_stream_profile()
            if data is raw:
                frame.depth_units = UNITS_M
            frame.pixels = data
            sensor.on_video_frame(frame)


def stream(
    kind: rs.stream, form: rs.format, bpp: int, uid: int, f: float, coeffs: tuple[float, ...] = (0.0,) * 5
) -> rs.video_stream:
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = WIDTH, HEIGHT
    intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = f, f + 1, 321.0, 238.0
    intrinsics.model = rs.distortion.brown_conrady if any(coeffs) else rs.distortion.none
    intrinsics.coeffs = list(coeffs)
    video = rs.video_stream()
    video.type, video.index, video.uid, video.fmt, video.bpp = kind, 0, uid, form, bpp
    video.width, video.height, video.fps, video.intrinsics = WIDTH, HEIGHT, RATE_HZ, intrinsics
    return video


def record(path: Path, frames: list[np.ndarray], pause_s: float = 0.0, **settings) -> None:
    """``pause_s``: between two frames, which a playback in real time repeats."""
    device = Device(**settings)
    recorder = rs.recorder(str(path), device.device)
    queues = []
    for sensor in recorder.query_sensors():
        queues.append(rs.frame_queue(10))
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(queues[-1])
    for number, raw in enumerate(frames):
        device.send(number, raw)
        for queue in queues:
            queue.wait_for_frame(1000)
        time.sleep(pause_s)
    for sensor in recorder.query_sensors():
        sensor.stop()
        sensor.close()
