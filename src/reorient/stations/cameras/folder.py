"""Frames that another program writes to a folder: any camera whose software can save depth images."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from reorient.errors import ReorientError, StationError, check_range
from reorient.imaging import DepthImage
from reorient.imaging.depth_arrays import READERS
from reorient.imaging.files import read_depth
from reorient.imaging.intrinsics import read_intrinsics

_POLL_S = 0.02
Seen = dict[Path, tuple[int, int]]
"""Time of the last change (ns) and size of each file."""


@dataclass(kw_only=True, eq=False)
class FolderCamera:
    """A folder to which frames are written, or one file that is written again and again.

    ``capture`` waits for a file that appears or changes after the call, and is complete: the frames of before are
    stale. The formats are those of ``read_depth``. Frames are whole: a pixel without depth is unknown, not beside the
    object. A file without a stamp of its own has the time of its last change.
    """

    frames: str
    """The folder, or a pattern such as ``/data/depth_*.png``."""
    camera: str = ""
    """File of the intrinsics (docs/formats.md), whose lens distortion is undone; needed unless the frames contain
    theirs."""
    scale_m: float | None = None
    """Metres per unit of integer depth; None: as the file states, or 0.001."""
    host_clock: bool = False
    """Whether the frames' own stamps are of this computer's clock (time.time), as the times of last change are: then
    frames from before the end of a move are known for certain."""
    timeout_s: float = 5.0
    """Longest wait for a frame."""

    def __post_init__(self) -> None:
        """Raises ReorientError where the folder or the intrinsics are missing."""
        check_range(self, "timeout_s", above=True)
        path = Path(self.frames)
        self._folder, self._pattern = (path, "*") if path.is_dir() else (path.parent, path.name)
        if not self._folder.is_dir():
            raise ReorientError(f"no folder {str(self._folder)!r}: expected a folder, or a pattern of files in one")
        self._own_stamps = False
        self._intrinsics = read_intrinsics(self.camera) if self.camera else None

    def capture(self) -> DepthImage:
        """The next frame. Raises StationError where none arrives, or none that can be read."""
        deadline_s = time.monotonic() + self.timeout_s
        before = self._settled(deadline_s)
        problem = "none appeared"
        while time.monotonic() < deadline_s:
            for path in self._newer(before):
                try:
                    return self._read(path)
                except (ReorientError, OSError) as error:  # not complete yet, perhaps
                    problem = str(error)
            time.sleep(_POLL_S)
        raise StationError(
            f"no new frame in {self._folder / self._pattern} within {self.timeout_s:g} s ({problem}): expected files "
            f"{', '.join(READERS)} that the camera's software writes continuously"
        )

    def clock_s(self) -> float:
        """The clock of the stamps; NaN where it is another than this computer's."""
        return float("nan") if self._own_stamps and not self.host_clock else time.time()

    def _settled(self, deadline_s: float) -> Seen:
        """The present files, once none of them is being written: that frame was captured before the call."""
        before = self._files()
        while time.monotonic() < deadline_s:
            time.sleep(_POLL_S)
            now = self._files()
            if all(now.get(path) == state for path, state in before.items()):
                return now
            before = now
        return before

    def _newer(self, before: Seen) -> Iterator[Path]:
        """Files that appeared or changed, the newest first."""
        files = self._files()
        changed = [path for path, state in files.items() if before.get(path) != state]
        yield from sorted(changed, key=lambda path: files[path], reverse=True)

    def _files(self) -> Seen:
        found: Seen = {}
        for path in self._folder.glob(self._pattern):
            if path.suffix.lower() in READERS:
                try:
                    state = path.stat()
                except OSError:  # removed or renamed in the meantime
                    continue
                found[path] = state.st_mtime_ns, state.st_size
        return found

    def _read(self, path: Path) -> DepthImage:
        changed_s = path.stat().st_mtime
        image = read_depth(path, self._intrinsics, self.scale_m)
        self._own_stamps = image.stamp_s is not None
        stamp_s = changed_s if image.stamp_s is None else image.stamp_s
        return DepthImage(image.depth_m, image.camera, stamp_s, unknown=~image.valid)
