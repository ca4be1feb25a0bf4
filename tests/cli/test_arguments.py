"""A dataclass as a command line: every type of field, every wrong word, and the text of the help."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import pytest

from reorient.cli.arguments import Metavar, Positional, Presets, make_parser, parse
from reorient.errors import OutOfRange, ReorientError


@dataclass(frozen=True)
class Inner:
    """Inner settings.

    One sentence more.
    """

    noise_mm: tuple[float, ...] = (0.0, 1.0)
    """Depth noise."""
    ranges_deg: tuple[tuple[float, float], ...] = ((0.0, 30.0),)
    """Ranges of angles."""
    count: int = 5
    """Number of things, 50% of all."""
    seed: int = 0
    """Seed of it."""

    def __post_init__(self) -> None:
        if self.count < 1:
            raise OutOfRange("count", self.count, "at least one thing")


RECIPES = {"small": Inner(count=1), "large": Inner(count=100)}


@dataclass(frozen=True)
class Outer:
    """Do something.

    Examples:
        program in.txt --pivot 1 2 3
    """

    source: Positional[Path]
    """File to read."""
    inner: Inner = field(default_factory=Inner)
    pivot_m: Annotated[tuple[float, float, float] | None, Metavar(("X", "Y", "Z"))] = None
    """Point in space."""
    part: Literal["all", "none"] = "all"
    """Part to do."""
    quick: bool = False
    """Do less."""
    name: str = "default"
    """Name of it."""


@dataclass(frozen=True)
class Trained:
    """Train."""

    out: Positional[Path]
    """Folder to write to."""
    recipe: Annotated[Inner, Presets(RECIPES)] = RECIPES["small"]
    """Settings to start from."""
    warm: Path | None = None
    """Weights to start from."""


def refused(config, *words: str) -> str:
    with pytest.raises(ReorientError) as error:
        parse(config, "program", words)
    return str(error.value)


def test_nothing_given_is_the_default():
    assert parse(Outer, "program", ["in.txt"]) == Outer(Path("in.txt"))


def test_every_type_of_field():
    words = "--pivot-m 0 -1e-3 .5 in.txt --part none --quick --noise-mm 2 3 --ranges-deg 0 30 30 60 --count 7 --name a"
    assert parse(Outer, "program", words.split()) == Outer(
        Path("in.txt"), Inner((2.0, 3.0), ((0.0, 30.0), (30.0, 60.0)), 7), (0.0, -0.001, 0.5), "none", True, "a"
    )


@pytest.mark.parametrize(
    ("words", "recipe"),
    [
        (["out"], Inner(count=1)),
        (["out", "large"], Inner(count=100)),
        (["--warm", "w", "out", "large", "--noise-mm", "3"], Inner((3.0,), count=100)),
        (["out", "--count", "4", "large"], Inner(count=4)),
    ],
)
def test_options_change_a_preset(words, recipe):
    assert parse(Trained, "program", words).recipe == recipe


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "the following arguments are required: SOURCE"),
        ("a --pivot-m 1 2", "argument --pivot-m: expected 3 numbers, got 2"),
        ("a --pivot-m 1 2 3 4", "unexpected argument '4' after --pivot-m"),
        ("a --pivot-m 1 2 x", "argument --pivot-m: expected a number, not 'x'"),
        ("a --count 1.5", "argument --count: expected a whole number, not '1.5'"),
        ("a --count -1.5", "argument --count: expected a whole number, not '-1.5'"),
        ("a --count", "argument --count: expected one argument"),
        ("a --noise-mm", "argument --noise-mm: expected at least one argument"),
        ("a --ranges-deg 0 30 60", "argument --ranges-deg: expected an even number of values, not 3"),
        ("a --part some", "argument --part: expected one of all, none, not 'some'"),
        ("a --cuont 3", "unknown option '--cuont': did you mean '--count'?"),
        ("a --coun 3", "unknown option '--coun': did you mean '--count'?"),  # no abbreviations
        ("a --zzz=3", "unknown option '--zzz' (see program --help)"),
        ("a b", "unexpected argument 'b' (see program --help)"),
        ("a --quick b", "unexpected argument 'b' after --quick"),
        ("a -3", "unexpected argument '-3'"),
        ("a --count 0", "--count 0: expected at least one thing"),
        ("--zzz", "unknown option '--zzz' (see program --help)"),
    ],
)
def test_wrong_words_are_one_sentence(words, message):
    said = refused(Outer, *words.split())
    assert said.startswith(message)
    assert "\n" not in said


def test_help_has_words_units_defaults_and_examples(monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    text = make_parser(Outer, "program").format_help()
    for part in (
        "usage: program SOURCE [options]\n\nDo something.\n\n",
        "--pivot-m X Y Z",
        "Point in space.\n",
        "--part {all,none}",
        "Part to do. (default: all)",
        "inner settings:\n  One sentence more.\n",
        "--noise-mm MM [MM ...]",
        "Depth noise. (default: 0 1)",
        "--ranges-deg DEG [DEG ...]",
        "Number of things, 50% of all. (default: 5)",
        "Seed of it. (default: 0)",
        "examples:\n  program in.txt --pivot 1 2 3",
    ):
        assert part in text, text
    trained = make_parser(Trained, "program").format_help()
    assert "usage: program OUT [RECIPE] [options]" in trained
    assert "Settings to start from. (default: small)" in trained
    assert "Depth noise.\n" in trained  # its default depends on the recipe
