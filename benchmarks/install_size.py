"""Size and speed of the base install: a fresh environment, the wheel, import, first result.

    python benchmarks/install_size.py out/base

It needs nothing but Python's standard library, builds the wheel, installs it without extras, and ends with code 1 where
a limit of ``LIMITS`` is exceeded. Each time is processor time, the best of three.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIMITS = {"base install": 360.0, "wheel": 20.0}
"""Largest sizes, MB; with onnxruntime, which the networks need."""
FIRST_RESULT = """
import numpy as np
from reorient import Camera, DepthImage, load_estimator

camera = Camera(128, 128, 331.0, 331.0, 64.0, 64.0)
rays = camera.rays()


def depth_m(angle_rad):  # a box of 8 x 6 x 4 cm at 0.6 m, rotated about the x axis and tilted
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = R.T @ [0, 0, 0.6] + np.array([[0.04, 0.03, 0.02], [-0.04, -0.03, -0.02]])
        along = sides[:, None, None] / (rays @ R)
    near, far = along.min(axis=0).max(axis=-1), along.max(axis=0).min(axis=-1)
    return np.where(near < far, near, 0.0)


estimate = load_estimator().estimate(DepthImage(depth_m(0.9), camera), DepthImage(depth_m(0.6), camera))
print(np.degrees(estimate.angle_rad))
"""


def size_mb(folder: Path) -> float:
    """Size on disk, MB (2^20 bytes), hard links counted once."""
    found = {(stat.st_dev, stat.st_ino): stat for stat in (path.lstat() for path in folder.rglob("*"))}
    blocks = [getattr(stat, "st_blocks", -(-stat.st_size // 4096) * 8) for stat in found.values()]
    return 512 * sum(blocks) / 2**20


def best_s(command: list[str | Path]) -> float:
    times = []
    for _ in range(3):
        start_s = _children_s()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=tempfile.gettempdir())
        times.append(_children_s() - start_s)
    return min(times)


def _children_s() -> float:
    """Processor time of ended child processes; on Windows, which does not count it, the time of the clock."""
    if sys.platform == "win32":
        return time.perf_counter()
    used = os.times()
    return used.children_user + used.children_system


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="environment to make (replaced)")
    folder = parser.parse_args().folder.resolve()
    venv.create(folder, with_pip=True, clear=True)
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    pip = [python, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    empty_mb = size_mb(folder)
    with tempfile.TemporaryDirectory() as wheels:
        subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", wheels, ROOT], check=True)
        (wheel,) = Path(wheels).glob("*.whl")
        wheel_mb = wheel.stat().st_size / 2**20
        start_s = _children_s()
        subprocess.run([*pip, "install", wheel], check=True)
    sizes = {"base install": size_mb(folder) - empty_mb, "wheel": wheel_mb}
    times = {
        "installing": _children_s() - start_s,
        "starting Python": best_s([python, "-c", ""]),
        "import reorient": best_s([python, "-c", "import reorient"]),
        "reorient --help": best_s([python, "-m", "reorient", "--help"]),
        "first result": best_s([python, "-c", FIRST_RESULT]),
    }
    for name, mb in sizes.items():
        print(f"{name:16s} {mb:6.1f} MB (at most {LIMITS[name]:g})")
    for name, seconds in times.items():
        print(f"{name:16s} {seconds:6.2f} s")
    if too_large := [name for name, mb in sizes.items() if mb > LIMITS[name]]:
        sys.exit(f"too large: {', '.join(too_large)}")


if __name__ == "__main__":
    main()
