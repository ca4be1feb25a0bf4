"""Intel RealSense cameras, live or recorded (pyrealsense2)."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reorient.errors import ReorientError, StationError, check_range
from reorient.extras import import_extra
from reorient.imaging import Camera, DepthImage


@dataclass(kw_only=True, eq=False)
class RealSenseCamera:
    """The depth stream of a RealSense camera.

    Depth is z16 times the depth units of the frame; 0 is a pixel without return. A live camera returns a frame whose
    exposure began after the call; a recording its next frame.
    """

    serial: str = ""
    """Serial number; empty: the only camera that is connected."""
    recording: str = ""
    """File of a recording (.db3, .bag), in place of a live camera."""
    width: int = 0
    """Columns, px; 0: as the camera chooses."""
    height: int = 0
    """Rows, px; 0: as the camera chooses."""
    rate_hz: int = 0
    """Frames a second; 0: as the camera chooses."""
    align_to_color: bool = False
    """Whether depth is mapped to the pixels of the colour camera, as masks of the colour image need."""
    timeout_s: float = 5.0
    """Longest wait for a frame."""

    def __post_init__(self) -> None:
        """Raises ReorientError for settings out of range, StationError where the camera cannot be opened."""
        check_range(self, "timeout_s", above=True)
        check_range(self, "width", "height", "rate_hz")
        if self.recording and (self.serial or not Path(self.recording).is_file()):
            raise ReorientError(
                f"recording {self.recording!r}: expected an existing file, and no serial number with it"
            )
        self._rs: Any = import_extra("pyrealsense2")
        self._clock_is_host = False
        self._pipeline = self._started()
        self._align = self._rs.align(self._rs.stream.color) if self.align_to_color else None

    def capture(self) -> DepthImage:
        """The next frame. Raises StationError where none arrives, and ReorientError for lens distortion."""
        frames = self._newest() if not self.recording else self._next()
        if self._align is not None:
            frames = self._align.process(frames)
        frame = frames.get_depth_frame()
        if not frame:
            raise StationError(f"a frame of {self._name()} without depth: expected the depth stream")
        domain = self._rs.timestamp_domain
        self._clock_is_host = frame.get_frame_timestamp_domain() in (domain.system_time, domain.global_time)
        raw = np.asanyarray(frame.get_data())
        depth_m = np.where(raw == 0, np.nan, raw * float(frame.get_units()))
        return DepthImage(depth_m, camera_of(frame.profile.as_video_stream_profile().intrinsics), self._stamp_s(frame))

    def clock_s(self) -> float:
        """The clock of the stamps; NaN where the camera uses a clock of its own, and for a recording."""
        return time.time() if self._clock_is_host and not self.recording else float("nan")

    def close(self) -> None:
        """Free the camera."""
        self._pipeline.stop()

    def _started(self) -> Any:
        rs, config = self._rs, self._rs.config()
        if self.recording:
            config.enable_device_from_file(self.recording, repeat_playback=False)
        elif self.serial:
            config.enable_device(self.serial)
        config.enable_stream(rs.stream.depth, self.width, self.height, rs.format.z16, self.rate_hz)
        if self.align_to_color:
            config.enable_stream(rs.stream.color)
        pipeline = rs.pipeline()
        try:
            self._check_connected()
            if self.recording:  # before the start: frames played in real time until then would be lost
                device = config.resolve(rs.pipeline_wrapper(pipeline)).get_device()
                device.as_playback().set_real_time(False)
            pipeline.start(config)
        except RuntimeError as error:
            raise StationError(
                f"cannot open {self._name()} ({error}): expected a camera that no other program uses, and streams that "
                "it has"
            ) from error
        return pipeline

    def _check_connected(self) -> None:
        """Raise StationError where a live camera is not connected: its pipeline would wait for 15 s."""
        serials = [each.get_info(self._rs.camera_info.serial_number) for each in self._rs.context().query_devices()]
        if not self.recording and (self.serial not in serials if self.serial else len(serials) != 1):
            raise StationError(
                f"no {self._name()}: expected one connected camera, or the serial number of one; connected: "
                f"{', '.join(serials) or 'none'}"
            )

    def _newest(self) -> Any:
        """A frame whose exposure began after this call: not one of the queue, nor the one that is being exposed."""
        while self._pipeline.poll_for_frames():
            pass
        self._next()
        return self._next()

    def _next(self) -> Any:
        try:
            return self._pipeline.wait_for_frames(int(1000 * self.timeout_s))
        except RuntimeError as error:
            ended = "the recording ended" if self.recording else "unplugged, or used by another program?"
            raise StationError(f"no frame of {self._name()} within {self.timeout_s:g} s: {ended}") from error

    def _stamp_s(self, frame: Any) -> float:
        return float(frame.get_timestamp()) / 1000

    def _name(self) -> str:
        return self.recording or f"RealSense {self.serial}".strip()


def camera_of(intrinsics: Any) -> Camera:
    """The camera of RealSense's intrinsics, which count pixel centres at integers.

    Raises ReorientError for lens distortion: the depth stream has none, a colour stream may have some.
    """
    if np.any(np.asarray(intrinsics.coeffs, float) != 0):
        raise ReorientError(
            f"lens distortion {list(intrinsics.coeffs)} in the intrinsics: expected none (align_to_color = false)"
        )
    K = np.array([[intrinsics.fx, 0, intrinsics.ppx], [0, intrinsics.fy, intrinsics.ppy], [0, 0, 1.0]])
    return Camera.from_K(K, intrinsics.width, intrinsics.height)
