"""What made a run: its config, version, commit and command, kept beside its rows."""

import json
import shlex
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reorient import __version__
from reorient.errors import ReorientError
from reorient.runs.files import replacing


def run_record(config: Any, **more: Any) -> dict[str, Any]:
    """What made a run, for its config.json: the config (a dataclass), version, commit and command."""
    asked = json.loads(json.dumps(asdict(config), default=str))
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    return {"config": asked, "version": __version__, "commit": commit(), "command": command, **more}


def keep_record(file: Path, config: Any, run: str) -> None:
    """Write what makes a run into ``file``, or compare with what made it. Raises ReorientError for another config, in
    which ``run`` names the run."""
    record = run_record(config)
    if not file.is_file():
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(record, indent=2) + "\n")
        return
    if read_record(file).get("config") != record["config"]:
        raise ReorientError(f"{run} is of another config: expected the same, or a new folder")


def read_record(file: Path) -> dict[str, Any]:
    """What is kept in ``file``. Raises ReorientError where it is torn or something else."""
    try:
        return dict(json.loads(file.read_text()))
    except (ValueError, TypeError) as error:
        raise ReorientError(f"broken {str(file)!r} ({error}): expected the config of a run") from error


def commit() -> str | None:
    """What this package is at, in a clone of its repository; None where it is installed."""
    try:
        root = Path(__file__).parents[3]
        if not (root / "pyproject.toml").is_file():  # installed: a repository around it is somebody else's
            return None
        return subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=root, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
