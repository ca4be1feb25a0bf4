"""Estimators by name."""

from pathlib import Path

from reorient.errors import ReorientError, unknown_name
from reorient.estimators.base import Estimator
from reorient.plugins import make_own

NAMES = ("default", "fast", "thorough", "gicp", "icp", "paper", "swift")


def load_estimator(name: str = "default") -> Estimator:
    """An estimator of the package, or one's own.

    ``default``: any rotation, with a calibrated confidence; ``fast`` and ``thorough`` are the same with less and more
    work. ``gicp``: generalised ICP, up to 60 degrees. ``icp``: the paper's baseline. ``my.onnx``: weights that
    ``reorient export`` wrote. ``my_module:MyEstimator``: a class, imported (the working folder included) and called
    with nothing. Raises ReorientError, a ValueError, for an unknown name.
    """
    if not isinstance(name, str):
        raise ReorientError(f"estimator {name!r}: expected a name, a string")
    if name.endswith(".onnx"):
        from reorient.estimators.learned import Learned

        return Learned(Path(name))
    if ":" in name:
        return _own(name)
    if name in ("default", "fast", "thorough"):
        from reorient.estimators.default import Default

        return Default("normal" if name == "default" else name)
    if name == "gicp":
        from reorient.estimators.gicp import GICP

        return GICP()
    if name == "icp":
        from reorient.estimators.icp import ICP

        return ICP()
    if name == "paper":
        from reorient.estimators.learned import Learned

        return Learned("paper")
    if name == "swift":
        from reorient.estimators.learned import SWIFT_ROUNDS, Learned

        return Learned("swift", SWIFT_ROUNDS)
    raise unknown_name("estimator", name, list(NAMES))


def _own(name: str) -> Estimator:
    estimator = make_own("estimator", name)
    if not isinstance(estimator, Estimator):
        raise ReorientError(f"estimator {name!r} has no estimate: expected a class with that method")
    return estimator
