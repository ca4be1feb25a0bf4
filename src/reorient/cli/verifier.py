"""The verifiers' verbs: make their data, train them, calibrate what depends on them."""

from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path

from reorient.cli.arguments import Positional
from reorient.cli.progress import show_progress
from reorient.extras import require
from reorient.learning.calibration import CalibrationData
from reorient.learning.recipes import ImageTraining
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
        reorient verifier make out/views --object-seed 1 --goal-views 2 3 4 5 6 --views-now 1 1 2 3 --mirrored 0.2
        reorient verifier make out/images --count 2000 --object-seed 2 --least-deg 60 --images
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
    also: tuple[Path, ...] = ()
    """Folders of further data, of other objects."""
    fast: Path | None = None
    """Folder of other objects with ``--effort fast``, to calibrate that effort."""

    def run(self) -> None:
        """Read, train, write, print."""
        require("sklearn")
        from reorient.learning.verifier import Shards, read, train

        others = {} if self.fast is None else {"fast": read(self.fast)}
        data = reduce(Shards.and_also, map(read, (self.data, *self.also)))
        for name, value in train(data, self.out, others).items():
            print(f"{name}: {value:.4g}")


@dataclass(frozen=True)
class TrainImages:
    """Train the verifier on images of unsure hypotheses.

    It is a network that decides where the boosted trees are unsure. A run
    continues in the folder of an interrupted one. Needs the extra ``train``.

    Examples:
        reorient verifier images out/images --run-folder out/run --out out/verifier-images.onnx
        reorient verifier images out/images out/more --run-folder out/2 --out out/2.onnx --start out/run/last.ckpt
    """

    data: Positional[tuple[Path, ...]]
    """Folders of ``reorient verifier make --images``, of different objects."""
    run_folder: Path
    """Folder of the run: checkpoint and figures of each round."""
    out: Path
    """File to write (.onnx)."""
    start: Path | None = None
    """Checkpoint (.ckpt) of another run, whose weights this one begins with."""
    fast: Path | None = None
    """Folder of other objects with ``--effort fast``, to calibrate that effort."""
    config: ImageTraining = field(default_factory=ImageTraining)

    def run(self) -> None:
        """Read, train, calibrate, write, print."""
        require("sklearn", "torch", "onnx")
        from reorient.learning.image_sets import read_sets
        from reorient.learning.image_training import Run, finish

        others = {} if self.fast is None else {"fast": read_sets([self.fast], "fast")}
        training = Run(read_sets(self.data), self.run_folder, self.config, self.start)
        for done in training.go_on():
            print(done.line, flush=True)
        for figures in training.compared():
            print(", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
        for effort, (scale, shift) in finish(training, self.out, others).items():
            print(f"{effort}: scale {scale:.3f}, shift {shift:.3f}")


@dataclass(frozen=True)
class Calibrate:
    """Calibrate confidence sets and covariances on generated objects.

    The estimates are of `default` on objects that the verifier was not trained on. An interrupted run continues where
    it stopped. Run it anew after the verifier was trained: sets of another verifier have no guarantee.

    Examples:
        reorient verifier calibrate out/calibration --count 500 --workers 2
        reorient verifier calibrate out/calibration --write src/reorient/estimators/calibration.json
    """

    out: Positional[Path]
    """Folder for config.json and the rows of all estimates."""
    config: CalibrationData = field(default_factory=CalibrationData)
    also: Path | None = None
    """Folder of further rows, as of several goal views."""
    write: Path | None = None
    """File to write (.json); without it the figures are printed alone."""
    pool: Pool = field(default_factory=Pool)

    def run(self) -> None:
        """Make the rows that are missing, fit, write, print."""
        from reorient.learning.calibration import fit, measure, read

        show_progress("objects", measure(self.config, self.out, self.pool))
        rows = read(self.out) if self.also is None else read(self.out) + read(self.also)
        for name, value in fit(rows, self.write).items():
            print(f"{name}: {value:.4g}")
