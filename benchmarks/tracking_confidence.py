"""Fit the confidence of tracking: a logistic function of the verifier's features of the one tracked hypothesis.

    python benchmarks/tracking_confidence.py out/tracking.npz --meshes FOLDER --only results/household-tuning.txt
    python benchmarks/tracking_confidence.py out/tracking.npz --write src/reorient/estimators/tracking.json

The first command tracks simulated sequences, without estimates, from the true motion or, in every sixth sequence, again
and again from a wrong one, and collects features and labels (right: the object is there, and the error is below 5
degrees). Both fit, cross-validated over sequences; the second writes the weights. What a missing prediction takes off
is not fitted (``missing_log_odds``).
"""

import json
import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from tracking_sequences import KINDS, Frame, Sequence

from reorient import so3
from reorient.cli.arguments import Positional, parse
from reorient.errors import ReorientError
from reorient.estimators.tracking import fit, missing_log_odds, problem_of, seen_share
from reorient.estimators.verifier import FEATURES, features
from reorient.registration import DepthView, Hypotheses
from reorient.world.objects import ObjectSource

OWN = ("angle", "rotation uncertainty", "shift uncertainty", "returns")
USED = [
    name for name in FEATURES if name in OWN or (name.startswith(("least ", "most ")) and " less the " not in name)
]  # no feature that compares hypotheses: there is one


@dataclass(frozen=True)
class Fit:
    """Collect features of tracked hypotheses, and fit the confidence."""

    data: Positional[Path]
    """File of the features (.npz); collected where it is missing."""
    objects: ObjectSource = field(default_factory=ObjectSource)
    sequences: int = 300
    """Number of sequences."""
    first: int = 0
    """Number of the first sequence."""
    write: Path | None = None
    """File of the weights to write."""
    strength: float = 0.01
    """Inverse of the regularisation."""


def collect(config: Fit) -> None:
    objects = config.objects.open()
    kinds, rows, labels = (*KINDS, "wrong"), [], []
    for number in range(config.first, config.first + config.sequences):
        kind = kinds[number % len(kinds)]
        name = objects.names[number * 37 % len(objects.names)]
        sequence = Sequence(objects, name, "plain" if kind == "wrong" else kind, 1000 + number, 60)
        goal = DepthView(sequence.goal)
        rng, motion = np.random.default_rng(number), None
        for frame in sequence:
            if motion is None or (kind == "wrong" and frame.index % 10 == 0):
                motion = _start(sequence, frame, rng if kind == "wrong" else None)
            try:
                problem = problem_of(DepthView(frame.image), goal)
            except ReorientError:
                continue
            motion = fit(problem, motion)
            error_deg = sequence.error_deg(motion.R[0], frame)
            settled = not (kind == "wrong" and frame.index % 10 < 3)
            if settled:
                rows.append(features(problem, motion)[0])
                labels.append((number, frame.index, frame.there, error_deg, seen_share(problem, motion)))
        print(f"{number}: {len(rows)} rows", end="\r", file=sys.stderr)
    np.savez(config.data, features=np.array(rows), labels=np.array(labels, float))


def _start(sequence: Sequence, frame: Frame, rng: np.random.Generator | None) -> Hypotheses:
    """The true motion, or one of a wrong rotation where there is an rng."""
    R, center_m = sequence.truth(frame.R_camera_object), sequence.placement.center_m
    truth = Hypotheses(R[None], frame.t_goal_current_m[None])
    if rng is None:
        return truth
    away = so3.matrix_from_quat(so3.sample_bounded(rng, 1, np.radians(8), np.pi))
    return truth.perturbed(center_m, away, np.zeros((1, 3)))


def fitted(config: Fit) -> None:
    """Fit, print what a cross-validation over sequences gives, and write the weights."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.preprocessing import StandardScaler

    with np.load(config.data) as arrays:
        values, (number, _, there, error_deg, seen) = arrays["features"], arrays["labels"].T
    used = [FEATURES.index(name) for name in USED]
    right = (there == 1) & (error_deg < 5)
    scaler = StandardScaler().fit(values[:, used])
    scaled = scaler.transform(values[:, used])
    odds = np.zeros(len(right))
    for part in range(5):
        held = number % 5 == part
        model = LogisticRegression(C=config.strength, max_iter=2000).fit(scaled[~held], right[~held])
        odds[held] = model.decision_function(scaled[held]) + [missing_log_odds(x) for x in seen[held]]
    print(f"{len(right)} images of {len(set(number))} sequences, {right.mean():.0%} right")
    print(f"right, but below 0.5: {np.mean(odds[right] < 0):.2%}")
    for name, group in (("swapped or hidden", there == 0), ("there, wrong", (there == 1) & ~right)):
        print(f"{name}, below 0.5: {np.mean(odds[group] < 0):.2%} of {group.sum()}")
    edges = np.quantile(odds, np.linspace(0, 1, 11))
    for low, high in pairwise(edges):
        group = (odds >= low) & (odds <= high)
        print(f"confidence {np.mean(1 / (1 + np.exp(-odds[group]))):.3f}: right {right[group].mean():.3f}")
    if config.write is None:
        return
    model = LogisticRegression(C=config.strength, max_iter=2000).fit(scaled, right)
    weights = model.coef_[0] / scaler.scale_
    bias = float(model.intercept_[0] - weights @ scaler.mean_)
    data = {"bias": round(bias, 5)} | {name: float(f"{x:.5g}") for name, x in zip(USED, weights, strict=True)}
    config.write.write_text(json.dumps(data, indent=1) + "\n")


def main(config: Fit) -> None:
    """Collect where there is no file yet; fit."""
    if not config.data.is_file():
        collect(config)
    fitted(config)


if __name__ == "__main__":
    main(parse(Fit, "benchmarks/tracking_confidence.py", sys.argv[1:]))
