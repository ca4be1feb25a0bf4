"""Estimators by name."""

from reorient.errors import unknown_name
from reorient.estimators.base import Estimator

NAMES = ("default", "gicp", "icp")


def load_estimator(name: str = "default") -> Estimator:
    """An estimator of the package: ``gicp`` (which ``default`` is for now) or ``icp``.

    Raises ReorientError, a ValueError, for an unknown name.
    """
    if name in ("default", "gicp"):
        from reorient.estimators.gicp import GICP

        return GICP()
    if name == "icp":
        from reorient.estimators.icp import ICP

        return ICP()
    raise unknown_name("estimator", name, list(NAMES))
