"""The verifier on images: where the boosted trees are unsure, a network compares the evidence images of hypotheses.

It adds to the log-odds of the trees (``reorient.estimators.verifier``). The weights are ``verifier-images.onnx``, the
card is ``verifier-images.md``; ``reorient.learning.image_training`` trains it.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from reorient.errors import ReorientError
from reorient.estimators.image_evidence import evidence_images
from reorient.estimators.verifier import FEATURES
from reorient.registration import Hypotheses, Problem

WEIGHTS = Path(__file__).with_name("verifier-images.onnx")
SURE = 0.98  # probability by the trees from which the network is not asked
MOST = 8  # hypotheses that it sees
WITHIN = 6.0  # of the best's log-odds: less likely ones are not shown


def shown_rows(log_odds: Float[np.ndarray, " k"], probability: Float[np.ndarray, " k"]) -> Int[np.ndarray, " m"]:
    """The hypotheses of a set that the network sees, most likely first; none where the trees are sure."""
    order = np.argsort(-log_odds, kind="stable")
    if probability[order[0]] >= SURE:
        return order[:0]
    return order[: min(MOST, int((log_odds > log_odds[order[0]] - WITHIN).sum()))]


@dataclass(frozen=True, eq=False)
class ImageVerifier:
    """The trained network and its calibration."""

    session: Any
    """Of ONNX Runtime, one thread."""
    calibration: Mapping[str, tuple[float, float]]
    """By effort: scale and shift of the chosen hypothesis's log-odds, from held-out objects."""

    def log_odds(
        self,
        images: UInt8[np.ndarray, "k 2 c s s"],
        features: Float[np.ndarray, "k f"],
        by_trees: Float[np.ndarray, " k"],
    ) -> Float[np.ndarray, " k"]:
        """Log-odds that the hypotheses of one set are right; ``by_trees``: those of the trees."""
        inputs = {"images": images, "features": features.astype(np.float32), "log_odds": by_trees.astype(np.float32)}
        return np.asarray(self.session.run(None, inputs)[0].astype(float))

    def probability(self, log_odds: Float[np.ndarray, " k"], effort: str) -> Float[np.ndarray, " k"]:
        """Calibrated probability after a search with an effort."""
        scale, shift = self.calibration[effort]
        return 1 / (1 + np.exp(-(scale * log_odds + shift)))


def with_images(
    problem: Problem,
    hypotheses: Hypotheses,
    features: Float[np.ndarray, "k f"],
    log_odds: Float[np.ndarray, " k"],
    probability: Float[np.ndarray, " k"],
    effort: str,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Log-odds and probabilities of the hypotheses of a problem of two views, given the features, log-odds and
    probabilities of the trees; these themselves where the trees are sure, and after a search of an effort for which the
    network is not calibrated."""
    verifier, shown = load_image_verifier(), shown_rows(log_odds, probability)
    if effort not in verifier.calibration or not len(shown):
        return log_odds, probability
    images = evidence_images(problem, hypotheses[shown])
    answer = verifier.log_odds(images, features[shown], log_odds[shown])
    combined = np.minimum(log_odds, answer.min())  # what the network did not see is no better than what it saw
    combined[shown] = answer
    return combined, verifier.probability(combined, effort)


@cache
def load_image_verifier(path: Path = WEIGHTS) -> ImageVerifier:
    """The verifier of the package.

    Raises ReorientError for an unreadable file, for another kind of network and for features of another version.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
        stated = session.get_modelmeta().custom_metadata_map
        names = tuple(json.loads(stated["features"]))
        calibration = {effort: (scale, shift) for effort, (scale, shift) in json.loads(stated["calibration"]).items()}
    except Exception as error:  # the runtime raises errors of its own
        raise ReorientError(
            f"cannot read the verifier {str(path)!r} ({type(error).__name__}): expected what "
            "`reorient verifier images` wrote"
        ) from error
    if names != FEATURES:
        raise ReorientError(f"the verifier {str(path)!r} was trained on the features of another version: train it anew")
    return ImageVerifier(session, calibration)
