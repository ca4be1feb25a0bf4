"""A user's script is type-checked strictly against the installed package: `py.typed`, and names that are exported."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mypy")
pytestmark = pytest.mark.slow

SCRIPT = """
from typing import assert_type

import numpy as np

from reorient import Camera, DepthImage, Goal, GoalView, Isolation, Limits, OrientResult, ReorientError
from reorient import RotationEstimate, Station, load_estimator, load_strategy, orient


class MyStation:
    pivot_m: np.ndarray | None = None

    def __init__(self, image: DepthImage) -> None:
        self.image = image

    def capture(self) -> DepthImage:
        return self.image

    def rotate(self, R_step: np.ndarray) -> np.ndarray:
        return R_step


camera = Camera(width=128, height=128, fx=331.0, fy=331.0, cx=64.0, cy=64.0)
image = DepthImage(np.zeros((128, 128)), camera)
isolated = Isolation(near_m=0.3, remove_plane=True)(image)
goal = Goal(isolated, views=(GoalView(image, np.eye(3)),))
estimate = load_estimator("default").estimate(image, goal.image)
assert_type(estimate, RotationEstimate)
angle_deg: float = np.degrees(estimate.angle_rad)
confidence: float | None = estimate.confidence
for R, probability in estimate.alternatives:
    print(R @ R.T, probability + 1.0)
station: Station = MyStation(image)
try:
    result = orient(station, goal, load_estimator(), load_strategy("fusing", max_moves=3), limits=Limits())
except ReorientError as error:
    raise SystemExit(str(error)) from error
assert_type(result, OrientResult)
print(result.converged, result.reason.upper(), [step.index for step in result.steps])
"""
FAULTS = {
    "from reorient import no_such_name": 'Module "reorient" has no attribute "no_such_name"',
    "load_estimator(3)": 'Argument 1 to "load_estimator" has incompatible type "int"',
    "wrong: str = estimate.angle_rad": "Incompatible types in assignment",
    "estimate.angle_deg": '"RotationEstimate" has no attribute "angle_deg"',
    "Camera(width=128)": 'Missing positional arguments "height", "fx"',
}


def test_a_script_of_a_user_is_checked(tmp_path: Path) -> None:
    lines = (SCRIPT + "\n".join(FAULTS)).splitlines()
    (tmp_path / "script.py").write_text("\n".join(lines) + "\n")
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--config-file=",
        "--cache-dir",
        tmp_path / "cache",
        "script.py",
    ]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    found = [line for line in run.stdout.splitlines() if ": error: " in line]
    assert all(line.startswith("script.py:") for line in found), run.stdout
    first = len(lines) - len(FAULTS) + 1
    for line, message in enumerate(FAULTS.values(), first):
        assert any(each.startswith(f"script.py:{line}: ") and message in each for each in found), (message, run.stdout)
    assert len(found) == len(FAULTS), run.stdout
