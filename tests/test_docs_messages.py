"""docs/troubleshooting.md has every message of the source, and no other; the statuses are those of the code."""

import re
from functools import cache
from pathlib import Path
from typing import get_args

import pytest

from docs_messages import messages
from reorient.controller import Status
from reorient.controller.guiding import GuideStatus

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="a source distribution has no docs")


def first_column(text: str) -> list[str]:
    """The code in the first column of every table."""
    rows = re.findall(r"^\| (.*?)(?<!\\)\|", text, re.MULTILINE)
    spans = re.findall(r"`` (.*?) ``|`(.*?)`", "\n".join(rows).replace("\\|", "|"))
    return [double or single for double, single in spans]


def section(page: str, title: str) -> str:
    return (DOCS / page).read_text().partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def messages_of_the_page() -> list[str]:
    return first_column((DOCS / "troubleshooting.md").read_text().partition("<!-- messages -->")[2])


@cache
def messages_of_the_source(fewest_words: int = 3) -> set[str]:
    return {text for path in (ROOT / "src").rglob("*.py") for text in messages(path.read_text(), fewest_words)}


def test_every_message_has_its_cause_and_cure():
    """A message that was added or reworded: mend its row in docs/troubleshooting.md."""
    assert sorted(messages_of_the_source() - set(messages_of_the_page())) == []


def test_no_message_of_the_page_is_gone_from_the_source():
    assert sorted(set(messages_of_the_page()) - messages_of_the_source(fewest_words=0)) == []


def test_no_message_is_listed_twice():
    listed = messages_of_the_page()
    assert len(listed) == len(set(listed))


def test_rows_are_complete():
    table = (DOCS / "troubleshooting.md").read_text().partition("<!-- messages -->")[2]
    rows = [row for row in table.splitlines() if row.startswith("| `")]
    assert len(rows) > 100
    assert [row for row in rows if len(re.split(r"(?<!\\)\|", row)) != 5 or re.search(r"\|\s+\|", row)] == []


def test_statuses_of_the_loop():
    assert set(first_column(section("failed-loop.md", "Statuses"))) == set(get_args(Status))


def test_statuses_of_the_guide():
    assert set(get_args(GuideStatus)) <= set(first_column(section("guide.md", "Instructions")))


def test_mistakes_that_the_check_names():
    source = "".join((ROOT / "src/reorient/stations" / f"{name}.py").read_text() for name in ("mistakes", "checking"))
    named = set(re.findall(r'(?:Mistake|Check)\(\s*"([^"]+)"', source))
    assert set(first_column(section("troubleshooting.md", "What `reorient check` names"))) == named


def test_messages_are_found_in_every_form():
    source = """
def f(x):
    raise ReorientError(f"no mesh file {x!r}: expected "
                        f"one of {x}")
    raise OutOfRange("eta", x, "a number from 0 to 1")
    raise unknown_name("world of shapes", x, [])
    verified.with_warning("the pivot is " + x)
    self.warnings.append(f"view {x} is left out")
    raise ReorientError(str(x))
"""
    assert messages(source) == {
        "no mesh file …: expected one of …",
        "eta=…: expected a number from 0 to 1",
        "unknown world of shapes …: expected one of …",
        "the pivot is …",
        "view … is left out",
    }
