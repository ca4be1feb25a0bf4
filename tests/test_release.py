"""The files of a release agree: version, changelog, licence, metadata."""

import re
import tomllib
from datetime import date
from importlib.resources import files
from pathlib import Path

import pytest

from reorient import __version__

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
HEADING = re.compile(r"^## \[(.+?)\](?: - (.+))?$", re.MULTILINE)


def changelog_faults(text: str, version: str) -> list[str]:
    """What a release of the version would stumble over."""
    headings = HEADING.findall(text)
    found = [] if headings[:1] == [("Unreleased", "")] else ["no Unreleased at first"]
    dated = headings[1:]
    if not dated or dated[0][0] != version:
        found.append(f"the first release is not {version}")
    found += [f"{name}: no date" for name, day in dated if not re.fullmatch(r"\d{4}-\d\d-\d\d", day)]
    days = [date.fromisoformat(day) for _, day in dated if re.fullmatch(r"\d{4}-\d\d-\d\d", day)]
    if days != sorted(days, reverse=True):
        found.append("the newest is not first")
    kinds = set(re.findall(r"^### (.*)$", text, re.MULTILINE))
    found += [f"section {kind}" for kind in kinds - {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}]
    found += [f"{name}: no link" for name, _ in headings if f"\n[{name}]: " not in text]
    return found


def test_the_changelog_has_the_version():
    version = __version__.split(".dev")[0]
    assert changelog_faults((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version) == []


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("## [1.0.0] - 2026-01-02\n", "no Unreleased at first"),
        ("## [Unreleased]\n\n## [0.9.0] - 2026-01-02\n", "the first release is not 1.0.0"),
        ("## [Unreleased]\n\n## [1.0.0]\n", "1.0.0: no date"),
        ("## [Unreleased]\n\n## [1.0.0] - 2025-01-02\n\n## [0.9.0] - 2026-01-02\n", "the newest is not first"),
        ("## [Unreleased]\n\n### News\n", "section News"),
        ("## [Unreleased]\n", "Unreleased: no link"),
    ],
)
def test_faults_of_a_changelog_are_found(text, fault):
    assert fault in changelog_faults(text, "1.0.0")


def test_the_version_stands_in_one_place():
    assert re.fullmatch(r"\d+\.\d+\.\d+(\.dev\d+)?", __version__)
    assert PROJECT["project"]["dynamic"] == ["version"]
    assert PROJECT["tool"]["hatch"]["version"] == {"path": "src/reorient/__init__.py"}
    assert not re.search(r"^version:", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_package_holds_its_licence_types_and_weights():
    assert PROJECT["project"]["license"] == "Apache-2.0"  # an SPDX expression
    assert all((ROOT / name).is_file() for name in PROJECT["project"]["license-files"])
    package = files("reorient")
    assert package.joinpath("py.typed").is_file()
    assert all(package.joinpath("weights", f"{name}.onnx").is_file() for name in ("paper", "swift"))
    assert package.joinpath("estimators", "verifier.npz").is_file()


def test_each_requirement_has_a_lower_bound():
    """Of what users install; tests and linters follow the newest."""
    extras = PROJECT["project"]["optional-dependencies"]
    requirements = [*PROJECT["project"]["dependencies"], *extras["sim"], *extras["train"], *extras["view"]]
    without = [each for each in requirements if not re.search(r">=|^reorient\[", each)]
    assert without == []
