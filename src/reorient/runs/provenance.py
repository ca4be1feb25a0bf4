"""Provenance of a run: config, version, commit and command, in a file beside its rows."""

import json
import shlex
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reorient import __version__
from reorient.errors import ReorientError, reason_of
from reorient.runs.files import replacing


def run_record(config: Any, **more: Any) -> dict[str, Any]:
    """The contents of config.json: the config (a dataclass), version, commit and command."""
    plain = json.loads(json.dumps(asdict(config), default=str))
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    return {"config": plain, "version": __version__, "commit": commit(), "command": command, **more}


def keep_record(file: Path, record: dict[str, Any], compared: tuple[str, ...] = ("config",)) -> None:
    """Write the record of a run, or compare it with the one in the file.

    Raises ReorientError where the file has another value for one of the keys ``compared``, or is broken.
    """
    if not file.is_file():
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        return
    earlier = read_record(file)
    if any(earlier.get(key) != record[key] for key in compared):
        raise ReorientError(
            f"{str(file.parent)!r} holds a run of another config: expected the same config, or a new folder"
        )


def read_record(file: Path) -> dict[str, Any]:
    """The record in a file. Raises ReorientError where it is broken."""
    try:
        return dict(json.loads(file.read_text(encoding="utf-8")))
    except (ValueError, TypeError, RecursionError) as error:
        raise ReorientError(f"broken {str(file)!r} ({reason_of(error)}): expected the config of a run") from error


def commit() -> str | None:
    """The commit of this package in a clone of its repository; None where it is installed."""
    try:
        root = Path(__file__).parents[3]
        if not (root / "pyproject.toml").is_file():  # installed: a repository around it is somebody else's
            return None
        return subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=root, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
