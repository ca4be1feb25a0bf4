"""The list of verbs, the help of each, and the exit codes of the command itself."""

import inspect
import os
import re
import subprocess
import sys

import pytest

from reorient import __version__
from reorient.cli import main
from reorient.cli.arguments import make_parser, parse
from reorient.cli.verbs import GROUPS, VERBS
from reorient.errors import ReorientError
from reorient.estimators import NAMES


def run(capsys, *words: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error."""
    code = 0
    try:
        main(list(words))
    except SystemExit as ended:
        code = int(ended.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def options_of(verb: str) -> dict[str, str]:
    """The help text of each argument of a verb, as ``--help`` prints it."""
    help_text = make_parser(VERBS[verb].load(), f"reorient {verb}").format_help()
    found, name = {}, ""
    for line in help_text.split("\n\nexamples:")[0].splitlines():
        if match := re.match(r"  (-\S+|[A-Z_]{2,}(?=  |$))(?:.*?\S)??(?:  +(.*))?$", line):
            name = match[1].rstrip(",")
            found[name] = match[2] or ""
        elif name and line.startswith("        "):
            found[name] += f" {line.strip()}"
        else:
            name = ""
    return {name: text.strip() for name, text in found.items()}


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "110")


@pytest.mark.parametrize("verb", VERBS)
def test_every_option_has_a_help_text_that_is_a_sentence(verb):
    options = options_of(verb)
    assert "-h" in options
    for name, text in options.items():
        sentence = re.sub(r" \(default: .*\)$", "", text)
        assert re.fullmatch(r"[A-Z0-9].*[a-z0-9)\]'\"]\.", sentence), f"{verb} {name}: {text!r}"


@pytest.mark.parametrize("verb", VERBS)
def test_the_summary_of_a_verb_begins_its_help_and_an_example_parses(verb, capsys):
    doc = inspect.getdoc(VERBS[verb].load()) or ""
    assert doc.split("\n\n")[0] == VERBS[verb].summary
    assert re.fullmatch(r"[A-Z].*\.", VERBS[verb].summary)
    examples = [
        command
        for line in doc.partition("Examples:\n")[2].splitlines()
        for command in line.split("#")[0].split(">")[0].split("&&")
        if f"reorient {verb} " in command
    ]
    assert examples
    for command in examples:
        parse(VERBS[verb].load(), verb, command.split(f"reorient {verb} ")[1].split())


def test_the_list_of_verbs(capsys):
    code, out, _ = run(capsys, "--help")
    assert code == 0
    for group, verbs in GROUPS.items():
        assert f"\n{group}:\n" in out
        for name, verb in verbs.items():
            assert re.search(rf"^  {name} +{re.escape(verb.summary)}$", out, re.MULTILINE)
    assert max(map(len, out.splitlines())) <= 100
    code, out, _ = run(capsys, "objects", "--help")
    assert code == 0
    assert "objects make" in out
    assert "estimate" not in out
    assert run(capsys, "--version") == (0, f"reorient {__version__}\n", "")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no verb given (see reorient --help)"),
        (["estimte"], "unknown verb 'estimte': did you mean 'estimate'?"),
        (["estimte", "--help"], "unknown verb 'estimte': did you mean 'estimate'?"),
        (["qwerty"], "unknown verb 'qwerty' (see reorient --help)"),
        (["objects"], "incomplete verb 'objects': expected one of 'objects make', 'objects list', "),
        (["objects", "mak"], "unknown verb 'objects mak': did you mean 'objects make'?"),
        (["estimate"], "the following arguments are required: CURRENT, GOAL (see reorient estimate --help)"),
        (["estimate", "a"], "the following arguments are required: GOAL (see reorient estimate --help)"),
        (["estimate", "--nope"], "unknown option '--nope' (see reorient estimate --help)"),
        (["estimate", "a", "b", "--nope", "3"], "unknown option '--nope' (see reorient estimate --help)"),
        (["estimate", "a", "b", "--pivot", "1"], "argument --pivot: expected 3 numbers, got 1 (see reorient estimate"),
    ],
)
def test_a_wrong_command_is_one_line_and_code_2(words, message, capsys):
    code, out, err = run(capsys, *words)
    assert (code, out) == (2, "")
    assert err.startswith(f"reorient: {message}")
    assert err.count("\n") == 1


def test_a_closed_pipe_ends_silently():
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "reorient", "estimate", "--help"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert done.stderr == b""
    assert done.returncode == 141


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ReorientError("first\n  second"), 2, "reorient: first second\n"),
        (OSError(28, "No space left on device", "a.npz"), 2, "reorient: No space left on device a.npz\n"),
        (KeyboardInterrupt(), 130, "reorient: interrupted\n"),
    ],
)
def test_errors_of_a_verb_are_one_line(error, code, message, capsys, monkeypatch):
    def fail(*_):
        raise error

    monkeypatch.setattr("reorient.cli.parse", fail)
    assert run(capsys, "estimate", "a", "b") == (code, "", message)


@pytest.mark.parametrize("verb", ["estimate", "orient", "demo"])
def test_the_help_lists_every_estimator(verb):
    text = options_of(verb)["--estimator"]
    listed = text.partition(", an .onnx")[0].removeprefix("One of ").replace(" (rotation-search)", "")
    assert re.split(", | and ", listed) == list(NAMES)  # in the order of the error for an unknown one


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_shows_no_markup(verb):
    assert "``" not in make_parser(VERBS[verb].load(), f"reorient {verb}").format_help()
