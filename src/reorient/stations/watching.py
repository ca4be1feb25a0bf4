"""Images for a guide: of a camera as they come, or of a recording. None where they show no object."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from reorient.controller.guiding import Frames
from reorient.controller.station import captured
from reorient.errors import ProtocolError, ReorientError, StationError
from reorient.imaging import DepthImage
from reorient.imaging.depth_arrays import READERS
from reorient.imaging.files import read_depth
from reorient.plugins import USER_ERRORS, in_words
from reorient.stations.guarded import Isolate
from reorient.stations.replay import ReplayedStation

RECORDED_S = 1 / 30  # between the images of a recording that has no stamps
FAILURES = 5  # captures in a row that may fail


def watch(camera: Any, isolate: Isolate | None = None) -> Iterator[tuple[float, DepthImage | None]]:
    """Images of a camera or station without end, at the host's time; ``isolate``: takes a whole frame to the object.

    Raises StationError where five captures in a row failed.
    """
    failed = 0
    while True:
        try:
            image = captured(camera.capture())
        except USER_ERRORS as error:
            if isinstance(error, ReorientError) and not isinstance(error, StationError | ProtocolError):
                yield time.monotonic(), None  # a station that isolates by itself found no object
                continue
            failed += 1
            if failed == FAILURES or isinstance(error, ProtocolError):
                raise StationError(f"the camera failed: {in_words(error)}") from error
            continue
        failed = 0
        yield time.monotonic(), _isolated(image, isolate)


def replay(folder: Path, isolate: Isolate | None = None) -> Frames:
    """The images of a record, or the depth images of a folder in the order of their names, at the times of their
    stamps; without stamps, 30 a second. Raises ReorientError where there is none."""
    if (folder / "record.json").is_file():
        record = ReplayedStation(folder)
        names = [act["capture"] for act in record.record["acts"] if act.get("capture")]
        files = [record.file(name) for name in names]
    else:
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in READERS)
    if not files:
        raise ReorientError(f"no images in {str(folder)!r}: expected a record, or files {', '.join(READERS)}")
    return _read(files, isolate)


def _read(files: list[Path], isolate: Isolate | None) -> Iterator[tuple[float, DepthImage | None]]:
    for index, file in enumerate(files):
        image = read_depth(file)
        time_s = index * RECORDED_S if image.stamp_s is None else image.stamp_s
        yield time_s, _isolated(image, isolate)


def _isolated(image: DepthImage, isolate: Isolate | None) -> DepthImage | None:
    """The object; None where the isolation finds none."""
    if isolate is None:
        return image
    try:
        return isolate(image)
    except ReorientError:
        return None
