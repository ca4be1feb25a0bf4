"""The documentation: links lead somewhere, Python blocks import what exists, commands have the options they use."""

import ast
import contextlib
import io
import os
import re
import shlex
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from reorient import so3
from reorient.cli import main
from reorient.estimators import load_estimator
from reorient.imaging import Camera
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import generated
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised

ROOT = Path(__file__).parents[1]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "src").rglob("*.md")]

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="a source distribution has no docs")


def fenced(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def prose(text: str) -> str:
    return re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)


# --- links ----------------------------------------------------------------------------------------------------------


def anchors(text: str) -> set[str]:
    """The anchors that GitHub makes of headings."""
    headings = re.findall(r"^#+ (.*)$", prose(text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(text: str, folder: Path) -> Iterator[str]:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(text)):
        if "://" in target:
            continue
        file, _, anchor = target.partition("#")
        path = folder / file
        if file and not path.exists():
            yield f"{target}: no such file"
        elif anchor and anchor not in anchors(path.read_text() if file else text):
            yield f"{target}: no such heading"


def broken_mentions(text: str) -> Iterator[str]:
    for target in re.findall(r"\b(?:docs|benchmarks|examples)/[\w-]+\.(?:md|png|gif|svg|py)\b", text):
        if not (ROOT / target).exists() and target not in REMOVED:
            yield f"{target}: no such file"


REMOVED = {"benchmarks/closed_loop.py", "benchmarks/compiled.py", "benchmarks/refining.py"}  # named as removed


# --- Python ---------------------------------------------------------------------------------------------------------


def broken_python(text: str) -> Iterator[str]:
    for block in fenced(text, "python"):
        try:
            tree = ast.parse(block)
        except SyntaxError as error:
            yield f"does not compile: {error}"
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                try:
                    exec(ast.unparse(node), {})
                except ImportError as error:
                    yield f"{ast.unparse(node)}: {error}"


# --- commands -------------------------------------------------------------------------------------------------------


def commands(text: str) -> Iterator[list[str]]:
    """The words of every command line, with the variables of its block replaced and comments removed."""
    for block in fenced(text, "sh"):
        joined = block.replace("\\\n", " ")
        for name, value in re.findall(r'^(\w+)="(.*)"$', joined, re.MULTILINE):
            joined = joined.replace(f"${name}", value)
        lines = [shlex.split(line, comments=True) for line in joined.splitlines() if not re.match(r"\w+=", line)]
        yield from filter(None, lines)
    for code in re.findall(r"`([^`]+)`", prose(text)):
        if code.startswith(("reorient ", "python ", "make ", "pip ", "--")):
            yield code.split()


@cache
def printed_help(*arguments: str) -> str:
    printed = io.StringIO()
    with (
        mock.patch.dict(os.environ, COLUMNS="200"),
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(io.StringIO()),
        contextlib.suppress(SystemExit),
    ):
        main([*arguments, "--help"])
    return printed.getvalue()


def help_of(verb: str) -> str:
    text = printed_help(*verb.split())
    recipes = ("paper", "swift", "debug") if verb == "train" else ()
    return text + "".join(printed_help("train", "data", "run", recipe) for recipe in recipes)


def options(text: str) -> set[str]:
    return set(re.findall(r"--[a-z][a-z0-9-]*", text))


@cache
def verbs() -> list[str]:
    """All verbs, those of two words included."""
    return re.findall(r"^  ([a-z-]+(?: [a-z-]+)?)  +[A-Z]", printed_help(), re.MULTILINE)


@cache
def all_options() -> set[str]:
    """Of all verbs and benchmarks."""
    scripts = "".join(path.read_text() for path in (ROOT / "benchmarks").glob("*.py"))
    fields = re.findall(r"^    (\w+): ", scripts, re.MULTILINE)
    return options(printed_help() + "".join(map(help_of, verbs()))) | {
        f"--{field.replace('_', '-')}" for field in fields
    }


def unknown_make(words: list[str]) -> list[str]:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    return [f"no target {word!r}" for word in words[1:] if word not in targets]


def unknown_pip(words: list[str]) -> list[str]:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = [name for part in re.findall(r"\[(.*)\]", " ".join(words)) for name in part.split(",")]
    return [f"no extra {name!r}" for name in named if name not in extras]


def unknown_python(words: list[str]) -> list[str]:
    script = ROOT / words[1]
    if not script.is_file():
        return ["no such script"]
    fields = set(re.findall(r"\w+", script.read_text()))
    unknown = options(" ".join(words)) - options(help_of("evaluate"))  # whose options several scripts share
    return [f"no option {option}" for option in unknown if option[2:].replace("-", "_") not in fields]


def unknown_reorient(words: list[str]) -> list[str]:
    named = [verb for verb in (" ".join(words[1:3]), words[1]) if verb in verbs()]
    if words[1] not in ("...", "VERB", "--help") and not named:
        return [f"no verb {' '.join(words[1:3])!r}"]
    known = options(help_of(named[0])) if named else options(printed_help())
    return [f"no option {option}" for option in options(" ".join(words)) - known]


def unknown_option(words: list[str]) -> list[str]:
    return [f"no option {option}" for option in options(" ".join(words)) - all_options()]


CHECKS = {"make": unknown_make, "pip": unknown_pip, "python": unknown_python, "reorient": unknown_reorient}


def broken_commands(text: str) -> Iterator[str]:
    for words in commands(text):
        if "-m" in words:  # torchrun -m reorient train
            words = words[words.index("-m") + 1 :]
        check = unknown_option if words[0].startswith("--") else CHECKS.get(words[0])
        yield from (f"{' '.join(words)}: {fault}" for fault in (check(words) if check else ["a command not checked"]))


# --- the pages ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_page(page, monkeypatch):
    monkeypatch.syspath_prepend(ROOT)  # for the pages that import examples
    text = page.read_text()
    broken = [*broken_links(text, page.parent), *broken_mentions(text), *broken_python(text), *broken_commands(text)]
    assert broken == []


def test_code_names_pages_and_scripts_that_exist():
    files = [path for folder in ("src", "benchmarks", "examples") for path in (ROOT / folder).rglob("*.py")]
    assert [f"{path.name}: {broken}" for path in files for broken in broken_mentions(path.read_text())] == []


@pytest.mark.parametrize(
    ("planted", "message"),
    [
        ("[x](nowhere.md)", "nowhere.md: no such file"),
        ("[x](../README.md#nowhere)", "../README.md#nowhere: no such heading"),
        ("[x](#nowhere)", "#nowhere: no such heading"),
        ("docs/nowhere.md", "docs/nowhere.md: no such file"),
        ("```python\nfrom reorient import nothing\n```", "from reorient import nothing: cannot import name"),
        ("```python\nimport reorient.nothing\n```", "import reorient.nothing: No module named"),
        ("```python\nx = = 1\n```", "does not compile"),
        ("```sh\nreorient estimate a.png b.png --explian c.png  # why\n```", "no option --explian"),
        ("```sh\nRUN='x'\nreorient estimate a b \\\n    --nowhere\n```", "no option --nowhere"),
        ('```sh\nRUN="--nowhere"\nreorient evaluate out $RUN\n```', "no option --nowhere"),
        ("```sh\nreorient estimte a b\n```", "no verb 'estimte a'"),
        ("`reorient objects nowhere`", "no verb 'objects nowhere'"),
        ("`reorient objects list --nowhere 1`", "no option --nowhere"),
        ("the option `--nowhere`", "no option --nowhere"),
        ("```sh\nmake nothing\n```", "no target 'nothing'"),
        ("`pip install 'reorient[nothing]'`", "no extra 'nothing'"),
        ("`python benchmarks/nowhere.py out`", "no such script"),
        ("`python benchmarks/calibration.py out --nowhere`", "no option --nowhere"),
    ],
)
def test_planted_faults_are_found(planted, message):
    folder = ROOT / "docs"
    checks = [broken_links(planted, folder), broken_mentions(planted), broken_python(planted), broken_commands(planted)]
    found = [broken for check in checks for broken in check]
    assert any(message in sentence for sentence in found), found


def test_the_block_of_the_readme_runs():
    (block,) = fenced((ROOT / "README.md").read_text(), "python")
    objects, rng = generated(1), np.random.default_rng(0)
    cell = RenderedStation(objects.load(objects.names[0]), load_world("benchmark"), randomised(), rng)
    goal = cell.capture_goal().depth_m
    R = so3.exp(np.array([0.0, np.radians(20), 0.0]))
    cell.rotate(R)
    names = {"depth_now_m": cell.capture().depth_m, "depth_goal_m": goal, "my_station": cell}
    exec(block, names)
    assert np.degrees(so3.angle_difference(names["estimate"].R_goal_current, R.T)) < 5
    assert names["result"].converged


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_the_block_of_the_robot_page_runs(monkeypatch, tmp_path):
    block, _ = fenced((ROOT / "docs" / "robot.md").read_text(), "python")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    monkeypatch.setattr("reorient.stations.simulated.CAMERA", Camera(160, 120, 165.0, 165.0, 80.0, 60.0))
    for module in ("reorient", "reorient.stations.calibrating"):  # the default takes three times as long
        monkeypatch.setattr(f"{module}.load_estimator", lambda name="gicp": load_estimator("gicp"))
    names: dict[str, object] = {}
    exec(block, names)
    cell = names["sdk_arm"].cell
    found = names["calibration"].T_base_camera[:3, :3]
    assert np.degrees(so3.angle_difference(found, cell.T_base_camera[:3, :3])) < 1
    assert names["result"].converged
