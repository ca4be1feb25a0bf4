"""The package on macOS and Windows, as far as its text shows: encodings, and modules that only POSIX systems have."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src" / "reorient"
POSIX_MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "termios", "tty"}
POSIX_NAMES = {"fork", "forkpty", "getpgid", "getuid", "geteuid", "killpg", "mkfifo", "setsid", "uname", "sysconf"}
POSIX_NAMES |= {"SIGKILL", "SIGSTOP", "SIGALRM", "SIGHUP", "setitimer", "sched_getaffinity", "getloadavg"}


def faults(text: str) -> Iterator[str]:
    """What would not work, or work differently, on another system; with the line."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = getattr(node, "module", None)
            names = {module} if module else {alias.name for alias in node.names}
            yield from (f"line {node.lineno}: import {name}" for name in names & POSIX_MODULES)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id in ("os", "signal") and node.attr in POSIX_NAMES:
                yield f"line {node.lineno}: {node.value.id}.{node.attr}"
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith(("/tmp", "/proc"))
        ):
            yield f"line {node.lineno}: {node.value!r}"
        elif isinstance(node, ast.Call) and without_encoding(node):
            yield f"line {node.lineno}: text without an encoding, which is another one on Windows"


def without_encoding(call: ast.Call) -> bool:
    """A call that opens text in the encoding of the system."""
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    words = {keyword.arg for keyword in call.keywords}
    values = [argument.value for argument in call.args if isinstance(argument, ast.Constant)]
    if "encoding" in words or "utf-8" in values:
        return False
    if name in ("read_text", "write_text"):
        return True
    modes = [each for each in values if isinstance(each, str) and set(each) <= set("rwaxbt+")]
    return name == "open" and any("b" not in mode for mode in modes)


def test_the_package_holds_no_code_for_one_system_alone():
    found = {path.name: list(faults(path.read_text(encoding="utf-8"))) for path in SOURCE.rglob("*.py")}
    assert {name: each for name, each in found.items() if each} == {}


@pytest.mark.parametrize(
    ("planted", "fault"),
    [
        ("import fcntl", "import fcntl"),
        ("def late():\n    from resource import getrusage", "import resource"),
        ("import os\nos.killpg(1, 9)", "os.killpg"),
        ("folder = '/tmp/x'", "'/tmp/x'"),
        ("path.read_text()", "without an encoding"),
        ("path.write_text(text)", "without an encoding"),
        ("path.open('w', newline='')", "without an encoding"),
    ],
)
def test_planted_code_for_one_system_is_found(planted, fault):
    assert any(fault in each for each in faults(planted))


@pytest.mark.parametrize("sound", ["path.read_text(encoding='utf-8')", "path.open('rb')", "os.getppid()", "x.open()"])
def test_portable_code_passes(sound):
    assert list(faults(sound)) == []
