import json

import numpy as np
import pytest

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.imaging.files import write_camera
from reorient.perception.calibration import Calibration, MountedCamera, read_calibration, write_calibration


@pytest.fixture
def mounted(camera, rng):
    return MountedCamera(camera, se3.transform(so3.sample_uniform(rng, 1)[0], np.array([0.4, 0.1, 0.8])))


def test_there_and_back(mounted, rng):
    points = rng.standard_normal((5, 3))
    np.testing.assert_allclose(
        se3.apply(mounted.T_camera_world, se3.apply(mounted.T_world_camera, points)), points, atol=1e-12
    )
    np.testing.assert_allclose(se3.inverse(mounted.T_camera_world), mounted.T_world_camera, atol=1e-12)


@pytest.mark.parametrize("both", [True, False])
def test_a_file_says_what_was_written(tmp_path, mounted, both):
    write_calibration(tmp_path / "cell.json", Calibration(mounted, mounted if both else None))
    read = read_calibration(tmp_path / "cell.json")
    assert read.depth.camera == mounted.camera
    np.testing.assert_allclose(read.depth.T_world_camera, mounted.T_world_camera)
    assert (read.color is not None) == both


def test_a_camera_is_what_read_camera_takes(tmp_path, mounted):
    """Whoever has its file can put it in."""
    write_camera(tmp_path / "camera.json", mounted.camera)
    camera = json.loads((tmp_path / "camera.json").read_text())
    for stated, shift in ((0.5, 0.0), (0.0, 0.5)):
        block = {"camera": camera | {"pixel_centers_at": stated}, "T_world_camera": np.eye(4).tolist()}
        (tmp_path / "cell.json").write_text(json.dumps({"depth": block}))
        assert read_calibration(tmp_path / "cell.json").depth.camera.cx == mounted.camera.cx + shift


def breakages():
    identity = np.eye(4).tolist()
    camera = {"width": 10, "height": 10, "fx": 9.0, "fy": 9.0, "cx": 5.0, "cy": 5.0}
    return {
        "no JSON": ("{", "is not JSON"),
        "a list": ("[]", "broken calibration file"),
        "no depth": ("{}", "no 'depth'"),
        "no transform": (json.dumps({"depth": {"camera": camera}}), "no 'T_world_camera'"),
        "a shear": (
            json.dumps({"depth": {"camera": camera, "T_world_camera": [[1, 1, 0, 0], *identity[1:]]}}),
            "rigid",
        ),
        "no camera": (json.dumps({"depth": {"camera": 3, "T_world_camera": identity}}), "broken .*missing intrinsics"),
        "no principal point": (
            json.dumps(
                {"depth": {"camera": {k: v for k, v in camera.items() if k != "cy"}, "T_world_camera": identity}}
            ),
            "camera in 'depth': missing intrinsics, no cy",
        ),
        "no focal length": (
            json.dumps({"depth": {"camera": camera | {"fx": 0}, "T_world_camera": identity}}),
            "fx, fy > 0",
        ),
    }


@pytest.mark.parametrize("what", breakages())
def test_broken_files_are_refused_in_one_line(tmp_path, what):
    text, message = breakages()[what]
    (tmp_path / "cell.json").write_text(text)
    with pytest.raises(ReorientError, match=message) as caught:
        read_calibration(tmp_path / "cell.json")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ReorientError, match="no calibration file"):
        read_calibration(tmp_path / "none.json")
