"""The documentation's blocks run, page by page, in a folder of their own.

A comment above a block states what else holds: ``slow`` (it runs in ``make test-slow``), ``tested: FILE::TEST``
(another test runs it) or ``not executed: REASON``; ``no block is executed: REASON`` is for a whole page.
"""

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from reorient import Camera, DepthImage, Goal, load_estimator
from reorient.cli import main
from reorient.imaging.files import write_depth
from reorient.world.objects import generated

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^(?:<!-- ([^\n]*) -->\n)?```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)
WHOLE_PAGE = re.compile(r"^<!-- no block is executed: .{10,} -->$", re.MULTILINE)

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="a source distribution has no docs")


def blocks(text: str) -> list[tuple[str, str, str]]:
    """Mark, language and text of each block; a page that is not executed has none."""
    return [] if WHOLE_PAGE.search(text) else [(m[1] or "", m[2], m[3]) for m in BLOCK.finditer(text)]


def wrong_mark(mark: str) -> bool:
    """Whether a mark is unknown, gives no reason, or names a test that does not exist."""
    if mark in ("", "slow"):
        return False
    kind, _, rest = mark.partition(": ")
    if kind == "tested":
        file, _, test = rest.partition("::")
        return not ((ROOT / file).is_file() and f"def {test}(" in (ROOT / file).read_text())
    return kind != "not executed" or len(rest) < 10


PLAIN = [page for page in PAGES if any(mark == "" for mark, _, _ in blocks(page.read_text()))]
SLOW = [page for page in PAGES if any(mark == "slow" for mark, _, _ in blocks(page.read_text()))]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder with what the pages name: pictures of a block before a wall, their camera, isolated images, a mesh."""
    block = block_of_the_example()
    folder = tmp_path_factory.mktemp("scene")
    camera = Camera(640, 480, 615.0, 615.0, 320.0, 240.0)
    for file, angle_deg in (("now.png", 0.0), ("goal.png", 15.0)):
        depth_m = block(camera, angle_deg)
        raw = np.round(1000 * np.where(depth_m > 0, depth_m, 0.75)).astype(np.uint16)
        Image.fromarray(raw).save(folder / file)
    (folder / "camera.json").write_text(json.dumps(camera.__dict__))
    (folder / "cam_K.txt").write_text("615 0 319.5\n0 615 239.5\n0 0 1\n")
    (folder / "scene_camera.json").write_text(
        json.dumps({"cam_K": [615, 0, 319.5, 0, 615, 239.5, 0, 0, 1], "width": 640, "height": 480, "depth_scale": 1.0})
    )
    small = Camera(128, 128, 331.0, 331.0, 64.0, 64.0)
    for file, angle_deg in (("now.npz", 0.0), ("goal.npz", 15.0)):
        write_depth(folder / file, DepthImage(block(small, angle_deg), small))
    objects = generated(1)
    objects.load(objects.names[0]).export(folder / "part.stl")
    (folder / "frames").mkdir()
    (folder / "my_meshes").mkdir()
    return folder


def block_of_the_example():
    """The depth of a block, of examples/estimate_from_arrays.py."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        from examples.estimate_from_arrays import block
    return block


def run(text: str, title: str, folder: Path, with_slow: bool = False) -> None:
    """Run the blocks of a page in the current folder, with the names that the pages take from the user."""
    small, big = (Camera(*x) for x in ((128, 128, 331.0, 331.0, 64.0, 64.0), (640, 480, 615.0, 615.0, 320.0, 240.0)))
    block = block_of_the_example()
    names: dict[str, object] = {"np": np, "load_estimator": load_estimator, "camera": big}
    names["current"], names["goal"] = (DepthImage(block(small, angle_deg), small) for angle_deg in (0.0, 15.0))
    names["image"] = names["side_image"] = names["current"]
    names["R_goal_side"] = np.eye(3)
    names["raw"] = raw = np.asarray(Image.open(folder / "now.png")).astype(np.uint16)
    names["frame"] = DepthImage.from_uint16(raw, big)
    names["mask"] = (raw > 0) & (raw < 700)
    names["estimate"] = load_estimator("gicp").estimate(names["current"], Goal(names["goal"]))
    for mark, language, code in blocks(text):
        if mark == "" or (with_slow and mark == "slow"):
            if language == "python":
                exec(compile(code, title, "exec"), names)
            else:
                for line in code.replace("\\\n", " ").splitlines():
                    command(shlex.split(line, comments=True))


def command(words: list[str]) -> None:
    if not words:
        return
    assert words[0] == "reorient", f"a command that a test cannot run: {words}"
    try:
        main(words[1:])
    except SystemExit as end:  # 1: the loop did not converge
        raise AssertionError(f"{words} ended with {end.code}") from end


@pytest.fixture
def here(scene, tmp_path, monkeypatch):
    shutil.copytree(scene, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT)])
    return tmp_path


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("page", PLAIN, ids=name)
def test_blocks_run(page, here):
    run(page.read_text(), name(page), here)


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("page", SLOW, ids=name)
def test_blocks_run_with_the_slow_ones(page, here):
    run(page.read_text(), name(page), here, with_slow=True)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_marks_are_right(page):
    assert [mark for mark, _, _ in blocks(page.read_text()) if wrong_mark(mark)] == []


@pytest.mark.parametrize(
    "mark",
    ["not executed: no", "slowly", "tested: tests/nowhere.py::test_x", "tested: tests/test_docs.py::test_nothing"],
)
def test_wrong_marks_are_found(mark):
    assert wrong_mark(mark)


@pytest.mark.parametrize("text", ["```python\nassert 1 == 2\n```", "```sh\nreorient estimate a.npz b.npz\n```"])
def test_a_block_that_fails_is_found(text, here):
    with pytest.raises(AssertionError):
        run(text, "planted.md", here)


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=name)
def test_the_notebook_runs(path, capsys):
    """Its cells in order, in one namespace; what it prints is what it holds."""
    names: dict[str, object] = {}
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), path.name, "exec"), names)
            stored = "".join("".join(output["text"]) for output in cell["outputs"])
            assert len(stored) < 2000
            assert words_of(capsys.readouterr().out) == words_of(stored)


def words_of(text: str) -> list[str]:
    """The words without numbers, which differ a little between machines."""
    return re.findall(r"[a-z]+", text)
