"""Hand-eye results of other programs: each format gives the same transform."""

import json

import numpy as np
import pytest

from reorient import se3, so3
from reorient.errors import ReorientError
from reorient.perception.extrinsics import read_hand_eye

R = so3.exp(np.array([0.3, -1.2, 0.7]))
T = se3.transform(R, np.array([0.4, -0.25, 0.8]))
W, X, Y, Z = so3.quat_from_matrix(R)

TF = {"translation": {"x": 0.4, "y": -0.25, "z": 0.8}, "rotation": {"x": X, "y": Y, "z": Z, "w": W}}
EASY_HANDEYE = f"""parameters:
  eye_on_hand: false
  tracking_base_frame: camera_link
transformation:
  qw: {W}
  qx: {X}
  qy: {Y}
  qz: {Z}
  x: 0.4
  y: -0.25
  z: 0.8
"""
EASY_HANDEYE2 = f"""parameters:
  name: cell
  calibration_type: eye_on_base
transform:
  translation:
    x: 0.4
    y: -0.25
    z: 8.0e-1
  rotation:
    x: {X}
    y: {Y}
    z: {Z}
    w: {W}
"""
ROS = f"""transforms:
- header:
    stamp:
      sec: 17
      nanosec: 4
    frame_id: base
  child_frame_id: camera
  transform:
    translation:
      x: 0.4
      y: -0.25
      z: 0.8
    rotation:
      x: {X}
      y: {Y}
      z: {Z}
      w: {W}
---
"""
OPENCV = f"""%YAML:1.0
---
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ {", ".join(map(str, R.ravel()[:5]))},
       {", ".join(map(str, R.ravel()[5:]))} ]
t: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0.4, -0.25, 0.8 ]
"""
RVEC = OPENCV.replace(OPENCV[OPENCV.index("R:") : OPENCV.index("t:")], "").replace("t:", "tvec:") + (
    "rvec: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 0.3, -1.2, 0.7 ]\n"
)
MATRIX_YAML = "T:\n" + "".join(f"  - [{', '.join(map(str, row))}]\n" for row in T)
MATRIX_BLOCK = "matrix:\n" + "".join(f"- {x}\n" for x in T.ravel())


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.txt", "\n".join(" ".join(map(str, row)) for row in T)),
        ("a.csv", "\n".join(",".join(map(str, row)) for row in T)),
        ("a.json", json.dumps(T.tolist())),
        ("a.json", json.dumps({"T_base_camera": T.tolist()})),
        ("tf.json", json.dumps(TF)),
        ("a.yaml", MATRIX_YAML),
        ("a.yaml", MATRIX_BLOCK),
        ("tf.yaml", ROS),
        ("static.txt", f"0.4 -0.25 0.8 {X} {Y} {Z} {W}"),
        ("easy.yaml", EASY_HANDEYE),
        ("easy2.yaml", EASY_HANDEYE2),
        ("cv.yml", OPENCV),
        ("cv.yml", RVEC),
    ],
)  # fmt: skip
def test_each_format(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    np.testing.assert_allclose(read_hand_eye(tmp_path / name), T, atol=1e-9)


def test_arrays(tmp_path):
    np.save(tmp_path / "a.npy", T)
    np.savez(tmp_path / "b.npz", R_cam2gripper=R, t_cam2gripper=T[:3, 3:])
    for name in ("a.npy", "b.npz"):
        np.testing.assert_allclose(read_hand_eye(tmp_path / name), T, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (EASY_HANDEYE.replace("false", "true"), "camera is on the hand"),
        (EASY_HANDEYE2.replace("eye_on_base", "eye_in_hand"), "camera is on the hand"),
        (EASY_HANDEYE.replace("x: 0.4", "x: 400.0"), "looks like millimetres"),
        (json.dumps((2 * T).tolist()), "no rigid transform"),
        (EASY_HANDEYE.replace("  qw", "  q0"), "cannot read a transform"),
        ("hello", "cannot read a transform"),
        ("", "cannot read a transform"),
    ],
)
def test_what_is_no_transform_is_refused(tmp_path, text, message):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(ReorientError, match=message):
        read_hand_eye(tmp_path / "a.yaml")
