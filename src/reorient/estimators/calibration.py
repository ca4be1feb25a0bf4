"""What ``reorient verifier calibrate`` measured: ``calibration.json``, with its card in ``calibration.md``."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient.errors import ReorientError

CALIBRATION = Path(__file__).with_name("calibration.json")


@dataclass(frozen=True, eq=False)
class Calibration:
    """What ``reorient verifier calibrate`` measured."""

    verifiers: tuple[str, str]
    """Fingerprints of the verifiers that it was measured with: for one pair of views, and for several."""
    truth: Mapping[str, Float[np.ndarray, " n"]]
    """By group, the probability of the truth in each estimate, in ascending order; 0 where it was not found."""
    scale: float
    """Of the covariance that curvature and spread give."""
    floor_rad: float
    """Standard deviation of the errors that neither shows, about each axis: model, pixels, tolerance of the polish."""

    def level(self, group: str, probability: float) -> float:
        """Sets of a higher level hold a candidate with this probability."""
        truth = self.truth[group]
        return float(len(truth) - np.searchsorted(truth, probability, side="right")) / (len(truth) + 1)

    def guaranteed(self, group: str) -> float:
        """The largest level of a set that needs no rotation beside the candidates; 0 for a group without data."""
        truth = self.truth.get(group, np.empty(0))
        return float(np.count_nonzero(truth)) / (len(truth) + 1)


@cache
def load_calibration(path: Path = CALIBRATION) -> Calibration:
    """The calibration of the package. Raises ReorientError for another kind of file."""
    try:
        data = json.loads(path.read_text())
        truth = {name: np.sort(x) for name, x in data["truth"].items()}
        one, several = data["verifiers"]
        return Calibration((one, several), truth, float(data["scale"]), float(data["floor_rad"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ReorientError(
            f"cannot read the calibration {str(path)!r} ({error}): expected what `reorient verifier calibrate` writes"
        ) from error
