"""Camera files as other tools write them, each by hand from its format's documentation (docs/formats.md)."""

import json
import logging
import pickle
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat

from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage
from reorient.imaging.distortion import Distortion
from reorient.imaging.files import read_camera, read_depth, write_depth
from reorient.imaging.intrinsic_fields import Intrinsics
from reorient.imaging.intrinsics import read_intrinsics
from reorient.imaging.matlab import read_mat

F, C, SIZE = (612.5, 610.25), (321.0, 238.5), (640, 480)
INTEGERS = Intrinsics(*F, C[0] + 0.5, C[1] + 0.5, *SIZE)  # a file that counts pixel centres at integers
HALVES = Intrinsics(*F, *C, *SIZE)  # a file that counts them at +0.5
K = [[F[0], 0, C[0]], [0, F[1], C[1]], [0, 0, 1]]
FLAT = [612.5, 0, 321, 0, 610.25, 238.5, 0, 0, 1]
BROWN = (0.1, -0.2, 0.001, 0.002, 0.05)


def without_size(**changes) -> Intrinsics:
    return Intrinsics(*F, C[0] + 0.5, C[1] + 0.5, **changes)


def bent(model, coefficients, **changes) -> Intrinsics:
    return Intrinsics(*F, C[0] + 0.5, C[1] + 0.5, *SIZE, distortion=Distortion(model, coefficients), **changes)


ROS1 = """\
header:
  seq: 7
  stamp: {secs: 100, nsecs: 5}
  frame_id: "depth_optical"
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.1, -0.2, 0.001, 0.002, 0.05]
K: [612.5, 0.0, 321.0, 0.0, 610.25, 238.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [600.0, 0.0, 320.0, 0.0, 0.0, 600.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""
ROS2 = ROS1.replace("D:", "d:").replace("K:", "k:").replace("R:", "r:").replace("P:", "p:")
CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [612.5, 0, 321, 0, 610.25, 238.5, 0, 0, 1]
distortion_model: rational_polynomial
distortion_coefficients:
  rows: 1
  cols: 8
  data: [0.1, -0.2, 0.001, 0.002, 0.05, 0.3, 0.2, 0.1]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [600, 0, 320, 0, 0, 600, 240, 0, 0, 0, 1, 0]
"""
OPENCV_YAML = """\
%YAML:1.0
---
calibration_time: "Tue 01 Dec 2020 10:00:00"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.1250000000000000e+02, 0., 3.2100000000000000e+02, 0.,
       6.1025000000000000e+02, 2.3850000000000000e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 1.0e-01, -2.0e-01, 1.0e-03, 2.0e-03, 5.0e-02 ]
avg_reprojection_error: 3.1e-01
"""
OPENCV_XML = """\
<?xml version="1.0"?>
<opencv_storage>
<calibration_time>"Tue 01 Dec 2020 10:00:00"</calibration_time>
<image_width>640</image_width>
<image_height>480</image_height>
<!-- flags: +fix_aspectRatio -->
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    612.5 0. 321. 0. 610.25 238.5 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>1</rows>
  <cols>4</cols>
  <dt>d</dt>
  <data>
    0.1 -0.02 0.003 0.004</data></distortion_coefficients>
<fisheye_model>1</fisheye_model>
</opencv_storage>
"""
OPENCV_JSON = {
    "cameraMatrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": FLAT},
    "dist_coeffs": {"type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d", "data": list(BROWN)},
    "image_size": [640, 480],
}
KALIBR = """\
cam0:
  camera_model: pinhole
  distortion_coeffs: [0.1, -0.2, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [612.5, 610.25, 321.0, 238.5]
  resolution: [640, 480]
  rostopic: /depth/image
"""
OPEN3D = {"width": 640, "height": 480, "intrinsic_matrix": [612.5, 0, 0, 0, 610.25, 0, 321, 238.5, 1]}
REALSENSE = {"width": 640, "height": 480, "ppx": 321.0, "ppy": 238.5, "fx": 612.5, "fy": 610.25}
VIEWER = """\
RS2_STREAM_DEPTH Frame Info:
Type,Depth
Format,Z16
Frame Number,34
Resolution x,640
Resolution y,480
Intrinsic:,
Fx,612.5
Fy,610.25
PPx,321.0
PPy,238.5
Distorsion,Brown Conrady
"""
ENUMERATE = """\
Intrinsic Parameters:

 Intrinsic of "Depth" / 640x480 / {Z16}
  Width:        640
  Height:       480
  PPX:          321
  PPY:          238.5
  Fx:           612.5
  Fy:           610.25
  Distortion:   Brown Conrady
  Coeffs:       0       0       0       0       0
  FOV (deg):    55.16 x 42.94

 Intrinsic of "Color" / 640x480 / {RGB8}
  Width:        640
  Height:       480
  PPX:          330
  PPY:          250
  Fx:           500
  Fy:           500
  Distortion:   Inverse Brown Conrady
  Coeffs:       0.1     -0.2    0.001   0.002   0.05
"""
BOP_CAMERA = {"cx": 321.0, "cy": 238.5, "depth_scale": 0.1, "fx": 612.5, "fy": 610.25, "height": 480, "width": 640}
BOP_SCENE = {"3": {"cam_K": FLAT, "depth_scale": 0.1, "cam_R_w2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "view_level": 0}}
AUTOLAB = {
    **{"_cx": 321.0, "_cy": 238.5, "_fx": 612.5, "_fy": 610.25, "_height": 480, "_width": 640, "_skew": 0.0, "_K": 0},
    "_frame": "phoxi",
}
NERF = {"camera_model": "OPENCV", "fl_x": 612.5, "fl_y": 610.25, "cx": 321.0, "cy": 238.5, "w": 640, "h": 480}
BROWN_SCALARS = dict(zip(("k1", "k2", "p1", "p2"), BROWN[:4], strict=True))
RATIONAL = {"k1": 0.5, "k2": -2.5, "k3": 1.3, "k4": 0.4, "k5": -2.3, "k6": 1.2, "p1": 0.001, "p2": 0.002}
RATIONAL_OPENCV = (0.5, -2.5, 0.001, 0.002, 1.3, 0.4, -2.3, 1.2)

FILES = {
    "K by rows": ("cam_K.txt", "612.5 0 321\n0 610.25 238.5\n0 0 1\n", without_size()),
    "K of numpy.savetxt": ("K.txt", "\n".join(" ".join(f"{x:.18e}" for x in row) for row in K), without_size()),
    "K in one line": ("K.txt", "# fx 0 cx ...\n" + " ".join(map(str, FLAT)), without_size()),
    "K as NumPy prints it": ("K.txt", str(np.array(K)), without_size()),
    "K as CSV": ("K.csv", "612.5,0,321\n0,610.25,238.5\n0,0,1\n", without_size()),
    "K as NumPy": ("K.npy", np.array(K), without_size()),
    "OpenCV's results as NumPy": (
        "c.npz",
        {"mtx": np.array(K), "dist": [BROWN]},
        without_size(distortion=Distortion("brown", BROWN)),
    ),
    "K in JSON": ("K.json", {"K": K, "width": 640, "height": 480}, INTEGERS),
    "K alone in JSON": ("K.json", K, without_size()),
    "ROS 1": ("info.yaml", ROS1, bent("brown", BROWN)),
    "ROS 2": ("info.yaml", ROS2, bent("brown", BROWN)),
    "ROS 1 by rostopic, no suffix of YAML": ("info.json", {"D": [], "K": FLAT, "width": 640, "height": 480}, INTEGERS),
    "ROS 2 in JSON": (
        "info.json",
        {"d": [0.1, 0.02, 0.003, 0.004], "k": FLAT, "width": 640, "height": 480, "distortion_model": "equidistant"},
        bent("fisheye", (0.1, 0.02, 0.003, 0.004)),
    ),
    "ROS with a window and binning": (
        "info.yaml",
        ROS1.replace("D: [0.1, -0.2, 0.001, 0.002, 0.05]", "D: []")
        .replace("binning_x: 0\nbinning_y: 0", "binning_x: 2\nbinning_y: 2")
        .replace(
            "x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0",
            "x_offset: 20\n  y_offset: 40\n  height: 400\n  width: 600",
        ),
        Intrinsics(F[0] / 2, F[1] / 2, (321.5 - 20) / 2, (239 - 40) / 2, 300, 200),
    ),
    "camera_calibration": ("ost.yaml", CALIBRATION, bent("brown", (*BROWN, 0.3, 0.2, 0.1))),
    "OpenCV YAML": ("camera.yml", OPENCV_YAML, bent("brown", BROWN)),
    "OpenCV YAML, older names": (
        "camera.yml",
        OPENCV_YAML.replace("camera_matrix", "Camera_Matrix").replace("distortion_coeff", "Distortion_Coeff"),
        bent("brown", BROWN),
    ),
    "OpenCV XML, fisheye": ("camera.xml", OPENCV_XML, bent("fisheye", (0.1, -0.02, 0.003, 0.004))),
    "OpenCV JSON": ("camera.json", OPENCV_JSON, bent("brown", BROWN)),
    "Kalibr": ("camchain.yaml", KALIBR, bent("brown", BROWN[:4])),
    "Open3D": ("intrinsic.json", OPEN3D, INTEGERS),
    "Open3D camera parameters": (
        "view.json",
        {"class_name": "PinholeCameraParameters", "extrinsic": [1.0] * 16, "intrinsic": OPEN3D, "version_major": 1},
        INTEGERS,
    ),
    "Open3D recorder": (
        "intrinsic.json",
        OPEN3D | {"depth_scale": 1000.0, "serial_number_": "1", "stream_length_usec": 5},
        without_size(width=640, height=480, scale_m=0.001),
    ),
    "RealSense": ("c.json", REALSENSE | {"model": "distortion.brown_conrady", "coeffs": [0.0] * 5}, INTEGERS),
    "RealSense, colour of a D455": (
        "c.json",
        REALSENSE | {"model": "inverse_brown_conrady", "coeffs": list(BROWN)},
        bent("modified", BROWN),
    ),
    "RealSense, model as number": ("c.json", REALSENSE | {"model": 4, "coeffs": list(BROWN)}, bent("brown", BROWN)),
    "RealSense, nested": (
        "c.json",
        {"depth": {"intrinsics": REALSENSE, "depth_scale": 0.00025}, "color": {"intrinsics": REALSENSE | {"ppx": 9}}},
        without_size(width=640, height=480, scale_m=0.00025),
    ),
    "RealSense, scale beside": (
        "c.json",
        {"intrinsics": REALSENSE, "depth_scale_mm": 0.5},
        without_size(width=640, height=480, scale_m=0.0005),
    ),
    "RealSense viewer": ("Depth_metadata.csv", VIEWER, INTEGERS),
    "rs-enumerate-devices -c": ("calibration.txt", ENUMERATE, INTEGERS),
    "BOP camera.json": ("camera.json", BOP_CAMERA, without_size(width=640, height=480, scale_m=0.0001)),
    "BOP scene_camera.json": ("scene_camera.json", BOP_SCENE, without_size(scale_m=0.0001)),
    "autolab_core": ("phoxi.intr", AUTOLAB, INTEGERS),
    "YCB-Video": (
        "000001-meta.mat",
        {"intrinsic_matrix": np.array(K), "factor_depth": np.array([[10000]]), "poses": np.zeros((3, 4, 2))},
        without_size(scale_m=0.0001),
    ),
    "Azure Kinect, by name": (
        "c.json",
        {"fx": F[0], "fy": F[1], "cx": C[0], "cy": C[1], "codx": 0, "cody": 0, "width": 640, "height": 480} | RATIONAL,
        bent("brown", RATIONAL_OPENCV),
    ),
    "nerfstudio": ("transforms.json", NERF | {"frames": []}, HALVES),
    "nerfstudio, distorted": (
        "transforms.json",
        NERF | BROWN_SCALARS | {"frames": []},
        Intrinsics(*F, *C, *SIZE, distortion=Distortion("brown", BROWN[:4])),
    ),
    "nerfstudio, fisheye": (
        "transforms.json",
        NERF | {"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.004},
        Intrinsics(*F, *C, *SIZE, distortion=Distortion("fisheye", (0.1, 0.02, 0.003, 0.004))),
    ),
    "reorient": ("c.json", {"width": 640, "height": 480, "fx": F[0], "fy": F[1], "cx": C[0], "cy": C[1]}, HALVES),
    "UTF-8 with byte-order mark": ("c.json", "\ufeff" + json.dumps(REALSENSE), INTEGERS),
    "numbers as text": ("c.json", {name: str(value) for name, value in REALSENSE.items()}, INTEGERS),
}


def written(folder, name, content):
    path = folder / name
    if name.endswith(".npy"):
        np.save(path, content)
    elif name.endswith(".npz"):
        np.savez(path, **content)
    elif name.endswith(".mat"):
        savemat(path, content)
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", FILES)
def test_intrinsics_of_every_tool(kind, tmp_path):
    name, content, expected = FILES[kind]
    assert read_intrinsics(written(tmp_path, name, content), SIZE) == expected


def test_there_are_thirty_of_them():
    assert len(FILES) >= 30


RAW = np.add.outer(np.arange(480), 2400 + np.arange(640)).astype(np.uint16)


@pytest.fixture
def frame(tmp_path):
    """A depth image of 640 x 480, 16 bits, as a camera writes it."""
    path = tmp_path / "000003.png"
    Image.fromarray(RAW).save(path)
    return path


@pytest.mark.parametrize("kind", FILES)
def test_a_depth_image_is_read_with_every_file(kind, frame, tmp_path):
    """With the file's own scale, and the size of the image where the file has none."""
    name, content, expected = FILES[kind]
    if expected.width == 300:
        pytest.skip("another size")
    image = read_depth(frame, written(tmp_path, name, content))
    camera = image.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (expected.fx, expected.fy, expected.cx, expected.cy)
    assert (camera.width, camera.height) == SIZE
    same = np.allclose(image.depth_m, RAW * (expected.scale_m or 0.001))
    assert same != bool(expected.distortion)  # undone, so no pixel keeps its place but the principal point
    row, column = int(camera.cy), int(camera.cx)
    assert image.depth_m[row, column] == pytest.approx(RAW[row, column] * (expected.scale_m or 0.001), rel=1e-3)


def test_the_scale_of_the_option_and_of_the_image_come_first(tmp_path, frame):
    camera = written(tmp_path, "camera.json", BOP_CAMERA)
    assert read_depth(frame, camera).depth_m[0, 0] == pytest.approx(0.24)
    assert read_depth(frame, camera, scale_m=0.0005).depth_m[0, 0] == pytest.approx(1.2)
    write_depth(tmp_path / "own.png", DepthImage(RAW * 0.0003, Camera(640, 480, 600, 600, 320, 240)), scale_m=0.0003)
    assert read_depth(tmp_path / "own.png", camera).depth_m[0, 0] == pytest.approx(0.72)


# --- several cameras ------------------------------------------------------------------------------------------------

SCENE = {str(n): {"cam_K": [600 + n, 0, 321, 0, 600, 238.5, 0, 0, 1], "depth_scale": 1.0} for n in (3, 7, 12)}


def test_the_image_number_chooses_the_frame(tmp_path, frame):
    path = written(tmp_path, "scene_camera.json", SCENE)
    assert read_depth(frame, path).camera.fx == 603
    assert read_depth(frame, f"{path}#12").camera.fx == 612
    with pytest.raises(ReorientError, match="no camera '4': expected one of 3, 7, 12"):
        read_depth(frame, f"{path}#4")
    other = frame.rename(tmp_path / "now.png")
    with pytest.raises(ReorientError, match="several cameras: 3, 7, 12; expected one, chosen as FILE#NAME"):
        read_depth(other, path)


def test_frames_with_the_same_camera_need_no_number(tmp_path):
    same = {str(n): BOP_SCENE["3"] for n in range(4)}
    assert read_intrinsics(written(tmp_path, "s.json", same)) == without_size(scale_m=0.0001)


def test_frames_of_nerfstudio_are_named_by_their_picture(tmp_path):
    one = {name: value for name, value in NERF.items() if name not in ("fl_x",)}
    frames = [{"file_path": f"images/{n:05d}.png", "fl_x": 600.0 + n, "fl_y": 610.25} for n in range(3)]
    path = written(tmp_path, "transforms.json", {**one, "frames": frames})
    assert read_intrinsics(path, image="depth/00002.png").fx == 602


def test_the_size_of_the_image_chooses_the_stream(tmp_path):
    streams = [REALSENSE | {"width": w, "height": h, "fx": float(w)} for w, h in ((640, 480), (1280, 720))]
    path = written(tmp_path, "c.json", {"streams": streams})
    assert read_intrinsics(path, (1280, 720)).fx == 1280
    assert read_intrinsics(path, (640, 480)).fx == 640


# --- another resolution ---------------------------------------------------------------------------------------------


def test_intrinsics_are_read_once_for_many_images(tmp_path, frame):
    intrinsics = read_intrinsics(written(tmp_path, "camera.json", BOP_CAMERA))
    assert read_depth(frame, intrinsics).depth_m[0, 0] == pytest.approx(0.24)
    with pytest.raises(ReorientError, match="the camera' is for 1280 x 720 px"):
        read_depth(frame, replace(intrinsics, width=1280, height=720))


def test_another_resolution_is_scaled_and_noted(tmp_path, frame, caplog):
    path = written(tmp_path, "c.json", REALSENSE | {"width": 1280, "height": 960})
    with caplog.at_level(logging.WARNING):
        camera = read_depth(frame, path).camera
    assert camera == Camera(640, 480, F[0] / 2, F[1] / 2, (C[0] + 0.5) / 2, (C[1] + 0.5) / 2)
    assert "is for 1280 x 960 px, scaled by 0.5 to the 640 x 480 px" in caplog.text


def test_another_aspect_ratio_is_refused(tmp_path, frame):
    path = written(tmp_path, "c.json", REALSENSE | {"width": 1280, "height": 720})
    with pytest.raises(ReorientError, match="is for 1280 x 720 px, .* has 640 x 480, another aspect ratio"):
        read_depth(frame, path)


def test_a_principal_point_beyond_an_image_of_unknown_size_is_refused(tmp_path, frame, caplog):
    path = written(tmp_path, "K.txt", "900 0 641\n0 900 360\n0 0 1")
    with pytest.raises(ReorientError, match=r"principal point at .641.5, 360.5., beyond the 640 x 480 px"):
        read_depth(frame, path)
    path.write_text("900 0 600\n0 900 360\n0 0 1")
    read_depth(frame, path)
    assert "far from the centre" in caplog.text


def test_normalised_intrinsics_are_refused(tmp_path, frame):
    path = written(tmp_path, "c.json", {"fx": 0.9, "fy": 1.2, "cx": 0.5, "cy": 0.5})
    with pytest.raises(ReorientError, match=r"focal lengths \(0.9, 1.2\): expected pixels; multiply normalised"):
        read_depth(frame, path)


# --- lens distortion is never ignored -------------------------------------------------------------------------------

PLAIN = {"width": 640, "height": 480, "fx": 612.5, "fy": 610.25, "cx": 321.0, "cy": 238.5}


@pytest.mark.parametrize(
    "stated",
    [
        {"coeffs": BROWN},
        {"D": BROWN},
        {"distortion": BROWN},
        {"distortion": {"k1": 0.1, "k2": -0.2, "p1": 0.001, "p2": 0.002, "k3": 0.05}},
        {"distortion": {"model": "brown", "coefficients": None, "coeffs": BROWN}},
        {"dist_coeffs": [BROWN]},
        {"distortion_coefficients": {"rows": 1, "cols": 5, "data": BROWN}},
        {"distortion_params": BROWN},
        {"k1": 0.1, "k2": -0.2, "p1": 0.001, "p2": 0.002, "k3": 0.05},
        {"K1": "0.1", "K2": -0.2, "P1": 0.001, "P2": 0.002, "K3": 0.05},
    ],
)
def test_distortion_is_understood_in_every_spelling(stated, tmp_path):
    path = written(tmp_path, "c.json", PLAIN | stated)
    assert read_intrinsics(path).distortion == Distortion("brown", BROWN)
    with pytest.raises(ReorientError, match="states lens distortion: expected an undistorted camera"):
        read_camera(path)


@pytest.mark.parametrize(
    "stated",
    [
        {"lens_distortion": BROWN},
        {"radial_distortion": [0.1]},
        {"RadialDistortion": 0.1},
        {"distortion": {"a": 0.1}},
        {"distortion": {"radial": [0.1, 0.2]}},
        {"distortion_model": "omnidirectional", "D": BROWN},
        {"model": "ftheta", "coeffs": BROWN},
        {"model": "none", "coeffs": BROWN},
        {"k4": 0.1},
        {"k7": 0.1},
        {"xi": 1.2},
        {"skew": 0.4},
        {"coeffs": [0.1] * 14},
        {"coeffs": [1e300]},
        {"coeffs": [float("nan")]},
        {"codx": 0.01, **RATIONAL},
        {"D": BROWN, "distortion_coefficients_right": [0.1]},
    ],
)
def test_distortion_of_unknown_meaning_is_refused(stated, tmp_path):
    with pytest.raises(ReorientError, match="distortion"):
        read_intrinsics(written(tmp_path, "c.json", PLAIN | stated))


@pytest.mark.parametrize("stated", [{"D": []}, {"coeffs": [0] * 5}, {"model": "ftheta", "coeffs": [0] * 5}, {"k1": 0}])
def test_no_distortion_is_none(stated, tmp_path):
    assert read_camera(written(tmp_path, "c.json", PLAIN | stated)).fx == F[0]


# --- Azure Kinect ---------------------------------------------------------------------------------------------------


def azure(**changes) -> dict:
    """The raw calibration, values over the sensor's size: cx cy fx fy k1..k6 codx cody p2 p1."""
    lens = {"ModelType": "CALIBRATION_LensDistortionModelBrownConrady", "ModelParameterCount": 14} | changes
    depth = {"ModelParameters": [0.51, 0.52, 0.49, 0.48, 0.5, -2.5, 1.3, 0.4, -2.3, 1.2, 0, 0, 0.002, 0.001]} | lens
    color = {"ModelParameters": [0.5, 0.5, 0.48, 0.64, *[0.0] * 10]} | lens
    cameras = [
        {"Intrinsics": depth, "Location": "CALIBRATION_CameraLocationD0", "SensorWidth": 1024, "SensorHeight": 1024},
        {"Intrinsics": color, "Location": "CALIBRATION_CameraLocationPV0", "SensorWidth": 4096, "SensorHeight": 3072},
    ]
    return {"CalibrationInformation": {"Cameras": cameras}}


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((640, 576), (0.49 * 1024, 0.48 * 1024, 0.51 * 1024 - 192, 0.52 * 1024 - 180)),
        ((320, 288), (0.49 * 512, 0.48 * 512, 0.51 * 512 - 96, 0.52 * 512 - 90)),
        ((1024, 1024), (0.49 * 1024, 0.48 * 1024, 0.51 * 1024, 0.52 * 1024)),
        ((1920, 1080), (0.48 * 1920, 0.64 * 1440, 960.0, 720.0 - 180)),
    ],
)
def test_the_azure_kinect_shows_a_part_of_its_sensor(size, expected, tmp_path):
    found = read_intrinsics(written(tmp_path, "calibration.json", azure()), size)
    assert (found.fx, found.fy, found.cx, found.cy) == pytest.approx(expected)
    assert (found.width, found.height) == size
    if size[0] <= 1024:
        assert found.distortion == Distortion("brown", RATIONAL_OPENCV)


def test_an_azure_kinect_file_that_does_not_fit_is_refused(tmp_path):
    path = written(tmp_path, "calibration.json", azure())
    with pytest.raises(ReorientError, match="no mode of an Azure Kinect has 700 x 500 px"):
        read_intrinsics(path, (700, 500))
    with pytest.raises(ReorientError, match="expected an image size"):
        read_intrinsics(path)
    with pytest.raises(ReorientError, match="lens distortion .* of model 'CALIBRATION_LensDistortionModelTheta'"):
        read_intrinsics(
            written(tmp_path, "c.json", azure(ModelType="CALIBRATION_LensDistortionModelTheta")), (640, 576)
        )


# --- broken files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("deep.json", "[" * 20000 + "]" * 20000, "nested too deep"),
        ("deep.json", '{"a":' * 20000 + "1" + "}" * 20000, "nested too deep"),
        ("deep.yaml", "[" * 1500 + "]" * 1500, "nested too deep"),
        ("digits.json", '{"fx": ' + "1" * 5000 + "}", "not JSON .Exceeds the limit"),
        ("digits.yaml", "fx: " + "1" * 5000, "cannot read camera file"),
        ("large.json", PLAIN | {"fx": 10**400}, "is no number|expected finite"),
        ("tiny.json", PLAIN | {"fx": 1e-308}, "fx=1e-308.*expected finite pixels"),
        ("scale.json", PLAIN | {"depth_scale": 1e-300}, "depth_scale 1e-300: expected metres per unit"),
        (
            "scale.json",
            REALSENSE | {"depth_scale": 0.001, "depth_units": 0.0001},
            r"depthunits \(0.0001 m\) and depth_scale \(0.001 m\) contradict each other: expected one depth scale",
        ),
        ("scale.json", PLAIN | {"depth_scale": 30}, "depth_scale 30: expected metres per unit"),
        ("scale.json", PLAIN | {"depth_scale": -1}, "depth_scale.*expected a number above 0"),
        ("alias.yaml", "a: &a [1]\nb: *a\n", "has a YAML alias"),
        ("tag.yaml", "a: !!python/object/apply:os.system [true]", "cannot read camera file"),
        ("entity.xml", '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "has an XML document type"),
        ("cut.xml", OPENCV_XML[:200], "cannot read camera file"),
        ("cut.yaml", "K: [1, 2", "cannot read camera file"),
        (
            "roi.yaml",
            ROS1.replace("x_offset: 0", "x_offset: .inf").replace("  width: 0", "  width: 5"),
            "inf px: expected",
        ),
        ("roi.yaml", ROS1.replace("binning_x: 0", "binning_x: 1.0e+300"), "px: expected a whole number"),
        ("zero.yaml", ROS1.replace("612.5", "0.0"), "expected finite pixels, fx, fy > 0"),
        ("skew.txt", "612.5 3 321\n0 610.25 238.5\n0 0 1", "without skew"),
        ("four.txt", "1 2 3 4", "missing intrinsics"),
        ("empty.txt", "", "missing intrinsics"),
        ("prose.txt", "the camera is good", "missing intrinsics"),
    ],
)
def test_broken_camera_files_are_refused_in_one_line(name, content, message, tmp_path):
    with pytest.raises(ReorientError, match=message) as caught:
        read_camera(written(tmp_path, name, content), *SIZE)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_a_pickle_is_named_and_not_loaded(tmp_path):
    for name in ("K.pkl", "K.npy", "K.json"):
        (tmp_path / name).write_bytes(pickle.dumps(K))
        with pytest.raises(ReorientError, match="is a pickle, which can run code"):
            read_camera(tmp_path / name)


@pytest.mark.parametrize("compressed", [True, False])
def test_matlab_files_hold_matrices_of_any_number(compressed, tmp_path, rng):
    """As scipy writes them; whatever is no matrix of numbers beside them is left out."""
    path = tmp_path / "meta.mat"
    several = {
        "a": rng.normal(size=(3, 4)),
        "b": rng.integers(-5, 5, (2, 3, 4)).astype(np.int16),
        "c": np.float32([[1.5]]),
        "text": "words",
        "cell": np.array([1, "x"], object),
        "factor_depth": 1000,
    }
    savemat(path, several, do_compression=compressed)
    found = read_mat(path.read_bytes())
    assert set(found) == {"a", "b", "c", "factor_depth"}
    for name in ("a", "b", "c"):
        assert np.array_equal(found[name], several[name])
    assert found["factor_depth"].item() == 1000
    whole = path.read_bytes()
    for share in (0.1, 0.5, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ReorientError, match="expected"):
            read_camera(path)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(600))
    with pytest.raises(ReorientError, match="is a MATLAB 7.3 file: expected one saved with -v7"):
        read_camera(path)


def test_a_size_for_a_file_without_one(tmp_path):
    path = written(tmp_path, "cam_K.txt", "612.5 0 321\n0 610.25 238.5\n0 0 1")
    assert read_camera(path, *SIZE) == Camera.from_K(np.array(K), *SIZE)
    with pytest.raises(ReorientError, match="no image size: expected width and height"):
        read_camera(path)
