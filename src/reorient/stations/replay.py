"""Recording of a station in a folder, and the folder as a station, so that a failure can become a test.

A record is ``record.json`` (the pivot, all captures, rotations and moves in order, errors included, and the answers of
``reachable``) beside ``goal.npz`` and one ``.npz`` for each frame. It is complete before and after every act; an act
that never ended has an error, too. A record names files inside its folder only, and runs no code.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller import OrientResult
from reorient.controller.station import Station, captured, clock_of, moved, pivot_of
from reorient.errors import ReorientError, StationError, in_short, reason_of
from reorient.imaging import DepthImage, Goal, as_goal
from reorient.imaging.files import read_depth, write_depth
from reorient.imaging.goal_files import read_goal, write_goal
from reorient.runs.files import make_folder, replacing
from reorient.se3 import Transform

UNFINISHED = "did not end"
SAME_RAD = float(np.radians(0.1))  # largest difference of a move from the recorded one
SAME_M = 0.0005  # the same for a translation


class RecordingStation:
    """A station whose acts are recorded. Raises ReorientError where the folder holds a record already."""

    def __init__(self, station: Station, folder: str | Path, goal: DepthImage | Goal, about: dict[str, Any]) -> None:
        """``about``: further entries of the record, as JSON (the estimator, the strategy)."""
        self._station = station
        pivot_m = pivot_of(station)
        self._folder = make_folder(folder)
        if (self._folder / "record.json").exists():
            raise ReorientError(f"{str(folder)!r} holds a record: expected a new folder")
        write_goal(self._folder / "goal.npz", as_goal(goal))
        self._record: dict[str, Any] = {
            **about,
            "pivot_m": None if pivot_m is None else np.asarray(pivot_m, float).tolist(),
            "acts": [],
        }
        if hasattr(station, "reachable"):
            self._record["reachable"] = []
            self.reachable = self._reachable
        if hasattr(station, "move"):
            self.move = self._move
        self._write()

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"] | None:
        """The station's."""
        return self._station.pivot_m

    def capture(self) -> DepthImage:
        """The station's frame."""
        name = f"{len(self._record['acts']):03d}.npz"
        self._begin({"capture": None})
        try:
            image = captured(self._station.capture())
            write_depth(self._folder / name, image)
        except BaseException as error:  # sys.exit and Ctrl-C, too
            self._note({"capture": None, "error": f"{type(error).__name__}: {error}"})
            raise
        self._note({"capture": name})
        return image

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The station's rotation."""
        done: np.ndarray = self._moved("rotate", R_step)
        return done

    def _move(self, T_step: Transform) -> Transform:
        """The station's translation."""
        done: np.ndarray = self._moved("move", T_step)
        return done

    def _moved(self, kind: str, step: np.ndarray) -> Any:
        asked = np.asarray(step, float).tolist()
        self._begin({kind: asked, "executed": None})
        ended: dict[str, Any] = {kind: asked, "executed": None}
        try:
            done = getattr(self._station, kind)(step)
            ended["executed"] = _as_list(done)
            if kind == "move":
                ended["pivot_m"] = _as_list(self.pivot_m)
        except BaseException as error:
            ended["error"] = f"{type(error).__name__}: {error}"
            raise
        finally:
            self._note(ended | {"clock_s": clock_of(self._station)})
        return done

    def _reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """The station's answer, recorded with the number of acts before it."""
        can = bool(self._station.reachable(R_step))  # type: ignore[attr-defined]
        asked = np.asarray(R_step, float).tolist()
        self._record["reachable"].append({"acts": len(self._record["acts"]), "R_step": asked, "can": can})
        self._write()
        return can

    def finish(self, result: OrientResult) -> None:
        """Record how the loop ended."""
        self._record |= {"status": result.status, "reason": result.reason, "converged": result.converged}
        self._write()

    def __getattr__(self, name: str) -> Any:
        """Optional members of the station: ``clock_s``, ``stop``."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._station, name)

    def _begin(self, act: dict[str, Any]) -> None:
        """Record an act before it is done."""
        self._record["acts"].append(act | {"error": UNFINISHED})
        self._write()

    def _note(self, act: dict[str, Any]) -> None:
        """Record how the latest act ended."""
        json.dumps(act)  # an act that is not JSON must not be kept: the record could not be written any more
        self._record["acts"][-1] = act
        self._write()

    def _write(self) -> None:
        with replacing(self._folder / "record.json") as temporary:
            temporary.write_text(json.dumps(self._record), encoding="utf-8")


class ReplayedStation:
    """A record as a station: the same frames, answers and errors. A loop that commands another move than the recorded
    one has left the record, and gets a StationError."""

    def __init__(self, folder: str | Path) -> None:
        """Raises ReorientError for a folder without a record, a broken one, and one that names files outside it."""
        self._folder = Path(folder)
        file = self._folder / "record.json"
        if not file.is_file():
            raise ReorientError(f"no record.json in {str(folder)!r}: expected a folder of `reorient orient --record`")
        try:
            self.record = _present_form(json.loads(file.read_text(encoding="utf-8")))
            self._acts = [_checked(act) for act in self.record["acts"]]
            pivot = self.record["pivot_m"]
            self._pivot_m = None if pivot is None else np.array(pivot, float)
            answers = self.record.get("reachable")
            self._answers = [(a["acts"], _rotation(a["R_step"]), bool(a["can"])) for a in answers or ()]
        except Exception as error:
            raise ReorientError(
                f"cannot read {str(file)!r} ({reason_of(error)}): expected a folder of `reorient orient --record`"
            ) from error
        for act in self._acts:
            self.file(act.get("capture") or "goal.npz")
        if answers is not None:
            self.reachable = self._reachable
        self._next = 0
        self._clock_s = -np.inf

    @property
    def pivot_m(self) -> Float[np.ndarray, "3"] | None:
        """The station's."""
        return self._pivot_m

    def goal(self) -> Goal:
        """The goal of the record, with all its views."""
        return read_goal(self.file("goal.npz"))

    def file(self, name: str) -> Path:
        """A file of the record. Raises ReorientError for one outside its folder, by a link, too."""
        path = (self._folder / name).resolve()
        if not path.is_relative_to(self._folder.resolve()):
            raise ReorientError(
                f"{str(self._folder)!r} names the file {in_short(name)!r}, which is outside: expected files "
                "inside the record"
            )
        return path

    def capture(self) -> DepthImage:
        """The next frame of the record."""
        act = self._act("capture")
        return read_depth(self.file(act["capture"]))

    def rotate(self, R_step: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
        """The recorded rotation, if this is the recorded move."""
        return np.array(self._act("rotate", R_step)["executed"], float)

    def move(self, T_step: Transform) -> Transform:
        """The recorded translation, if this is the recorded move."""
        act = self._act("move", T_step)
        self._pivot_m = None if act["pivot_m"] is None else np.array(act["pivot_m"], float)
        return np.array(act["executed"], float)

    def _reachable(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """The recorded answer for this rotation before the next act. Raises StationError where there is none."""
        asked = [
            (float(so3.angle_difference(R, np.asarray(R_step, float))), can)
            for acts, R, can in self._answers
            if acts == self._next
        ]
        away_rad, can = min(asked, default=(np.inf, False))
        if away_rad > SAME_RAD:
            raise StationError(f"the loop leaves the record at act {self._next}: reachable() of another move")
        return can

    def clock_s(self) -> float:
        """The station's clock after the last move; minus infinity where it had none."""
        return self._clock_s

    def _act(self, kind: str, step: np.ndarray | None = None) -> dict[str, Any]:
        if self._next >= len(self._acts):
            raise StationError("the record ends here")
        act: dict[str, Any] = self._acts[self._next]
        if kind not in act:
            raise StationError(f"the loop leaves the record at act {self._next}: {kind} requested")
        if step is not None and (away := _difference(np.array(act[kind], float), np.asarray(step, float))):
            raise StationError(f"the loop leaves the record at act {self._next}: a move {away} off the recorded one")
        self._next += 1
        if step is not None:
            self._clock_s = -np.inf if act.get("clock_s") is None else float(act["clock_s"])
        if act.get("error"):
            raise StationError(f"recorded error: {act['error']}")
        return act


def _checked(act: Any) -> dict[str, Any]:
    """An act of a record. Raises ValueError, TypeError, KeyError or AttributeError where it is none."""
    float(act.get("clock_s") or 0)
    if "rotate" in act:
        _rotation(act["rotate"])
        np.array(act["executed"], float)
    elif "move" in act:
        moved(act["move"])
        np.array(act["executed"], float)
    elif not act.get("error") and not isinstance(act["capture"], str):
        raise ValueError(f"a capture of {in_short(act['capture'])}")
    return dict(act)


def _difference(recorded: np.ndarray, step: np.ndarray) -> str:
    """How far a move is from the recorded one, in words; empty within the tolerance."""
    away_rad = float(so3.angle_difference(recorded[:3, :3], step[:3, :3]))
    away_m = float(np.linalg.norm(recorded[:3, 3:] - step[:3, 3:]))  # 0 for rotations
    if away_rad <= SAME_RAD and away_m <= SAME_M:
        return ""
    return f"{np.degrees(away_rad):.1f} deg" + (f" and {1000 * away_m:.1f} mm" if step.shape == (4, 4) else "")


def _rotation(R: Any) -> Float[np.ndarray, "3 3"]:
    """A rotation matrix. Raises ValueError or TypeError where it is none."""
    matrix = np.array(R, float)
    if not so3.is_rotation(matrix):
        raise ValueError(f"no rotation: {in_short(R)}")
    return matrix


def _as_list(R: Any) -> Any:
    """The result of ``rotate`` as JSON; None where it is no array of numbers."""
    try:
        return np.asarray(R, float).tolist()
    except (TypeError, ValueError):
        return None


def _present_form(record: Any) -> dict[str, Any]:
    """A record with the settings of its loop in their present form, where it has them in an earlier one."""
    if isinstance(record.get("strategy"), list):
        record["strategy"] = dict(zip(("strategy", "max_images", "eta", "delta_deg"), record["strategy"], strict=True))
    if "largest_step_deg" in record:
        record["limits"] = {
            "max_step_deg": record["largest_step_deg"],
            "max_rotation_deg": record.get("largest_total_deg"),
            "dry_run": bool(record.get("dry_run")),
        }
    return dict(record)
