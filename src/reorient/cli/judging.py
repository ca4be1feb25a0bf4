"""The judge's verbs: make its data, train it."""

from dataclasses import dataclass, field
from pathlib import Path

from reorient.cli.arguments import Positional
from reorient.cli.learning import require
from reorient.cli.progress import show_progress
from reorient.learning.verifier import JudgeData


@dataclass(frozen=True)
class Make:
    """Write hypotheses of known error, a file for a few objects. An interrupted run goes on where it stopped.

    For example: reorient judge make out/judge --count 5000 --workers 2
    """

    out: Positional[Path]
    """Folder for the shards."""
    config: JudgeData = field(default_factory=JudgeData)
    workers: int = 1

    def run(self) -> None:
        """All shards that are missing."""
        from reorient.learning.verifier import make

        show_progress("shards", make(self.config, self.out, self.workers))


@dataclass(frozen=True)
class Train:
    """Train the judge on a folder of shards (needs the extra ``train``); prints what it is worth on others.

    For example: reorient judge train out/judge out/judge.npz
    """

    data: Positional[Path]
    """What ``reorient judge make`` wrote."""
    out: Positional[Path]
    """File to write (.npz)."""
    fast: Path | None = None
    """What it wrote of other objects with ``--effort fast``, to calibrate that."""
    thorough: Path | None = None
    """The same with ``--effort thorough``."""

    def run(self) -> None:
        """Read, train, write, print."""
        require("train", "sklearn")
        from reorient.learning.verifier import read, train

        folders = {"fast": self.fast, "thorough": self.thorough}
        others = {effort: read(folder) for effort, folder in folders.items() if folder is not None}
        for name, value in train(read(self.data), self.out, others).items():
            print(f"{name}: {value:.4g}")
