"""The verbs of the loop with code of the user's own: what is asked, limited, named, recorded, and never run."""

import json
import os
import re
import shutil
import sys
from pathlib import Path

import pytest

from reorient.cli import main
from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.imaging.files import read_depth
from reorient.world.objects import ObjectSource

CELL = """
import numpy as np
from reorient import so3
from reorient.cli.stations import StationChoice

ROTATED_DEG = []


class Cell:
    start_deg = 50.0

    def __init__(self):
        self.inner = StationChoice("rendered", start_deg=self.start_deg).open()
        self.pivot_m = self.inner.pivot_m

    def capture(self):
        return self.inner.capture()

    def rotate(self, R_step):
        ROTATED_DEG.append(float(np.degrees(so3.angle(R_step))))
        return self.inner.rotate(R_step)


class Near(Cell):
    start_deg = 12.0


class Wrong(Near):
    def capture(self):
        return self.inner.captur()


class Exits(Near):
    def rotate(self, R_step):
        raise SystemExit(0)


class Interrupted(Near):
    def rotate(self, R_step):
        raise KeyboardInterrupt

    def stop(self):
        print("stopped")


class Mine:
    def estimate(self, current, goal, pivot_m=None, history=()):
        from reorient import load_estimator

        return load_estimator("gicp").estimate(current, goal, pivot_m)


class Broken:
    def estimate(self, current, goal, pivot_m=None, history=()):
        return current["depth_m"]


class Leaving:
    def estimate(self, current, goal, pivot_m=None, history=()):
        raise SystemExit(0)
"""


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys):
    """The working folder, with a station module of its own and a goal."""
    (tmp_path / "own_cell.py").write_text(CELL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_cell", raising=False)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    main(["capture", "goal.npz"])
    capsys.readouterr()
    return tmp_path


def ended(capsys, *arguments) -> tuple[int, str, str]:
    code = 0
    try:
        main([str(a) for a in arguments])
    except SystemExit as end:
        code = int(end.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def line_of(text: str) -> int:
    return CELL.splitlines().index(text) + 1


def test_a_station_of_ones_own_is_asked_about_and_limited(folder, capsys, monkeypatch):
    own = ["orient", "goal.npz", "--estimator", "gicp", "--strategy", "direct", "--station", "own_cell:Cell"]
    answers = []

    def answer():
        answers.append(capsys.readouterr())
        return "no"

    monkeypatch.setattr("builtins.input", answer)
    code, _, err = ended(capsys, *own)
    (before,) = answers
    assert before.out.startswith("[1] estimate")  # the reason comes before the question
    assert re.fullmatch(r"first move: [\d.]+ deg .*\nmake this move\? \[y/N\]\n", before.err)
    assert code == 1
    assert "(declined)" in err

    def no_terminal():
        raise EOFError

    monkeypatch.setattr("builtins.input", no_terminal)
    code, _, err = ended(capsys, *own)
    assert "no answer: --yes moves without asking" in err
    monkeypatch.setattr("builtins.input", lambda: pytest.fail("asked"))
    code, out, _ = ended(capsys, *own, "--yes", "--record", "record")
    assert code == 0
    rotated_deg = sys.modules["own_cell"].ROTATED_DEG
    assert 20 < max(rotated_deg) < 30  # in two parts
    limits = json.loads((folder / "record" / "record.json").read_text())["limits"]
    assert (limits["max_step_deg"], limits["max_rotation_deg"]) == (45, 720)
    assert ended(capsys, "replay", "record")[1] == out
    rotated_deg.clear()
    assert ended(capsys, *own, "--yes", "--max-step-deg", 150)[0] == 0
    assert max(rotated_deg) > 45
    assert ended(capsys, *own, "--yes", "--confirm-first-move")[0] == 2


def test_the_largest_total_of_a_station_of_ones_own(folder, capsys):
    """An estimator that always answers 150 degrees spins no robot for ever."""
    (folder / "spinning.py").write_text(
        "import numpy as np\nfrom reorient import so3\nfrom types import SimpleNamespace\n"
        "class Spin:\n    def estimate(self, *_):\n"
        "        return SimpleNamespace(R_goal_current=so3.exp(np.array([0, 0, 2.6])), t_goal_current_m=np.zeros(3))\n"
    )
    spin = ["orient", "goal.npz", "--estimator", "spinning:Spin", "--strategy", "direct", "--station", "own_cell:Cell"]
    code, _, err = ended(capsys, *spin, "--yes")
    assert code == 1
    assert "(max_rotation)" in err
    assert 700 - 150 < sum(sys.modules["own_cell"].ROTATED_DEG) <= 720


def test_no_station_is_no_simulator(folder, capsys):
    code, _, err = ended(capsys, "orient", "goal.npz")
    assert (code, err) == (
        2,
        "reorient: --station is missing: expected a robot.toml, my_module:MyStation, or 'rendered' for the simulator\n",
    )


@pytest.mark.parametrize(
    ("station", "message"),
    [
        ("Wrong", "AttributeError: 'RenderedStation' object has no attribute 'captur' [own_cell.py, line {}]"),
        ("Exits", "SystemExit: 0 [own_cell.py, line {}]"),
    ],
)
def test_errors_of_a_station_name_file_and_line(folder, capsys, station, message):
    line = {"Wrong": "        return self.inner.captur()", "Exits": "        raise SystemExit(0)"}[station]
    one = ["orient", "goal.npz", "--yes", "--estimator", "gicp", "--station", f"own_cell:{station}"]
    code, _, err = ended(capsys, *one)
    assert code == 1
    assert message.format(line_of(line)) in err
    assert "Traceback" not in err
    code, _, err = ended(capsys, *one, "--traceback")
    assert code == 1
    assert "Traceback (most recent call last)" in err
    assert line.strip() in err


def test_an_interrupted_move_is_recorded_and_shown(folder, capsys):
    one = ["orient", "goal.npz", "--yes", "--estimator", "gicp", "--station", "own_cell:Interrupted"]
    code, out, err = ended(capsys, *one, "--record", "record", "--out", "run")
    assert code == 130
    assert "interrupted" in err
    assert "stopped" in out
    assert (folder / "run" / "loop.html").is_file()
    record = json.loads((folder / "record" / "record.json").read_text())
    assert record["status"] == "interrupted"
    assert (record["acts"][-1]["executed"], record["acts"][-1]["error"]) == (None, "KeyboardInterrupt: ")


@pytest.mark.parametrize("estimator", ["Broken", "Leaving"])
def test_an_estimator_that_raises_is_measured_and_named(folder, capsys, estimator):
    name = f"own_cell:{estimator}"
    code, _, err = ended(capsys, "estimate", "goal.npz", "goal.npz", "--estimator", name)
    assert (code, err.count("\n")) == (2, 1)
    assert re.search(r"the estimator failed: \w+: .*\[own_cell.py, line \d+\]", err)
    out = folder / "run"
    one = ["evaluate", out, "--count", 2, "--pairs", 2, "--ranges-deg", 0, 30, "--noise-mm", 0, "--estimators"]
    code, _, err = ended(capsys, *one, "gicp", name)
    assert code == 0
    assert f"2 of 4 estimates failed and count as no rotation, the first by {name}: " in err
    config = Evaluation(ObjectSource(count=2), ("gicp", name), ranges_deg=((0, 30),), noise_mm=(0.0,), pairs=2)
    assert list(evaluate(config, out))[-1] == (2, 2)  # nothing is left to do


# --- a record runs no code --------------------------------------------------------------------------------------------


@pytest.fixture
def record(folder, capsys):
    """A record of a short loop."""
    code, out, _ = ended(
        capsys, "orient", "goal.npz", "--dry-run", "--estimator", "own_cell:Mine", "--station", "own_cell:Near",
        "--record", "record",
    )  # fmt: skip
    assert code == 0
    return folder / "record", out


def changed(record: Path, **entries) -> None:
    file = record / "record.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | entries))


def test_a_record_runs_no_code(record, capsys):
    folder, out = record
    code, _, err = ended(capsys, "replay", "record")
    assert code == 2
    assert "names the estimator 'own_cell:Mine', but a record runs no code: expected --estimator own_cell:Mine" in err
    assert ended(capsys, "replay", "record", "--estimator", "own_cell:Mine")[:2] == (0, out)
    Path("evil.py").write_text("from pathlib import Path\nPath('ran').write_text('')\n")
    for entries in ({"estimator": "evil:X"}, {"station": "evil:X"}, {"strategy": {"strategy": "evil:X"}}):
        changed(folder, **{"estimator": "gicp"} | entries)
        ended(capsys, "replay", "record")
    assert not Path("ran").exists()


def test_a_record_reads_no_file_outside_it(record, capsys):
    folder, _ = record
    shutil.copy(Path("goal.npz"), "outside.npz")
    changed(folder, estimator="gicp")
    acts = json.loads((folder / "record.json").read_text())["acts"]
    for name in ("../outside.npz", str(Path("outside.npz").resolve()), "link.npz"):
        os.path.lexists(folder / "link.npz") or (folder / "link.npz").symlink_to(Path("outside.npz").resolve())
        changed(folder, acts=[{"capture": name}, *acts[1:]])
        code, _, err = ended(capsys, "replay", "record")
        assert code == 2
        assert f"names the file {name!r}, which is outside: expected files inside the record" in err
    changed(folder, acts=acts, estimator="../weights.onnx")
    assert "which is outside" in ended(capsys, "replay", "record")[2]


def test_weights_are_kept_in_the_record(folder, capsys):
    import reorient

    weights = Path(reorient.__file__).parent / "weights" / "paper.onnx"
    shutil.copy(weights, "mine.onnx")
    one = ["orient", "goal.npz", "--dry-run", "--estimator", "mine.onnx", "--station", "own_cell:Near"]
    code, out, _ = ended(capsys, *one, "--record", "record")
    assert code == 0
    Path("mine.onnx").unlink()
    assert ended(capsys, "replay", "record")[:2] == (0, out)
    assert read_depth(folder / "record" / "goal.npz").camera.width == 128


@pytest.mark.parametrize(
    "acts",
    [
        [3],
        [{}],
        [{"capture": 3}],
        [{"capture": None}],
        [{"rotate": [1]}],
        [{"rotate": [[2, 0, 0]] * 3, "executed": None}],
    ],
)
def test_broken_acts_are_refused(record, capsys, acts):
    folder, _ = record
    changed(folder, acts=acts)
    code, _, err = ended(capsys, "replay", "record")
    assert code == 2
    assert "cannot read " in err
    (folder / "record.json").write_text("[" * 20_000 + "]" * 20_000)
    assert "cannot read " in ended(capsys, "replay", "record")[2]
