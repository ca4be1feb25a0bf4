"""The readers that ``fuzz.py`` fuzzes, and valid inputs of each, made by code."""

import gzip
import io
import json
import re
import shlex
import struct
import tempfile
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from fuzz import Files, Target
from PIL import Image

from reorient import Camera, DepthImage, so3
from reorient.errors import ReorientError
from reorient.imaging import Goal, GoalView

CAMERA = Camera(24, 18, 40.0, 41.0, 12.5, 9.0)
K = [[40.0, 0.0, 12.0], [0.0, 41.0, 8.5], [0.0, 0.0, 1.0]]
T_BASE_CAMERA = [[0.0, -1.0, 0.0, 0.4], [-1.0, 0.0, 0.0, 0.1], [0.0, 0.0, -1.0, 0.8], [0.0, 0.0, 0.0, 1.0]]


def _written(write: Callable[[Path], object], *names: str) -> list[Files]:
    """What a function writes as each of these names."""
    seeds = []
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder) / name)
            seeds.append(_files(Path(folder)))
    return seeds


def _files(folder: Path) -> Files:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _only(folder: Path) -> Path:
    """The file of an input of one file."""
    return next(path for path in folder.iterdir() if path.is_file())


def _bytes(save: Callable[[Any], object]) -> bytes:
    stream = io.BytesIO()
    save(stream)
    return stream.getvalue()


def _npz(**arrays: Any) -> bytes:
    return _bytes(lambda stream: np.savez(stream, **arrays))


def _npy(array: Any) -> bytes:
    return _bytes(lambda stream: np.save(stream, array))


def _json(data: Any) -> bytes:
    return json.dumps(data).encode()


def _depth_m() -> np.ndarray:
    depth_m = np.zeros((18, 24), np.float32)
    rows, columns = np.mgrid[5:13, 7:19]
    depth_m[rows, columns] = 0.6 + 0.002 * rows + 0.001 * (columns - 12) ** 2
    return depth_m


def _image(stamp_s: float | None = 1.5) -> DepthImage:
    unknown = np.zeros((18, 24), bool)
    unknown[2, 3] = True
    return DepthImage(_depth_m(), CAMERA, stamp_s, unknown)


# --- images ---------------------------------------------------------------------------------------------------------


def _depth_seeds() -> list[Files]:
    from reorient.imaging.files import write_depth

    units = np.rint(_depth_m() * 1000).astype(">u2")
    points = CAMERA.rays() * _depth_m()[..., None]
    rows = "\n".join(" ".join(f"{x:.4f}" for x in point) for point in points.reshape(-1, 3))
    cloud = points.reshape(-1, 3).astype("<f4").tobytes()
    pcd = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 24\nHEIGHT 18\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 432\nDATA {}\n"
    )
    ply = "ply\nformat {} 1.0\nobj_info num_cols 24\nobj_info num_rows 18\nelement vertex 432\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    columns = points.reshape(-1, 3).T.astype("<f4").tobytes()
    literal = b"".join(bytes([len(run) - 1]) + run for run in (columns[i : i + 32] for i in range(0, len(columns), 32)))
    packed = struct.pack("<II", len(literal), len(columns)) + literal
    texts: Files = {
        "image.pgm": b"P5\n# made by code\n24 18\n65535\n" + units.tobytes(),
        "IMAGE.PGM": b"P2 24 18 65535\n" + " ".join(map(str, units.ravel().tolist())).encode(),
        "image.pfm": b"Pf\n24 18\n-1.0\n" + _depth_m()[::-1].astype("<f4").tobytes(),
        "points.pcd": pcd.format("ascii").encode() + rows.encode(),
        "binary.pcd": pcd.format("binary").encode() + cloud,
        "packed.pcd": pcd.format("binary_compressed").encode() + packed,
        "points.ply": (ply.format("ascii") + "end_header\n" + rows + "\n").encode(),
        "binary.ply": (ply.format("binary_little_endian") + "end_header\n").encode() + cloud,
        "points.npy": _npy(points),
        "units.npy": _npy(np.asarray(units, np.uint16)),
        "one.npz": _npz(anything=_depth_m()),
        "big.tiff": _bytes(lambda stream: Image.fromarray(np.asarray(units, np.uint16)).save(stream, "TIFF")),
    }
    seeds = _written(lambda path: write_depth(path, _image()), "image.png", "image.npz", "image.npy", "image.tif")
    return seeds + [{name: data} for name, data in texts.items()]


def _exr_seeds() -> list[Files]:
    openexr = import_module("OpenEXR")
    header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
    return _written(lambda path: openexr.File(header, {"Z": _depth_m()}).write(str(path)), "image.exr")


def _read_depth(folder: Path) -> object:
    from reorient.imaging import Isolation
    from reorient.imaging.files import read_depth

    return Isolation(remove_plane=True)(read_depth(_only(folder), CAMERA))


def _mask_seeds() -> list[Files]:
    mask = _depth_m() > 0
    rgba = np.dstack([np.full((18, 24, 3), 7, np.uint8), np.where(mask, 255, 0).astype(np.uint8)])
    pictures = {
        "mask.png": mask,
        "cut.png": rgba,
        "mask.bmp": mask,
        "mask.tif": mask.astype(np.uint8),
        "mask.jpg": None,
    }
    seeds: list[Files] = [{"mask.npy": _npy(mask)}]
    for name, array in pictures.items():
        picture = Image.fromarray(np.uint8(255) * mask if array is None else array)
        seeds += _written(lambda path, picture=picture: picture.save(path), name)  # type: ignore[misc]
    return seeds


def _read_mask(folder: Path) -> object:
    from reorient.imaging import isolate
    from reorient.imaging.files import read_mask

    return isolate(_image(), read_mask(_only(folder)))


# --- cameras and transforms -----------------------------------------------------------------------------------------


def _mat(**matrices: np.ndarray) -> bytes:
    from scipy.io import savemat

    return _bytes(lambda stream: savemat(stream, matrices, do_compression=True))


def _camera_seeds() -> list[Files]:
    own = {"width": 24, "height": 18, "fx": 40.0, "fy": 41.0, "cx": 12.5, "cy": 9.0, "pixel_centers_at": 0.5}
    ros = (
        "image_width: 24\nimage_height: 18\ncamera_name: depth\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [40, 0, "
        "12, 0, 41, 8.5, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  "
        "data: [0.01, -0.02, 0, 0, 0.001]\nroi: {x_offset: 0, y_offset: 0, width: 0, height: 0}\nbinning_x: 1\n"
    )
    opencv = (
        '<?xml version="1.0"?>\n<opencv_storage><image_width>24</image_width><image_height>18</image_height>'
        '<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>40. 0. 12. 0. 41. 8.5 0. '
        "0. 1.</data></camera_matrix></opencv_storage>\n"
    )
    bop = {"0": {"cam_K": np.ravel(K).tolist(), "depth_scale": 0.1}, "3": {"cam_K": np.ravel(K).tolist()}}
    realsense = {"width": 24, "height": 18, "ppx": 12.0, "ppy": 8.5, "fx": 40.0, "fy": 41.0, "model": 4}
    open3d = {"width": 24, "height": 18, "intrinsic_matrix": [40, 0, 0, 0, 41, 0, 12, 8.5, 1]}
    nerf = {
        "fl_x": 40.0,
        "fl_y": 41.0,
        "cx": 12.5,
        "cy": 9.0,
        "w": 24,
        "h": 18,
        "k1": 0.01,
        "frames": [{"file_path": "1"}],
    }
    azure = {
        "CalibrationInformation": {
            "Cameras": [
                {
                    "Location": "CALIBRATION_CameraLocationD0",
                    "Intrinsics": {
                        "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
                        "ModelParameters": [0.5, 0.5, 0.49, 0.49, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0, 0, 0.0001, 0.0001],
                    },
                }
            ]
        }
    }
    documents = {
        "own": own, "bop": bop, "rs": {**realsense, "coeffs": [0.1, -0.1, 0, 0, 0]}, "open3d": open3d, "nerf": nerf,
        "azure": azure,
        "k": {"K": K, "D": [0.1, -0.1, 0, 0], "distortion_model": "equidistant", "width": 24, "height": 18},
    }  # fmt: skip
    texts: Files = {
        "ros.yaml": ros.encode(),
        "opencv.xml": opencv.encode(),
        "opencv.yml": b"%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [40., 0., 12., "
        b"0., 41., 8.5, 0., 0., 1.]\n",
        "k.txt": b"40 0 12\n0 41 8.5\n0 0 1\n",
        "words.txt": b"Depth\n  Width: 24\n  Height: 18\n  PPX: 12\n  PPY: 8.5\n  Fx: 40\n  Fy: 41\n  Coeffs: 0 0\n",
        "k.npy": _npy(np.array(K)),
        "k.npz": _npz(K=np.array(K), D=np.zeros(5), width=24, height=18),
        "k.mat": _mat(cam_K=np.array(K), depth_scale=np.array([[0.001]])),
        "autolab.intr": _json({**own, "_cx": 12.0, "_frame": "camera"}),
    }
    return [{f"{name}.json": _json(data)} for name, data in documents.items()] + [{k: v} for k, v in texts.items()]


def _read_camera(folder: Path) -> object:
    """As for an image of the camera's size, and without one."""
    from reorient.imaging.files import read_camera, read_depth
    from reorient.imaging.intrinsics import read_intrinsics

    file = _only(folder)
    size = (640, 576) if b"CalibrationInformation" in file.read_bytes() else (24, 18)
    number = "000003.npy"  # of an image, which chooses among the cameras of a BOP scene
    read_intrinsics(file, size, number)
    if size == (24, 18):
        image = folder / number
        np.save(image, _depth_m())
        try:
            read_depth(image, file)
        finally:
            image.unlink()
        _refused(lambda: read_camera(file, *size))
    return None


def _refused(call: Callable[[], object]) -> None:
    """Call something that may refuse where the reader before did not."""
    try:
        call()
    except ReorientError:
        return


def _hand_eye_seeds() -> list[Files]:
    x, y, z, w = 0.7071068, -0.7071068, 0.0, 0.0
    ros = {"translation": {"x": 0.4, "y": 0.1, "z": 0.8}, "rotation": {"x": x, "y": y, "z": z, "w": w}}
    easy = (
        "parameters:\n  eye_on_hand: false\n  robot_base_frame: base\ntransformation:\n  qw: 0.0\n  qx: 0.7071068\n"
        "  qy: -0.7071068\n  qz: 0.0\n  x: 0.4\n  y: 0.1\n  z: 0.8\n"
    )
    opencv = (
        "%YAML:1.0\n---\nR: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 0., -1., 0., -1., 0., 0., "
        "0., 0., -1. ]\nt: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 0.4, 0.1, 0.8 ]\n"
    )
    texts: Files = {
        "T.npy": _npy(np.array(T_BASE_CAMERA)),
        "T.npz": _npz(R=np.array(T_BASE_CAMERA)[:3, :3], t=np.array([0.4, 0.1, 0.8])),
        "T.json": _json(T_BASE_CAMERA),
        "T.txt": "\n".join(" ".join(map(str, row)) for row in T_BASE_CAMERA).encode(),
        "ros.json": _json({"transform": ros}),
        "easy.yaml": easy.encode(),
        "opencv.yaml": opencv.encode(),
        "static.txt": b"0.4 0.1 0.8 0.7071068 -0.7071068 0 0\n",
        "rt.json": _json({"rvec": [0.1, 0.2, 0.3], "tvec": [0.4, 0.1, 0.8]}),
    }
    return [{name: data} for name, data in texts.items()]


def _read_hand_eye(folder: Path) -> object:
    from reorient.perception.extrinsics import read_hand_eye

    return read_hand_eye(_only(folder))


def _calibration_seeds() -> list[Files]:
    robot = {"T_base_camera": T_BASE_CAMERA, "p_tool_object_m": [0.0, 0.01, 0.1], "residual_deg": 0.1, "motions": 8}
    camera = {"width": 24, "height": 18, "fx": 40.0, "fy": 41.0, "cx": 12.5, "cy": 9.0}
    cell = {name: {"camera": camera, "T_world_camera": T_BASE_CAMERA} for name in ("depth", "color")}
    return [{"robot.json": _json(robot)}, {"cell.json": _json(cell)}]


def _read_calibration(folder: Path) -> object:
    from reorient.perception.calibration import read_calibration
    from reorient.perception.robot_calibration import read_robot_calibration

    file = _only(folder)
    return read_robot_calibration(file) if file.name == "robot.json" else read_calibration(file)


def _poses_seeds() -> list[Files]:
    return [
        {"poses.csv": b"x,y,z,qw,qx,qy,qz\n0.4,0.1,0.2,1,0,0,0\n0.3,0.1,0.2,0,1,0,0  # comment\n"},
        {"poses.csv": b"0.4 0.1 0.2 1 0 0 0\n"},
        {"poses.csv": b"1;0;0;0.1;0;1;0;0.2;0;0;1;0.3;0;0;0;1\n"},
        {"poses.csv": "\n".join(" ".join(map(str, row)) for row in T_BASE_CAMERA).encode()},
    ]


def _read_poses(folder: Path) -> object:
    from reorient.perception.transfer import read_tool_poses

    return read_tool_poses(_only(folder))


def _robot_seeds() -> list[Files]:
    from reorient.stations.robot_file import TEMPLATE

    own = """calibration = "calibration.json"
[camera]
driver = "folder"
frames = "."
timeout_s = 0.01
[arm]
driver = "simulated"
[tool]
point_m = [0.0, 0.0, 0.1]
[isolation]
box_px = [10, 10, 100, 100]
near_m = 0.3
far_m = 0.9
remove_plane = true
[limits]
box_low_m = [0.2, -0.4, 0.1]
box_high_m = [0.7, 0.4, 0.8]
max_step_deg = 30.0
settle_s = 0.15
"""
    calibration = _calibration_seeds()[0]["robot.json"]
    return [{"robot.toml": text.encode(), "calibration.json": calibration} for text in (TEMPLATE, own)]


def _read_robot(folder: Path) -> object:
    from reorient.stations.robot_file import read_robot_file

    robot = read_robot_file(folder / "robot.toml")
    robot.read_calibration()
    if robot.camera["driver"] == "folder":
        robot.open_camera()
    return robot


# --- goals, records, runs -------------------------------------------------------------------------------------------


def _goal() -> Goal:
    R = so3.exp(np.array([0.0, 0.5, 0.0]))
    return Goal(_image(), (GoalView(_image(), R, np.array([0.0, 0.0, 0.01])), GoalView(_image(None), R.T, None)))


def _goal_seeds() -> list[Files]:
    from reorient.imaging.goal_files import write_goal

    seeds = _written(lambda path: write_goal(path, _goal(), {"made": "by code"}), "goal.npz")
    return seeds + _written(lambda path: write_goal(path, Goal(_image())), "goal.npz", "goal.png")


def _read_goal(folder: Path) -> object:
    from reorient.imaging.goal_files import read_goal, read_provenance

    return read_goal(_only(folder)), read_provenance(_only(folder))


def _record_seeds() -> list[Files]:
    """A record of two moves."""
    from reorient.controller import OrientResult
    from reorient.stations.replay import RecordingStation

    about = {
        "estimator": "gicp", "strategy": {"strategy": "fusing", "max_images": 9}, "limits": {"max_step_deg": 30.0},
    }  # fmt: skip

    def station(**more: Any) -> Any:
        return SimpleNamespace(
            pivot_m=np.array([0.0, 0.0, 0.61]), capture=_image, rotate=lambda R: R, reachable=lambda R: True, **more
        )

    def write(path: Path) -> None:
        recorder = RecordingStation(station(clock_s=lambda: 3.0), path.parent, _goal(), about)
        for angle in (0.3, 0.2):
            recorder.capture()
            recorder.reachable(so3.exp(np.array([0.0, 0.0, angle])))
            recorder.rotate(so3.exp(np.array([0.0, 0.0, angle])))
        recorder.capture()
        recorder.finish(OrientResult((), "converged", "by code", None))

    return _written(write, "record.json")


def _read_record(folder: Path) -> object:
    from reorient.cli.robot import Replay
    from reorient.stations.replay import ReplayedStation

    station = ReplayedStation(folder)
    station.goal()
    for act in station.record["acts"][:50]:
        if "rotate" in act:
            R_step = np.array(act["rotate"], float)
            if hasattr(station, "reachable"):
                _refused(partial(station.reachable, R_step))
            _refused(partial(station.rotate, R_step))
        else:
            _refused(station.capture)
    return Replay(folder)._loop()


def _rows(columns: list[str], count: int, **cells: Any) -> bytes:
    lines = [",".join(columns)]
    lines += [",".join(str(cells.get(column, k % 7)) for column in columns) for k in range(count)]
    return gzip.compress(("\r\n".join(lines) + "\r\n").encode(), mtime=0)


def _run_seeds() -> list[Files]:
    from reorient.experiments.cells import COLUMNS
    from reorient.experiments.evaluation import Evaluation
    from reorient.experiments.loops import COLUMNS as LOOP_COLUMNS

    config = _json({"config": json.loads(json.dumps(asdict(Evaluation()), default=str)), "version": "0"})
    evaluation = _rows(COLUMNS, 6, message="", world="benchmark", estimator="gicp", confidence="0.5", overlap="0.7")
    loops = _rows(LOOP_COLUMNS, 6, start_deg="any", status="converged", estimator="default", strategy="fusing")
    partial = b"".join(_json({"task": str(k), "rows": [{"a": "1", "b": "x"}]}) + b"\n" for k in range(3))
    return [
        {"config.json": config, "rows.csv.gz": evaluation},
        {"loops/rows.csv.gz": loops},
        {"partial/partial.jsonl": partial},
    ]


def _read_run(folder: Path) -> object:
    from reorient.experiments.evaluation import read_config
    from reorient.reporting import markdown_table, read_rows
    from reorient.reporting.loop_tables import markdown_loops, read_loop_rows
    from reorient.reporting.tables import OVERLAP, html_table
    from reorient.runs.run import RowStore

    if (folder / "loops").is_dir():
        return markdown_loops(read_loop_rows(folder / "loops"))
    if (folder / "partial").is_dir():
        return RowStore().done(folder / "partial")
    rows = read_rows(folder)
    return read_config(folder), markdown_table(rows), html_table(rows, OVERLAP)


def _names_seeds() -> list[Files]:
    return [{"names.txt": b"generated-0-000001\ngenerated-0-000003\r\n\n"}]


def _read_names(folder: Path) -> object:
    from reorient.world.objects import ObjectSource

    return ObjectSource(only=_only(folder)).open()


def _log_seeds() -> list[Files]:
    from reorient.controller.guide_log import COLUMNS

    return [{"log.csv": f"{','.join(COLUMNS)}\n2026-01-01,part,matched,30,2,0.5,0.99,9,0\n".encode()}]


def _read_log(folder: Path) -> object:
    from reorient.controller.guide_log import GuideLog

    return GuideLog(_only(folder))


# --- meshes and datasets --------------------------------------------------------------------------------------------


def _mesh_seeds() -> list[Files]:
    import trimesh

    solid = trimesh.creation.box(extents=(0.1, 0.2, 0.3))
    seeds = _written(lambda path: solid.export(path), "a.stl", "a.obj", "a.ply", "a.off", "a.glb")
    text: Any = solid.export(file_type="stl_ascii")
    ascii_ply: Any = trimesh.exchange.ply.export_ply(solid, encoding="ascii")
    return [
        *seeds,
        {"a.npz": _npz(v=solid.vertices, f=solid.faces)},
        {"ascii.stl": text.encode()},
        {"ascii.ply": ascii_ply},
        {"a.OBJ": b"# caf\xe9\nmtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nf 1/1 2/1 3/1\nf 1 3 4\n"},
    ]


def _read_mesh(folder: Path) -> object:
    from reorient.world.meshes import load_mesh, scale_to_radius

    return scale_to_radius(load_mesh(_only(folder)), 0.1)


def _bop_seeds() -> list[Files]:
    from reorient.imaging.files import write_depth

    pose = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0.0, 0.0, 610.0], "obj_id": 1}
    scene = {
        "scene_gt.json": _json({"0": [pose], "1": [pose]}),
        "scene_gt_info.json": _json({"0": [{"visib_fract": 0.9}], "1": [{"visib_fract": 1}]}),
        "scene_camera.json": _json(
            {k: {"cam_K": np.ravel(K).tolist(), "depth_scale": 1.0, "width": 24, "height": 18} for k in ("0", "1")}
        ),
    }
    depth = _written(lambda path: write_depth(path, _image(), 0.001), "0.png")[0]["0.png"]
    mask = _bytes(lambda stream: Image.fromarray(_depth_m() > 0).save(stream, "PNG"))
    files = {f"test/000001/{name}": data for name, data in scene.items()}
    files |= {f"test/000001/depth/00000{k}.png": depth for k in (0, 1)}
    files |= {f"test/000001/mask_visib/00000{k}_000000.png": mask for k in (0, 1)}
    corner = b"0 0 0\n100 0 0\n0 100 0\n0 0 100\n"
    header = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    faces = b"element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    models = header + faces + corner + b"3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
    symmetries = {
        "symmetries_discrete": [np.eye(4).ravel().tolist()],
        "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}],
    }
    files |= {
        "models/obj_000001.ply": models,
        "models/models_info.json": _json({"1": {"diameter": 141.4, **symmetries}}),
        "pairs.csv": b"scene_id,obj_id,im_id,im_id_goal,gt_id\n1,1,0,1,0\n",
    }
    return [files]


def _read_bop(folder: Path) -> object:
    from reorient.experiments import bop_data
    from reorient.experiments.bop import _listed_pairs

    bop_data._scene.cache_clear()
    bop_data.load_model.cache_clear()
    found = bop_data.views(folder, "test", ())
    model = bop_data.load_model(folder, 1)
    for first, second in _listed_pairs(folder / "pairs.csv", found):
        for view in (first, second):
            view.depth(), model.rotation_error(view.pose()[:3, :3], np.eye(3)), model.mssd_m(view.pose(), np.eye(4))
    return None


# --- weights and training -------------------------------------------------------------------------------------------


def _trees_seeds() -> list[Files]:
    """A verifier of one tree, and one shard of its data."""
    from reorient.estimators.verifier import FEATURES

    trees = {
        "feature": np.array([[0, -1, -1]]), "threshold": np.array([[0.5, 0, 0]]), "left": np.array([[1, 0, 0]]),
        "right": np.array([[2, 0, 0]]), "value": np.array([[0.0, -1.0, 1.0]]),
    }  # fmt: skip
    verifier = _npz(
        features=np.array(FEATURES), efforts=np.array(["fast", "normal", "thorough"]), calibration=np.ones((3, 2)),
        depth=1, baseline=0.0, **trees,
    )  # fmt: skip
    shard = _npz(
        features=np.array(FEATURES), figures=np.zeros((4, len(FEATURES)), np.float32), error_deg=np.arange(4.0),
        pair=np.arange(4), object=np.zeros(4, int), angle_deg=np.zeros(4),
    )  # fmt: skip
    return [{"verifier.npz": verifier}, {"shard-000000.npz": shard}]


def _read_trees(folder: Path) -> object:
    from reorient.estimators.verifier import FEATURES, load_verifier
    from reorient.learning.verifier import read

    if (folder / "shard-000000.npz").is_file():
        data = read(folder)
        return data.best(data.error_deg)
    load_verifier.cache_clear()
    verifier = load_verifier(folder / "verifier.npz")
    return verifier.probability(verifier.log_odds(np.zeros((2, len(FEATURES)))), "normal")


def _onnx_seeds() -> list[Files]:
    """A network that is small: the mean of each image, and a quaternion from it."""
    from onnx import TensorProto, helper, numpy_helper

    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, ["n", 2, 128, 128])
    quat = helper.make_tensor_value_info("quat_wxyz", TensorProto.FLOAT, ["n", 4])
    weights = numpy_helper.from_array(np.array([[0.1, 0], [0, 0.1], [0, 0.1], [0.2, 0]], np.float32), "head.weight")
    bias = numpy_helper.from_array(np.array([1, 0, 0, 0], np.float32), "head.bias")
    nodes = [
        helper.make_node("GlobalAveragePool", ["images"], ["mean"]),
        helper.make_node("Flatten", ["mean"], ["flat"]),
        helper.make_node("Gemm", ["flat", "head.weight", "head.bias"], ["quat_wxyz"], transB=1),
    ]
    graph = helper.make_graph(nodes, "small", [images], [quat], [weights, bias])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"rounds": "2", "network": "swift"})
    return [{"weights.onnx": model.SerializeToString()}]


def _read_onnx(folder: Path) -> object:
    from reorient.estimators import load_estimator
    from reorient.estimators.learned import load_session

    load_session.cache_clear()
    return load_estimator(str(folder / "weights.onnx")).estimate(_image(), _image())


def _weights_seeds() -> list[Files]:
    import torch
    from safetensors.torch import save_file

    network = _network()
    state = network.state_dict()
    seeds = _written(lambda path: save_file(state, path), "best.safetensors")
    seeds += _written(lambda path: torch.save({"network": state, "step": 3}, path), "last.ckpt")
    return seeds + _onnx_seeds()


def _network() -> Any:
    from collections import OrderedDict

    from torch import nn

    return nn.Sequential(OrderedDict(head=nn.Linear(2, 4)))


def _read_weights(folder: Path) -> object:
    from reorient.learning.weights import load_weights

    load_weights(_network(), _only(folder))
    return None


def _pairs_seeds() -> list[Files]:
    from reorient.learning.pair_store import generate
    from reorient.world.objects import ObjectSource
    from reorient.world.pairs import PairSet

    config = PairSet(ObjectSource(count=2, object_seed=7), pairs_per_object=2)
    return _written(lambda path: list(generate(config, path.parent)), "zarr.json")


def _read_pairs(folder: Path) -> object:
    from reorient.learning.batches import prepare
    from reorient.learning.pair_reader import PairReader

    reader = PairReader(folder)
    return prepare(reader.read(np.arange(len(reader.names) * reader.config.pairs_per_object)), reader)


# --- estimates and command lines ------------------------------------------------------------------------------------


def _pair_seeds() -> list[Files]:
    """Raw depth in metres, whose single bytes are pixels that no camera returns."""
    return [{"now.f4": _depth_m().tobytes(), "goal.f4": np.roll(_depth_m(), 1, 0).tobytes()}]


def _estimate(folder: Path) -> object:
    from reorient import load_estimator

    images = []
    for name in ("now.f4", "goal.f4"):
        data = (folder / name).read_bytes() if (folder / name).is_file() else b""
        depth_m = np.zeros(18 * 24, np.float32)
        values = np.frombuffer(data[: len(data) // 4 * 4], "<f4")[: 18 * 24]
        depth_m[: len(values)] = values
        images.append(DepthImage(depth_m.reshape(18, 24), CAMERA))
    current, goal = images
    for name in ("gicp", "icp", "fast"):
        _refused(partial(load_estimator(name).estimate, current, goal))
    return None


def _words_seeds() -> list[Files]:
    """The command lines of all examples in the help."""
    import inspect

    from reorient.cli.verbs import VERBS

    lines = [
        re.split("&&|>", line)[0].strip()
        for verb in VERBS.values()
        for line in (inspect.getdoc(verb.load()) or "").splitlines()
        if line.strip().startswith("reorient ")
    ]
    return [{"words": line.removeprefix("reorient ").encode()} for line in lines]


def _parse(folder: Path) -> object:
    """Verb and options are read; nothing is run."""
    from reorient.cli.arguments import parse
    from reorient.cli.verbs import VERBS, find

    try:
        words = shlex.split((folder / "words").read_text(errors="surrogateescape"))
    except (ValueError, OSError):
        return None  # no command line of a shell
    words = [word for word in words if word not in ("-h", "--help") and "\0" not in word]
    name = find(words) if words else None
    return None if name is None else parse(VERBS[name].load(), f"reorient {name}", words[len(name.split()) :])


TARGETS = (
    Target("depth", _depth_seeds, _read_depth),
    Target("exr", _exr_seeds, _read_depth, ("OpenEXR",), 0.4),
    Target("mask", _mask_seeds, _read_mask, share=0.5),
    Target("camera", _camera_seeds, _read_camera, share=3),
    Target("hand-eye", _hand_eye_seeds, _read_hand_eye, share=2),
    Target("calibration", _calibration_seeds, _read_calibration, share=2),
    Target("poses", _poses_seeds, _read_poses, share=2),
    Target("robot", _robot_seeds, _read_robot, share=2),
    Target("goal", _goal_seeds, _read_goal),
    Target("record", _record_seeds, _read_record, share=0.5),
    Target("run", _run_seeds, _read_run, share=2),
    Target("names", _names_seeds, _read_names),
    Target("log", _log_seeds, _read_log),
    Target("mesh", _mesh_seeds, _read_mesh, ("trimesh",), 0.5),
    Target("bop", _bop_seeds, _read_bop, ("trimesh",), 0.4),
    Target("trees", _trees_seeds, _read_trees),
    Target("onnx", _onnx_seeds, _read_onnx, ("onnx", "onnxruntime"), 0.2),
    Target("weights", _weights_seeds, _read_weights, ("onnx", "safetensors", "torch"), 0.4),
    Target("pairs", _pairs_seeds, _read_pairs, ("zarr", "torch", "trimesh"), 0.1),
    Target("estimate", _pair_seeds, _estimate, share=0.02),
    Target("words", _words_seeds, _parse),
)
