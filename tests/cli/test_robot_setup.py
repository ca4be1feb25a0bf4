"""new-robot, calibrate, check, capture and orient on a robot.toml with a camera and an arm of the user's own."""

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest

from reorient import se3
from reorient.cli import main
from reorient.perception.robot_calibration import RobotCalibration, write_robot_calibration
from reorient.stations.simulated import SimulatedArm

MODULE = """
import numpy as np, trimesh
from reorient.imaging import Camera
from reorient.stations.simulated import SimulatedArm, SimulatedCamera, SimulatedCell
from reorient.world.sensing import Sensor

ends = ((1.0, 0.2, 0.2), (0.2, 0.7, 0.2), (0.2, 0.1, 0.5))
arms = [trimesh.creation.box(bounds=[(-0.2, -0.2, -0.2), end]) for end in ends]
CELL = SimulatedCell(trimesh.boolean.union(arms, engine="manifold"), np.random.default_rng(0), Sensor(noise_m=0.0005))
CELL.camera = Camera(160, 120, 165.0, 165.0, 80.0, 60.0)

class MyCamera(SimulatedCamera):
    def __init__(self, serial: str) -> None:
        super().__init__(CELL)

class MyArm(SimulatedArm):
    def __init__(self, start_deg: float = 0.0) -> None:
        super().__init__(CELL, start_deg)
"""


def run(capsys, *words):
    code = 0
    try:
        main([str(word) for word in words])
    except SystemExit as ended:
        code = int(ended.code or 0)
    captured = capsys.readouterr()
    return code, captured.out + captured.err


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_from_a_new_file_to_a_converged_loop(tmp_path, monkeypatch, capsys):
    (tmp_path / "robot_of_mine.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert run(capsys, "new-robot") == (0, "robot.toml\n")
    assert run(capsys, "new-robot")[0] == 2
    text = Path("robot.toml").read_text()
    text = re.sub(
        r'\[camera\]\ndriver = "simulated"', '[camera]\ndriver = "robot_of_mine:MyCamera"\nserial = "7"', text
    )
    text = re.sub(r'\[arm\]\ndriver = "simulated"', '[arm]\ndriver = "robot_of_mine:MyArm"', text)
    text = text.replace("settle_s = 0.15", "settle_s = 0.0")
    Path("robot.toml").write_text(text)

    code, out = run(capsys, "check", "robot.toml", "--yes")
    assert code == 2
    assert "`reorient calibrate robot.toml` first" in out

    code, out = run(capsys, "calibrate", "robot.toml", "--estimator", "gicp", "--yes")
    assert code == 0, out
    assert "calibration.json" in out
    code, out = run(capsys, "check", "robot.toml", "--estimator", "gicp", "--yes")
    assert code == 0, out
    assert "passed" in out

    assert run(capsys, "capture", "goal.npz", "--station", "robot.toml")[0] == 0
    Path("robot.toml").write_text(text.replace(':MyArm"', ':MyArm"\nstart_deg = 25.0'))
    code, out = run(capsys, "orient", "goal.npz", "--station", "robot.toml", "--estimator", "gicp", "--yes")
    assert code == 0, out
    assert "converged" in out

    found = np.array(json.loads(Path("calibration.json").read_text())["T_base_camera"])
    np.savetxt("inverse.txt", se3.inverse(found))
    code, out = run(capsys, "calibrate", "robot.toml", "--hand-eye", "inverse.txt", "--estimator", "gicp", "--yes")
    assert code == 0, out
    assert "inverted" in out
    assert np.allclose(json.loads(Path("calibration.json").read_text())["T_base_camera"], found)


@pytest.mark.parametrize(
    ("verb", "plan"),
    [
        (("calibrate",), "rotate by up to 35 deg about the tool point, 8 times"),
        (("calibrate", "--hand-eye", "known.txt"), "rotate by 5 deg about three axes"),
        (("check",), "rotate by 5 deg about three axes"),
    ],
)
@pytest.mark.parametrize("answer", ["n", None])
def test_nothing_moves_before_it_is_confirmed(tmp_path, monkeypatch, capsys, verb, plan, answer):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(SimulatedArm, "move_to", lambda *_: pytest.fail("moved"))
    monkeypatch.setattr("sys.stdin", io.StringIO("" if answer is None else f"{answer}\n"))
    run(capsys, "new-robot")
    np.savetxt("known.txt", np.eye(4))
    write_robot_calibration("calibration.json", RobotCalibration(np.eye(4), np.zeros(3)))
    before = Path("calibration.json").read_text()
    code, out = run(capsys, verb[0], "robot.toml", *verb[1:])
    assert code == 1
    assert plan in out
    assert "not confirmed, nothing was moved" in out
    assert ("--yes moves without asking" in out) == (answer is None)
    assert Path("calibration.json").read_text() == before
