"""The operator's quality log: a line of CSV for each object that a guide brought to the goal, or did not."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from io import StringIO
from pathlib import Path

import numpy as np

from reorient.controller.guiding import GuideState
from reorient.errors import ReorientError
from reorient.runs.files import writing
from reorient.runs.run import whole_lines

COLUMNS = ("date", "object", "result", "start_deg", "seconds", "final_deg", "confidence", "images", "losses")


@dataclass(eq=False)
class Trial:
    """One object before the camera."""

    begin_s: float | None = None
    """Time at which its rotation was first known."""
    start_deg: float | None = None
    last: GuideState | None = None
    """The latest state with a known rotation."""
    images: int = 0
    losses: int = 0
    """How often its rotation was lost."""
    matched: bool = False


class GuideLog:
    """A subscriber of a guide that appends a line for each object: when it has matched, or, by ``finish``, at the end.

    ``seconds``: from where the rotation was first known. ``final_deg``: the estimated angle to the goal, and
    ``confidence`` that of this estimate.
    """

    def __init__(
        self, path: Path | None, name: str = "", now: Callable[[], datetime] = lambda: datetime.now().astimezone()
    ) -> None:
        """``path`` None: counts only. ``name``: of the objects. Raises ReorientError for another file of that name."""
        self._path, self._name, self._now = path, name, now
        self.trial = Trial()
        self.matched: list[Trial] = []
        self._part, self._known = 0, False
        if path is not None:
            _check(path)

    def __call__(self, state: GuideState) -> None:
        """Take a state into account."""
        if state.part != self._part:
            self._part, self.trial, self._known = state.part, Trial(), False
        trial, known = self.trial, state.angle_rad is not None
        trial.images = trial.images + (trial.last is None or state.index != trial.last.index)
        trial.losses += self._known and not known
        self._known = known
        if not known:
            return
        if trial.begin_s is None:
            trial.begin_s, trial.start_deg = state.time_s, _degrees(state)
        trial.last = state
        if state.status == "matched" and not trial.matched:
            trial.matched = True
            self.matched.append(trial)
            self._write(trial, "matched")

    def finish(self) -> None:
        """The line of an object that was seen and did not match."""
        if self.trial.last is not None and not self.trial.matched:
            self._write(self.trial, "not matched")

    def _write(self, trial: Trial, result: str) -> None:
        if self._path is None:
            return
        state = trial.last
        assert state is not None
        assert trial.begin_s is not None
        cells = (
            self._now().isoformat(timespec="seconds"),
            self._name,
            result,
            f"{trial.start_deg:.2f}",
            f"{state.time_s - trial.begin_s:.2f}",
            f"{_degrees(state):.2f}",
            "" if state.confidence is None else f"{state.confidence:.3f}",
            str(trial.images),
            str(trial.losses),
        )
        new = not self._path.is_file() or not self._path.stat().st_size
        text = StringIO(newline="")
        csv.writer(text).writerows([*([COLUMNS] if new else []), cells])
        with writing(self._path), self._path.open("a", newline="", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text.getvalue())  # at once: whole lines, whenever the process is killed


def _degrees(state: GuideState) -> float:
    return float(np.degrees(state.angle_rad or 0.0))


def _check(path: Path) -> None:
    """Raise ReorientError where the file is there and is no log, or its folder is missing."""
    if not path.parent.is_dir():
        raise ReorientError(f"no folder {str(path.parent)!r} for the log: expected an existing folder")
    if path.is_file():
        text = path.read_text(encoding="utf-8", errors="replace")
        if text and text.splitlines()[0] != ",".join(COLUMNS):
            raise ReorientError(f"{str(path)!r} is no log of `reorient guide`: expected a new file, or one it wrote")
        whole_lines(path)  # half a line, of a full disk, must not begin the next one
