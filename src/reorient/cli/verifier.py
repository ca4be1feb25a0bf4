"""The verifier's verbs: make its data, train it."""

from dataclasses import dataclass, field
from pathlib import Path

from reorient.cli.arguments import Positional
from reorient.cli.progress import show_progress
from reorient.extras import require
from reorient.learning.verifier_data import VerifierData
from reorient.runs.pool import Pool


@dataclass(frozen=True)
class Make:
    """Generate hypotheses of known error to train the verifier on.

    One file holds those of a few objects. An interrupted run continues where it stopped.

    With several views the data is for the verifier of several views, whose features are the log-odds of the other one
    for each pair of views: take other objects than that was trained on.

    Examples:
        reorient verifier make out/verifier --count 5000 --workers 2
        reorient verifier make out/views --count 1500 --object-seed 1 --goal-views 2 3 4 5 6 --views-now 1 1 2 3
    """

    out: Positional[Path]
    """Folder for config.json and the shards."""
    config: VerifierData = field(default_factory=VerifierData)
    pool: Pool = field(default_factory=Pool)

    def run(self) -> None:
        """Make all shards that are missing."""
        from reorient.learning.verifier_data import make

        show_progress("shards", make(self.config, self.out, self.pool))


@dataclass(frozen=True)
class Train:
    """Train the verifier on generated hypotheses.

    Its figures on held-out objects are printed. Needs the extra ``train``.

    Examples:
        reorient verifier train out/verifier out/verifier.npz
        reorient verifier train out/views src/reorient/estimators/verifier-views.npz
    """

    data: Positional[Path]
    """Folder of ``reorient verifier make``."""
    out: Positional[Path]
    """File to write (.npz)."""
    also: Path | None = None
    """Folder of further data, of other objects."""
    fast: Path | None = None
    """Folder of other objects with ``--effort fast``, to calibrate that effort."""
    thorough: Path | None = None
    """Folder of other objects with ``--effort thorough``, to calibrate that effort."""

    def run(self) -> None:
        """Read, train, write, print."""
        require("sklearn")
        from reorient.learning.verifier import read, train

        folders = {"fast": self.fast, "thorough": self.thorough}
        others = {effort: read(folder) for effort, folder in folders.items() if folder is not None}
        data = read(self.data) if self.also is None else read(self.data).and_also(read(self.also))
        for name, value in train(data, self.out, others).items():
            print(f"{name}: {value:.4g}")
