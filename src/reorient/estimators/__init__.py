"""Estimators by name."""

from pathlib import Path

from reorient.errors import ReorientError, unknown_name
from reorient.estimators.base import Estimator, for_any_goal
from reorient.extras import extras_named
from reorient.plugins import make_own

NAMES = ("default", "rotation-search", "fast", "normal", "gicp", "icp", "paper", "swift")


def load_estimator(name: str = "default", effort: str | None = None) -> Estimator:
    """An estimator of the package, or a user's own.

    ``rotation-search``, or ``default``: any rotation, with a calibrated confidence; it begins with little work and does
    more where that leaves doubt. ``effort`` fixes the work: fast or normal, which are names, too. ``gicp``: generalised
    ICP, up to 60 degrees. ``icp``: the paper's baseline. ``paper`` and ``swift``: networks, up to 30 degrees.
    ``my.onnx``: weights that ``reorient export`` wrote. ``my_module:MyEstimator``: a class, imported (also from the
    working folder) and called without arguments.

    Of a goal of several views ``rotation-search``, ``fast`` and ``normal`` use all; the others, and a user's own that
    does not state ``several_views = True``, receive the primary one.

    Raises ReorientError, a ValueError, for an unknown name, an unknown effort, and an effort of another estimator, and
    MissingExtra for ``icp`` without the extra ``sim``.
    """
    if not isinstance(name, str):
        raise ReorientError(f"estimator {name!r}: expected a name, a string")
    if effort is not None:
        return _with_effort(name, effort)
    with extras_named():
        return for_any_goal(_load(name))


def _with_effort(name: str, effort: str) -> Estimator:
    if name not in ("default", "rotation-search"):
        raise ReorientError(f"estimator {name!r} with effort={effort!r}: expected an effort with 'default' alone")
    from reorient.estimators.rotation_search import RotationSearch

    return RotationSearch(effort)


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

    return RotationSearch(name if name in ("fast", "normal") else None)


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
