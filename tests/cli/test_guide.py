"""The verb guide, end to end with the simulated hand."""

import csv

import numpy as np
import pytest

from reorient.cli import main
from reorient.imaging import Camera, DepthImage
from reorient.imaging.files import write_depth


@pytest.fixture(scope="module")
def goal(tmp_path_factory):
    path = tmp_path_factory.mktemp("guide") / "goal.npz"
    main(["capture", str(path), "--station", "rendered"])
    return str(path)


def test_a_simulated_person_matches_the_goal(goal, tmp_path, capsys):
    log = tmp_path / "quality.csv"
    options = ["--station", "rendered-hand", "--start-deg", "15", "--estimator", "fast"]
    main(["guide", goal, *options, "--log", str(log), "--name", "part"])
    lines = capsys.readouterr().out.splitlines()
    assert "searching: hold the object still" in lines[0]
    assert "deg towards you" in lines[1] or "deg to the" in lines[1]
    assert lines[-2].endswith("matched")
    assert lines[-1].startswith("matched in ")
    (row,) = csv.DictReader(log.open(newline=""))
    assert (row["object"], row["result"]) == ("part", "matched")
    assert float(row["start_deg"]) == pytest.approx(15, abs=2)
    assert float(row["final_deg"]) <= 1


def test_images_that_end_before_a_match(goal, tmp_path, capsys):
    folder = tmp_path / "frames"
    folder.mkdir()
    other = np.zeros((64, 64), np.float32)
    other[30:33, 20:40] = 0.5
    write_depth(folder / "0.npz", DepthImage(other, Camera(64, 64, 100.0, 100.0, 32.0, 32.0)))
    with pytest.raises(SystemExit) as stopped:
        main(["guide", goal, "--station", str(folder), "--estimator", "fast"])
    assert stopped.value.code == 1
    assert "0 of 1 objects matched: no object was recognised" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "--station is missing"),
        (["--station", "realsens"], "station 'realsens': expected a robot.toml, one of folder, realsense"),
        (["--station", "json:JSONDecoder"], "has no capture"),
        (["--station", "rendered-hand", "--tolerance-deg", "0.1"], "--tolerance-deg 0.1: expected a number from 0.5"),
        (["--station", "rendered-hand", "--parts", "0"], "--parts 0"),
    ],
)
def test_wrong_options(goal, options, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["guide", goal, *options])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err


def test_the_camera_of_a_robot_file(goal, tmp_path, capsys):
    """Its own camera and isolation; the arm is not opened."""
    file = tmp_path / "cell.toml"
    file.write_text('[camera]\ndriver = "simulated"\n[arm]\ndriver = "no_such:Arm"\n[isolation]\nfar_m = 0.01\n')
    with pytest.raises(SystemExit) as stopped:
        main(["guide", goal, "--station", str(file), "--timeout-s", "0.001", "--estimator", "fast"])
    assert stopped.value.code == 1
    assert "no object: show the object to the camera" in capsys.readouterr().out
