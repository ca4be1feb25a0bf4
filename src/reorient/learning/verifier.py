"""Training of the verifiers, offline only (extra ``train``: scikit-learn); what it writes needs numpy alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from reorient.errors import ReorientError
from reorient.estimators.search import EFFORTS
from reorient.estimators.verifier import FEATURES
from reorient.estimators.views_verifier import VIEWS_FEATURES, group_of
from reorient.runs.files import replacing

RIGHT_DEG = 5.0


@dataclass(frozen=True, eq=False)
class Shards:
    """All hypotheses of a folder."""

    names: tuple[str, ...]
    """Of the features."""
    features: Float[np.ndarray, "n f"]
    error_deg: Float[np.ndarray, " n"]
    pair: np.ndarray
    object: np.ndarray

    @property
    def right(self) -> Bool[np.ndarray, " n"]:
        """Whether a hypothesis is within 5 degrees of the truth."""
        return self.error_deg < RIGHT_DEG

    def only(self, rows: np.ndarray) -> "Shards":
        """These rows, as a mask or as numbers."""
        return Shards(self.names, self.features[rows], self.error_deg[rows], self.pair[rows], self.object[rows])

    def and_also(self, other: "Shards") -> "Shards":
        """These, and those of other objects. Raises ReorientError for features of another kind."""
        if self.names != other.names:
            raise ReorientError("data of one and of several goal views: expected two folders of the same kind")
        return Shards(
            self.names,
            np.concatenate([self.features, other.features]),
            np.concatenate([self.error_deg, other.error_deg]),
            np.concatenate([self.pair, other.pair + self.pair.max() + 1]),
            np.concatenate([self.object, other.object + self.object.max() + 1]),
        )

    def best(self, score: Float[np.ndarray, " n"]) -> np.ndarray:
        """Of each pair the row with the highest score."""
        order = np.lexsort((-score, self.pair))
        return order[np.unique(self.pair[order], return_index=True)[1]]


def read(folder: Path) -> Shards:
    """The data that ``make`` wrote. Raises ReorientError for none, a broken file, and features of another version."""
    parts, found = [], set()
    for file in sorted(folder.glob("shard-*.npz")):
        try:
            with np.load(file, allow_pickle=False) as arrays:
                names = tuple(arrays["features"].tolist())
                found.add(names)
                if names not in (FEATURES, VIEWS_FEATURES) or len(found) > 1:
                    raise ReorientError(f"{str(file)!r} holds features of another version: expected it made anew")
                if "figures" in arrays:
                    parts.append([arrays[name] for name in ("figures", "error_deg", "pair", "object")])
                    _check_shapes(parts[-1], len(names))
        except ReorientError:
            raise
        except Exception as error:  # numpy raises whatever it likes on broken files
            raise ReorientError(
                f"cannot read {str(file)!r} ({type(error).__name__}: {error}): expected a file of `verifier make`"
            ) from error
    if not parts:
        raise ReorientError(f"no shards in {str(folder)!r}: expected the folder of `reorient verifier make`")
    return Shards(found.pop(), *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _check_shapes(columns: list[np.ndarray], width: int) -> None:
    """Raise ValueError for columns that are no table of numbers."""
    n = len(columns[0])
    if [x.shape for x in columns] != [(n, width), (n,), (n,), (n,)] or any(x.dtype.kind not in "fiu" for x in columns):
        raise ValueError(f"columns of shapes {', '.join(str(x.shape) for x in columns)}")


# --- training -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Training:
    """Settings of the boosted trees."""

    trees: int = 600
    held_out: float = 0.2
    """Share of the objects that calibrate and test the trees."""


def train(
    data: Shards, out: Path, others: Mapping[str, Shards] | None = None, training: Training | None = None
) -> dict[str, float]:
    """Train boosted trees on part of the objects, calibrate them on the rest; writes ``out`` (.npz).

    ``data`` is of effort "normal". ``others``: data of other efforts, of other objects, to calibrate these; an effort
    without data is calibrated as "normal". Data of several views is calibrated by the number of goal views instead. The
    confidence is that of the *chosen* hypothesis, so the calibration is,
    too. Returns figures of the held-out objects by name.
    """
    from reorient.learning.trees import fit_platt, fit_trees, tree_arrays

    training = training or Training()
    apart = held_out(data, training)
    model = fit_trees(data.features[~apart], data.right[~apart], training.trees)
    result: dict[str, float] = {
        "objects": len(np.unique(data.object)),
        "pairs": len(np.unique(data.pair)),
        "hypotheses": len(data.pair),
    }
    calibration = {}
    for effort, shards in _groups(data.only(apart), others or {}).items():
        log_odds = model.decision_function(shards.features)
        chosen = shards.best(log_odds)
        calibration[effort] = fit_platt(log_odds[chosen], shards.right[chosen])
        by_score = shards.best(shards.features[:, shards.names.index("score")])
        result |= {
            f"{effort}: held-out pairs": len(chosen),
            f"{effort}: right": float(shards.right[chosen].mean()),
            f"{effort}: right by score": float(shards.right[by_score].mean()),
            f"{effort}: right at best": float(shards.right[shards.best(-shards.error_deg)].mean()),
            f"{effort}: log loss": _log_loss(calibration[effort], log_odds[chosen], shards.right[chosen]),
        }
    if "normal" in calibration:
        calibration = {effort: calibration.get(effort, calibration["normal"]) for effort in EFFORTS}
    with replacing(out) as temporary:
        np.savez_compressed(
            temporary,
            features=np.array(data.names),
            efforts=np.array(list(calibration)),
            calibration=np.array(list(calibration.values())),
            **tree_arrays(model),
        )
    return result


def _groups(apart: Shards, others: Mapping[str, Shards]) -> dict[str, Shards]:
    """The data that calibrates each effort or, with several views, each number of goal views."""
    if apart.names == FEATURES:
        return {"normal": apart, **others}
    count = apart.features[:, VIEWS_FEATURES.index("goal views")].astype(int)
    return {group_of(int(n)): apart.only(count == n) for n in np.unique(count)}


def held_out(data: Shards, training: Training) -> Bool[np.ndarray, " n"]:
    """The rows of the objects that are not trained on; the same for the same data."""
    objects = np.unique(data.object)
    count = max(int(training.held_out * len(objects)), 1)
    return np.isin(data.object, np.random.default_rng(0).permutation(objects)[:count])


def _log_loss(
    calibration: tuple[float, float], log_odds: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]
) -> float:
    scale, shift = calibration
    return float(np.mean(np.logaddexp(0, np.where(right, -1, 1) * (scale * log_odds + shift))))
