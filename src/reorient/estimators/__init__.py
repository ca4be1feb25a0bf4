"""Estimators by name."""

from reorient.errors import unknown_name
from reorient.estimators.base import Estimator

NAMES = ("default", "gicp", "icp", "paper", "swift")


def load_estimator(name: str = "default") -> Estimator:
    """An estimator of the package: ``gicp`` (``default`` for now), ``icp``, or a network: ``paper``, ``swift``.

    Raises ReorientError, a ValueError, for an unknown name.
    """
    if name in ("default", "gicp"):
        from reorient.estimators.gicp import GICP

        return GICP()
    if name == "icp":
        from reorient.estimators.icp import ICP

        return ICP()
    if name == "paper":
        from reorient.estimators.learned import Learned

        return Learned("paper")
    if name == "swift":
        from reorient.estimators.learned import Learned

        return Learned("swift", rounds=3)
    raise unknown_name("estimator", name, list(NAMES))
