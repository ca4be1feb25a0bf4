"""Estimators by name."""

from pathlib import Path

from reorient.errors import ReorientError, unknown_name
from reorient.estimators.base import Estimator, for_any_goal
from reorient.extras import extras_named
from reorient.plugins import make_own

NAMES = ("default", "rotation-search", "fast", "thorough", "gicp", "icp", "paper", "swift")


def load_estimator(name: str = "default") -> Estimator:
    """An estimator of the package, or a user's own.

    ``rotation-search``, or ``default``: any rotation, with a calibrated confidence; ``fast`` and ``thorough`` are the
    same with less and more work. ``gicp``: generalised ICP, up to 60 degrees. ``icp``: the paper's baseline. ``paper``
    and ``swift``: networks, up to 30 degrees. ``my.onnx``: weights that ``reorient export`` wrote.
    ``my_module:MyEstimator``: a class, imported (the working folder included) and called without arguments.

    Of a goal of several views ``rotation-search``, ``fast`` and ``thorough`` use all; the others, and a user's own that
    does not state ``several_views = True``, receive the primary one.

    Raises ReorientError, a ValueError, for an unknown name, and MissingExtra for ``icp`` without the extra ``sim``.
    """
    if not isinstance(name, str):
        raise ReorientError(f"estimator {name!r}: expected a name, a string")
    with extras_named():
        return for_any_goal(_load(name))


def _load(name: str) -> Estimator:
    if name.lower().endswith(".onnx"):
        from reorient.estimators.learned import Learned

        return Learned(Path(name))
    if ":" in name:
        return _own(name)
    if name not in NAMES:
        raise unknown_name("estimator", name, list(NAMES))
    return _MAKERS.get(name, _rotation_search)(name)


def _rotation_search(name: str) -> Estimator:
    from reorient.estimators.rotation_search import RotationSearch

    return RotationSearch(name if name in ("fast", "thorough") else "normal")


def _gicp(_: str) -> Estimator:
    from reorient.estimators.gicp import GICP

    return GICP()


def _icp(_: str) -> Estimator:
    from reorient.estimators.icp import ICP

    return ICP()


def _learned(name: str) -> Estimator:
    from reorient.estimators.learned import SWIFT_ROUNDS, Learned

    return Learned("swift", SWIFT_ROUNDS) if name == "swift" else Learned("paper")


_MAKERS = {"gicp": _gicp, "icp": _icp, "paper": _learned, "swift": _learned}


def _own(name: str) -> Estimator:
    estimator = make_own("estimator", name)
    if not isinstance(estimator, Estimator):
        raise ReorientError(f"estimator {name!r} has no estimate: expected a class with that method")
    return estimator
