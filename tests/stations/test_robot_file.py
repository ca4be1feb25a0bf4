"""robot.toml and the table of drivers: unknown names, missing extras, wrong values."""

import importlib

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.stations.drivers import ARMS, CAMERAS, make_camera
from reorient.stations.robot_file import TEMPLATE, read_robot_file
from reorient.stations.simulated import SimulatedArm, SimulatedCamera


@pytest.fixture
def file(tmp_path):
    def write(text):
        (tmp_path / "robot.toml").write_text(text)
        return tmp_path / "robot.toml"

    return write


DRIVERS = '[camera]\ndriver = "simulated"\n[arm]\ndriver = "simulated"\n'


def test_the_template_is_read_and_so_are_its_commented_lines(file):
    robot = read_robot_file(file(TEMPLATE))
    assert robot.isolation.radius_m == 0.2
    assert robot.calibration.name == "calibration.json"
    everything = "\n".join(
        line.removeprefix("# ") if line.startswith("# ") and "=" in line else line for line in TEMPLATE.splitlines()
    )
    robot = read_robot_file(file(everything))
    assert robot.isolation.remove_plane
    assert robot.isolation.far_m == 0.9
    assert robot.limits.box_high_m == (0.7, 0.4, 0.8)
    assert robot.arm["address"] == "192.168.0.10"


def test_camera_and_arm_share_the_simulated_cell(file):
    robot = read_robot_file(file(DRIVERS))
    camera, arm = robot.open_camera(), robot.open_arm()
    assert isinstance(camera, SimulatedCamera)
    assert camera.cell is arm._arm.cell
    with pytest.raises(ReorientError, match="no calibration .* `reorient calibrate robot.toml` first"):
        robot.open_station()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (DRIVERS + "[limit]\n", r"unknown key in .*: 'limit'.*did you mean 'limits'"),
        (DRIVERS + "[limits]\nmax_step = 3\n", r"unknown key in \[limits\].*did you mean 'max_step_deg'"),
        (DRIVERS + "[isolation]\nnear = 3\n", r"unknown key in \[isolation\].*did you mean 'near_m'"),
        (DRIVERS + "[isolation]\nradius_m = 0.2\n", "radius_m without around_m"),
        (
            DRIVERS + '[isolation]\nallow_touching = "no"\n',
            r"\[isolation\] .*allow_touching='no': expected true or false",
        ),
        (DRIVERS + '[isolation]\nbackground = "empty.png"\n', r"no file '.*empty.png': expected the frame without"),
        (DRIVERS + "[tool]\npoint = 3\n", "did you mean 'point_m'"),
        (DRIVERS + "[tool]\npoint_m = [0, 1]\n", "expected three finite metres"),
        (DRIVERS + "[limits]\nmax_step_deg = -1\n", r"\[limits\] .*max_step_deg=-1"),
        (DRIVERS + '[limits]\nmax_step_deg = "a"\n', r"\[limits\] .*"),
        ("limits = 3\n" + DRIVERS, "expected a table"),
        ("calibration = 3\n" + DRIVERS, "expected the name of a file"),
        ('[camera]\ndriver = "simulated"\n', r"no driver in \[arm\]"),
        ("[camera\n", "is not TOML"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_what_is_wrong_is_named(file, text, message):
    with pytest.raises(ReorientError, match=message):
        read_robot_file(file(text))


def test_a_missing_file(tmp_path):
    with pytest.raises(ReorientError, match="reorient new-robot"):
        read_robot_file(tmp_path / "robot.toml")


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("simulatd", {}, "unknown camera driver 'simulatd'.*did you mean 'simulated'"),
        ("simulated", {"cel": 1}, "unknown setting of camera driver 'simulated': 'cel'.*did you mean 'cell'"),
        ("nowhere:Camera", {}, "cannot make camera driver 'nowhere:Camera'"),
        ("own_camera:Camera", {}, "camera driver 'own_camera:Camera' lacks serial"),
        ("own_camera:Camera", {"serial": "0"}, "cannot open camera 'own_camera:Camera': OSError: not connected"),
        ("own_camera:Empty", {}, "has no capture"),
    ],
)
def test_a_driver_that_cannot_be_made(tmp_path, monkeypatch, name, settings, message):
    (tmp_path / "own_camera.py").write_text(
        "class Camera:\n    def __init__(self, serial): raise OSError('not connected')\nclass Empty: pass\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ReorientError, match=message):
        make_camera(name, settings)


@pytest.mark.parametrize("driver", [*CAMERAS.values(), *ARMS.values()], ids=lambda driver: driver.name)
def test_each_name_of_the_table_leads_to_a_class(driver):
    module = importlib.import_module(f"reorient.stations.{driver.module}")
    assert isinstance(getattr(module, driver.name), type)


def test_a_simulated_arm_starts_rotated():
    arm = SimulatedArm(1)
    first = arm.pose()
    rotated = SimulatedArm(1, start_deg=40.0).pose()
    cosine = (np.trace(rotated[:3, :3] @ first[:3, :3].T) - 1) / 2
    assert np.degrees(np.arccos(cosine)) == pytest.approx(40)


def test_the_file_as_written_isolates_the_object_of_its_simulated_cell(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(TEMPLATE)
    robot = read_robot_file(path)
    frame = robot.open_camera().capture()
    object_m = robot.isolation(frame).points()
    assert len(frame.points()) > 2 * len(object_m) > 2000  # a table is in view, too
    assert np.ptp(object_m, axis=0).max() < 0.2  # the diameter of its bounding sphere
