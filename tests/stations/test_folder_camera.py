"""Frames of a folder, as another program writes them."""

import json
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from reorient import Camera, DepthImage
from reorient.errors import ReorientError, StationError
from reorient.imaging.files import read_depth, write_camera, write_depth
from reorient.stations.cameras.folder import FolderCamera

CAMERA = Camera(8, 6, 10.0, 10.0, 4.0, 3.0)


def frame(depth_m: float, stamp_s: float | None = None) -> DepthImage:
    return DepthImage(np.full((6, 8), depth_m), CAMERA, stamp_s)


def later(act: Callable[[], object], delay_s: float = 0.15) -> None:
    threading.Timer(delay_s, act).start()


def middle(image: DepthImage) -> float:
    return float(image.depth_m[3, 4])


def test_only_a_frame_that_arrives_after_the_call_is_returned(tmp_path):
    write_depth(tmp_path / "z.npz", frame(0.5, 1.0))  # the last by name
    camera = FolderCamera(frames=str(tmp_path))
    later(lambda: write_depth(tmp_path / "a.npz", frame(0.6, 2.0)))
    image = camera.capture()
    assert middle(image) == pytest.approx(0.6)
    assert image.stamp_s == 2.0
    assert np.isnan(camera.clock_s())  # the stamps' clock is not known
    camera.host_clock = True
    assert camera.clock_s() == pytest.approx(time.time(), abs=1)
    later(lambda: write_depth(tmp_path / "b.npz", frame(0.7, 3.0)))
    assert middle(camera.capture()) == pytest.approx(0.7)


def test_a_file_that_is_overwritten(tmp_path):
    write_depth(tmp_path / "latest.npz", frame(0.5))
    camera = FolderCamera(frames=str(tmp_path / "latest.npz"))
    before_s = time.time()
    later(lambda: write_depth(tmp_path / "latest.npz", frame(0.6)))
    image = camera.capture()
    assert middle(image) == pytest.approx(0.6)
    assert before_s <= image.stamp_s <= camera.clock_s()


def test_lens_distortion_is_undone_as_by_read_depth(tmp_path):
    """The robot's driver takes the same camera files as the command line."""
    lens = {"width": 8, "height": 6, "fx": 10, "fy": 10, "ppx": 3.5, "ppy": 2.5, "coeffs": [2.0, 0, 0, 0, 0]}
    (tmp_path / "camera.json").write_text(json.dumps(lens | {"model": "brown_conrady"}))
    units = (600 + 10 * np.arange(48).reshape(6, 8)).astype(np.uint16)
    camera = FolderCamera(frames=str(tmp_path / "*.png"), camera=str(tmp_path / "camera.json"))
    later(lambda: Image.fromarray(units).save(tmp_path / "frame.png"))
    image = camera.capture()
    expected = read_depth(tmp_path / "frame.png", tmp_path / "camera.json")
    np.testing.assert_array_equal(image.depth_m, expected.depth_m)
    assert np.any(np.abs(image.depth_m - units / 1000) > 0.005)


def test_raw_pictures_with_intrinsics_and_a_scale(tmp_path):
    """A pattern; other files of the folder are no frames."""
    write_camera(tmp_path / "camera.json", CAMERA)
    camera = FolderCamera(frames=str(tmp_path / "depth_*.png"), camera=str(tmp_path / "camera.json"), scale_m=0.0001)
    units = np.full((6, 8), 6000, np.uint16)
    units[0, 0] = 0
    raw = Image.fromarray(units)
    later(lambda: (Image.new("RGB", (8, 6)).save(tmp_path / "color_1.png"), raw.save(tmp_path / "depth_1.png")))
    image = camera.capture()
    assert middle(image) == pytest.approx(0.6)
    assert image.camera == CAMERA
    assert np.array_equal(image.unknown, units == 0)


def test_a_file_that_is_not_complete_is_awaited(tmp_path):
    write_depth(tmp_path / "whole.npz", frame(0.6))
    data = (tmp_path / "whole.npz").read_bytes()
    camera = FolderCamera(frames=str(tmp_path / "slow*.npz"))
    file = (tmp_path / "slow.npz").open("wb")
    later(lambda: (file.write(data[:100]), file.flush()), 0.1)
    later(lambda: (file.write(data[100:]), file.close()), 0.3)
    assert middle(camera.capture()) == pytest.approx(0.6)


def test_a_frame_that_is_being_written_at_the_call_is_stale(tmp_path):
    write_depth(tmp_path / "whole.npz", frame(0.5))
    data = (tmp_path / "whole.npz").read_bytes()
    camera = FolderCamera(frames=str(tmp_path / "slow*.npz"))
    file = (tmp_path / "slow1.npz").open("wb")
    file.write(data[:100])
    file.flush()
    later(lambda: (file.write(data[100:]), file.close()), 0.01)
    later(lambda: write_depth(tmp_path / "slow2.npz", frame(0.6)), 0.3)
    assert middle(camera.capture()) == pytest.approx(0.6)


def test_no_frame_and_no_folder(tmp_path):
    write_depth(tmp_path / "old.npz", frame(0.5))
    with pytest.raises(StationError, match=r"no new frame in .* within 0.2 s \(none appeared\)"):
        FolderCamera(frames=str(tmp_path), timeout_s=0.2).capture()
    later(lambda: (tmp_path / "broken.npz").write_bytes(b"PK no"), 0.1)
    with pytest.raises(StationError, match=r"no new frame .*cannot read depth image"):
        FolderCamera(frames=str(tmp_path), timeout_s=0.5).capture()
    with pytest.raises(ReorientError, match="no folder"):
        FolderCamera(frames=str(tmp_path / "nowhere" / "*.png"))
