"""Data of the verifier on images: the hypotheses of unsure pairs, with their evidence images."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy.random import Generator

from reorient.errors import ReorientError
from reorient.estimators.image_verifier import shown_rows
from reorient.estimators.verifier import FEATURES, load_verifier
from reorient.learning.verifier import RIGHT_DEG


@dataclass(frozen=True, eq=False)
class ImageSets:
    """The hypotheses of many sets that the network sees, one set after the other."""

    images: UInt8[np.ndarray, "n 2 c s s"]
    features: Float[np.ndarray, "n f"]
    log_odds: Float[np.ndarray, " n"]
    """Of the trees."""
    error_deg: Float[np.ndarray, " n"]
    object: Int[np.ndarray, " n"]
    angle_deg: Float[np.ndarray, " n"]
    """The least of the range of angles of the pair."""
    first: Int[np.ndarray, " m"]
    """The first row of each set."""

    @property
    def right(self) -> Bool[np.ndarray, " n"]:
        """Whether a hypothesis is within 5 degrees of the truth."""
        return self.error_deg < RIGHT_DEG

    def __len__(self) -> int:
        """The number of sets."""
        return len(self.first)

    @property
    def of(self) -> Int[np.ndarray, " n"]:
        """The set of each row."""
        return np.repeat(np.arange(len(self)), self.sizes)

    @property
    def sizes(self) -> Int[np.ndarray, " m"]:
        """The number of hypotheses of each set."""
        return np.diff([*self.first, len(self.log_odds)])

    def rows(self, sets: Int[np.ndarray, " b"]) -> Int[np.ndarray, " r"]:
        """The rows of these sets, one set after the other."""
        return np.concatenate([np.arange(self.first[i], self.first[i] + self.sizes[i]) for i in sets])

    def held_out(self, share: float) -> Bool[np.ndarray, " m"]:
        """The sets of the objects that are not trained on; whether an object is does not depend on the others."""
        objects = np.unique(self.object)
        draw = [np.random.default_rng([0, int(x)]).random() for x in objects]
        return np.isin(self.object[self.first], objects[np.array(draw) < share])


def read_sets(folders: Sequence[Path], effort: str = "normal") -> ImageSets:
    """The unsure sets in folders of ``reorient verifier make --images``; objects of different folders are different.

    Raises ReorientError for a folder without shards, and for a broken file or one without images.
    """
    parts = [part for number, folder in enumerate(folders) for part in _of_folder(folder, number << 32, effort)]
    if not parts:
        raise ReorientError(f"no unsure pair in {', '.join(map(str, folders))}: expected more data")
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    first = np.unique(columns.pop("pair"), return_index=True)[1]
    return ImageSets(**columns, first=first)


def _of_folder(folder: Path, offset: int, effort: str) -> Iterator[dict[str, np.ndarray]]:
    files = sorted(folder.glob("shard-*.npz"))
    if not files:
        raise ReorientError(f"no shards in {str(folder)!r}: expected the folder of `reorient verifier make --images`")
    for file in files:
        try:
            with np.load(file, allow_pickle=False) as arrays:
                if "pair" not in arrays:  # no object of the shard could be used
                    continue
                names = tuple(arrays["features"].tolist())
                part = {x: arrays[x] for x in ("figures", "error_deg", "pair", "object", "angle_deg", "images")}
        except Exception as error:  # numpy raises whatever it likes on broken files
            raise ReorientError(
                f"cannot read {str(file)!r} ({type(error).__name__}: {error}): expected a file of "
                "`verifier make --images`"
            ) from error
        if names != FEATURES:
            raise ReorientError(f"{str(file)!r} holds features of another version: expected it made anew")
        yield from _unsure(part, offset, effort)


def _unsure(part: dict[str, np.ndarray], offset: int, effort: str) -> Iterator[dict[str, np.ndarray]]:
    """The hypotheses of the unsure pairs of a shard that the network sees."""
    verifier = load_verifier()
    log_odds = verifier.log_odds(part["figures"].astype(float))
    features = part.pop("figures")
    for pair in np.unique(part["pair"]):
        rows = np.nonzero(part["pair"] == pair)[0]
        shown = rows[shown_rows(log_odds[rows], verifier.probability(log_odds[rows], effort))]
        if len(shown):
            kept = {name: values[shown] for name, values in part.items()}
            kept |= {"features": features[shown], "log_odds": log_odds[shown].astype(np.float32)}
            yield kept | {"pair": kept["pair"] + offset, "object": kept["object"] + offset}


def batch_of(data: ImageSets, sets: Int[np.ndarray, " b"], rng: Generator | None) -> tuple[np.ndarray, ...]:
    """Images, features, log-odds, right, and the number of the set in the batch, of the rows of some sets.

    ``rng``: rotate and mirror each image at random by multiples of 90 degrees, all of a set alike.
    """
    rows, sizes = data.rows(sets), data.sizes[sets]
    images = data.images[rows]
    if rng is not None:
        for begin, size in zip(np.cumsum(sizes) - sizes, sizes, strict=True):
            for way in range(2):
                mine = images[begin : begin + size, way]
                quarters, mirrored = int(rng.integers(4)), rng.random() < 0.5
                changed = np.rot90(mine, quarters, (2, 3))
                images[begin : begin + size, way] = changed[..., ::-1] if mirrored else changed
    of = np.repeat(np.arange(len(sets)), sizes)
    return images, data.features[rows], data.log_odds[rows], data.right[rows], of
