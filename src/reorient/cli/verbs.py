"""The verbs, by group: the class behind each, imported only when it is asked for, and its line in the help."""

from dataclasses import dataclass
from importlib import import_module
from typing import Protocol, cast, runtime_checkable

from reorient.cli.arguments import did_you_mean
from reorient.errors import ReorientError, in_short

HELP = ("-h", "--help")


@runtime_checkable
class Command(Protocol):
    """What the class of a verb makes of its options."""

    def run(self) -> int | None:
        """Do it; the exit code, None for 0."""


@dataclass(frozen=True)
class Verb:
    """A verb of the command line."""

    place: str
    """Module of ``reorient.cli`` and class, ``estimating:Estimate``."""
    summary: str
    """One sentence, which also begins the docstring of the class."""

    def load(self) -> type[Command]:
        """The class."""
        module, _, name = self.place.partition(":")
        return cast(type[Command], getattr(import_module(f"reorient.cli.{module}"), name))


GROUPS = {
    "estimate": {
        "estimate": Verb("estimating:Estimate", "Estimate the rotation between two depth images of one object."),
        "transfer": Verb("transferring:Transfer", "Transfer taught tool poses to where the object is now."),
    },
    "goal": {
        "goal check": Verb("goals:Check", "State what a goal can and cannot tell."),
        "goal from-mesh": Verb("goals:FromMesh", "Render a goal from a mesh."),
    },
    "robot": {
        "new-robot": Verb("robot_setup:NewRobot", "Write a commented robot.toml to fill in."),
        "calibrate": Verb("robot_setup:Calibrate", "Find the camera's pose and the pivot by rotating the held object."),
        "check": Verb("robot_setup:Check", "Check a robot cell by small motions, and name a mistake in words."),
        "demo": Verb("demo:Demo", "Rotate a simulated object to a goal, and write a GIF and a page of the run."),
        "capture": Verb("capturing:Capture", "Capture the goal at a station."),
        "orient": Verb("robot:Orient", "Rotate the object at a station until it matches the goal image."),
        "guide": Verb(
            "guiding:Guide",
            "Guide a person who rotates the object by hand until it matches the goal image.",
        ),
        "replay": Verb("robot:Replay", "Run a recorded loop again, without its station."),
        "view": Verb("viewing:View", "Show a record, or a live station, in 3D in a browser."),
    },
    "measure": {
        "evaluate": Verb(
            "evaluating:Evaluate",
            "Measure the errors of estimators on simulated pairs, or on a BOP dataset.",
        ),
        "report": Verb("evaluating:Report", "Write an HTML page of an evaluation."),
        "loops": Verb("loops:Loops", "Measure closed loops at simulated stations."),
        "cell": Verb("cell:Cell", "Run the experiment with physical objects in a simulated robot cell."),
        "reproduce": Verb("reproducing:Reproduce", "Make a figure of the paper again."),
    },
    "objects": {
        "objects make": Verb("objects:Make", "Write the meshes of an object set to a folder."),
        "objects list": Verb("objects:List", "Print the names of an object set."),
        "objects check": Verb("objects:Check", "Measure shape and symmetry of every object of a set."),
        "objects montage": Verb("objects:Montage", "Draw the objects of a set in one picture."),
    },
    "learn": {
        "generate": Verb("learning:Generate", "Generate pairs of depth images with known rotations for training."),
        "train": Verb("learning:Train", "Train a network on generated pairs."),
        "export": Verb("learning:Export", "Convert trained weights to ONNX, which the estimators read."),
        "verifier make": Verb("verifier:Make", "Generate hypotheses of known error to train the verifier on."),
        "verifier train": Verb("verifier:Train", "Train the verifier on generated hypotheses."),
        "verifier calibrate": Verb(
            "verifier:Calibrate", "Calibrate confidence sets and covariances on generated objects."
        ),
    },
}
VERBS = {name: verb for group in GROUPS.values() for name, verb in group.items()}


def find(words: list[str]) -> str | None:
    """The verb that a command line begins with; None where it asks for the list of verbs.

    Raises ReorientError for an unknown verb.
    """
    name = next((" ".join(words[:n]) for n in (2, 1) if " ".join(words[:n]) in VERBS), None)
    if name is not None:
        return name
    family = [verb for verb in VERBS if verb.startswith(f"{words[0]} ")]
    if words[0] in HELP or (family and words[-1] in HELP):
        return None
    if family and len(words) == 1:
        raise ReorientError(f"incomplete verb {words[0]!r}: expected one of {', '.join(map(repr, family))}")
    asked = " ".join(words[: 2 if family else 1])
    raise ReorientError(
        f"unknown verb {in_short(asked)!r}{did_you_mean(asked, list(VERBS)) or ' (see reorient --help)'}"
    )


def overview(family: str = "") -> str:
    """All verbs, one a line, by group; ``family``: only those that begin with this word."""
    lines = []
    for group, verbs in GROUPS.items():
        shown = {name: verb for name, verb in verbs.items() if name.startswith(family)}
        if shown:
            lines += ["", f"{group}:", *(f"  {name:18s} {verb.summary}" for name, verb in shown.items())]
    return "\n".join(lines)
