"""The whole command on one object."""

import numpy as np
import pytest

from reorient.cli import main
from reorient.errors import ReorientError
from reorient.experiments.cell import run
from reorient.experiments.cell_trials import Experiment, stage
from reorient.reporting.cell_rows import read_loops

SMALL = ["--objects", "1", "--trials", "1", "--count", "60"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("cell")
    main(["cell", str(out), *SMALL, "--systems", "gicp/direct"])
    return out


def test_rows_masks_page_and_animation(folder):
    assert {path.name for path in folder.iterdir()} == {
        *(".lock", "config.json", "rows.csv.gz", "masks.csv.gz", "report.html", "cell.gif")
    }
    (loop,) = read_loops(folder)
    assert loop.errors_deg[0] == pytest.approx(30, abs=0.5)
    assert loop.errors_deg[-1] < 2
    assert (loop.system, loop.moves) == ("gicp/direct", len(loop.errors_deg) - 2)
    page = (folder / "report.html").read_text()
    assert "gicp/direct" in page
    assert "the object in the last image, by each segmentation" in page
    assert 'src="http' not in page


def test_an_interrupted_run_goes_on_and_another_config_is_refused(tmp_path):
    config = Experiment(trials=2, objects=1, systems=("gicp/direct",))
    states = run(config, tmp_path)
    assert next(states) == (0, 2)
    assert next(states) == (1, 2)
    states.close()  # interrupted
    with (tmp_path / "trials.jsonl").open("a") as file:
        file.write("half a li")
    states = run(config, tmp_path)
    assert next(states) == (1, 2)
    assert list(states) == [(2, 2)]
    assert [loop.trial for loop in read_loops(tmp_path)] == [0, 1]
    assert list(run(config, tmp_path)) == [(2, 2)]  # nothing is left to do
    with pytest.raises(ReorientError, match="another config"):
        next(run(Experiment(trials=3, objects=1), tmp_path))


def test_the_same_seed_makes_the_same_stage():
    config = Experiment()
    name = config.source.open().names[0]
    one, two = (stage(config, name, 0, (30, 30)) for _ in range(2))
    np.testing.assert_array_equal(one.goal.depth_m, two.goal.depth_m)
    np.testing.assert_array_equal(one.cell.plant.R_world_object, two.cell.plant.R_world_object)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--calibration", "none.json"], "no calibration file 'none.json'"),
        (["--arm", "none.xml"], "no arm file 'none.xml'"),
        (["--systems", "gicp/tomorrow"], "unknown strategy"),
        (["--systems", "gicp"], "system 'gicp': expected an estimator and a strategy"),
        (["--systems", "gicq/direct"], "did you mean 'gicp'"),
        (["--ranges-deg", "0", "200"], "expected 0 < low <= high <= 180"),
        (["--gripper-saturation", "0.5", "20"], "expected degrees"),
        (["--segmentation", "color"], "did you mean 'colour'"),
        (["--slip-nm", "-1"], "--slip-nm -1: expected a number above 0"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, capsys, arguments, message):
    with pytest.raises(SystemExit) as ended:
        main(["cell", str(tmp_path), *SMALL, *arguments])
    assert ended.value.code == 2
    said = capsys.readouterr().err.strip()
    assert message in said
    assert said.splitlines()[-1].startswith("reorient: ")
