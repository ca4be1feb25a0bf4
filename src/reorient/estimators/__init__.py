"""Estimators by name."""

from reorient.errors import unknown_name
from reorient.estimators.base import Estimator

NAMES = ("default", "fast", "thorough", "gicp", "icp", "paper", "swift")


def load_estimator(name: str = "default") -> Estimator:
    """An estimator of the package.

    ``default``: any rotation, with a calibrated confidence; ``fast`` and ``thorough`` are the same with less and more
    work. ``gicp``: generalised ICP, up to 60 degrees. ``icp``: the paper's baseline.
    Raises ReorientError, a ValueError, for an unknown name.
    """
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
        from reorient.estimators.learned import Learned

        return Learned("swift", rounds=3)
    raise unknown_name("estimator", name, list(NAMES))
