"""Real numeric matrices of MATLAB files, version 5 (saved with -v6 or -v7), as MathWorks documents the format.

Own code, because scipy.io.loadmat ends the process on some broken files.
"""

import zlib
from collections.abc import Iterator

import numpy as np

from reorient.errors import ReorientError

_NUMBERS = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 9: "<f8", 12: "<i8", 13: "<u8"}
_MATRIX, _COMPRESSED = 14, 15
_CLASSES = range(6, 16)  # double, single and the integers; not cells, structures, text, sparse
_LARGEST_BYTES = 50_000_000  # of one variable when it is decompressed


def read_mat(data: bytes) -> dict[str, np.ndarray]:
    """Variables by name. Raises ReorientError for another version, ValueError for a broken file."""
    if data[:4] == b"\x89HDF" or b"MATLAB 7.3" in data[:128]:
        raise ReorientError("is a MATLAB 7.3 file: expected one saved with -v7")
    if len(data) < 128 or data[126:128] != b"IM":
        raise ValueError("no little-endian MATLAB 5 header")
    variables: dict[str, np.ndarray] = {}
    for kind, content in _elements(data[128:]):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(content, _LARGEST_BYTES)
            kind, content = next(_elements(unpacked), (0, b""))
        if kind == _MATRIX:
            variables |= _variable(content)
    return variables


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(type, content) of the elements one after the other; up to four bytes lie in the tag itself."""
    place = 0
    while place + 8 <= len(data):
        kind, size = (int(x) for x in np.frombuffer(data, "<u4", 2, place))
        if kind >> 16:
            kind, size, start = kind & 0xFFFF, kind >> 16, place + 4
            place += 8
        else:
            start = place + 8
            place = start + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if start + size > len(data):
            raise ValueError("the file ends early")
        yield kind, data[start : start + size]


def _variable(content: bytes) -> dict[str, np.ndarray]:
    """{name: array} of a matrix element; nothing for one that is not real and numeric."""
    parts = list(_elements(content))
    if len(parts) < 4:
        return {}
    (_, flags), (_, shape), (_, name), (kind, values) = parts[:4]
    if not flags or flags[0] not in _CLASSES or kind not in _NUMBERS:
        return {}
    numbers = np.frombuffer(values, _NUMBERS[kind])
    return {name.decode("ascii", "replace"): numbers.reshape(np.frombuffer(shape, "<i4"), order="F")}
