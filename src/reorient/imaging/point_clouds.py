"""Points from .pcd and .ply files: (height, width, 3) where the cloud is organised, else (n, 3)."""

from pathlib import Path

import numpy as np

from reorient.errors import ReorientError

_PLY = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


def read_pcd(path: Path) -> np.ndarray:
    """Points of a PCD file, version 0.7 of the Point Cloud Library: ascii, binary or binary_compressed.

    Raises ReorientError for a file without x, y, z, and ValueError for a broken one.
    """
    data = path.read_bytes()
    fields: dict[str, list[str]] = {}
    place = 0
    while "DATA" not in fields:
        end = data.index(b"\n", place)
        words = data[place:end].decode("ascii", "replace").split()
        place = end + 1
        if words and not words[0].startswith("#"):
            fields[words[0]] = words[1:]
    names, kind = fields["FIELDS"], fields["DATA"][0]
    counts = list(map(int, fields.get("COUNT", ["1"] * len(names))))
    width, height = int(fields["WIDTH"][0]), int(fields["HEIGHT"][0])
    types = [f"<{code.lower()}{size}" for code, size in zip(fields["TYPE"], fields["SIZE"], strict=True)]
    layout = np.dtype([(f"{i}", kind, (n,)) for i, (kind, n) in enumerate(zip(types, counts, strict=True))])
    n, where = width * height, _places(names)
    if kind == "ascii":
        table = np.array(data[place:].split(), float).reshape(n, sum(counts))
        points = table[:, [sum(counts[:i]) for i in where]]
    elif kind == "binary":
        cloud = np.frombuffer(data, layout, n, place)
        points = np.stack([cloud[f"{i}"][:, 0] for i in where], axis=1)
    else:
        points = _columns(_decompressed(data[place:]), layout, n, where)
    points = points.astype(np.float64)
    return points.reshape(height, width, 3) if height > 1 else points


def _places(names: list[str]) -> list[int]:
    if missing := [name for name in "xyz" if name not in names]:
        raise ReorientError(f"has the fields {' '.join(names)}, no {' '.join(missing)}: expected points x y z")
    return [names.index(name) for name in "xyz"]


def _columns(data: bytes, layout: np.dtype, n: int, where: list[int]) -> np.ndarray:
    """The compressed form stores one field after the other."""
    columns, start = [], 0
    for name in layout.names or ():
        columns.append((start, layout[name].base, layout[name].itemsize))
        start += n * layout[name].itemsize
    picked = []
    for index in where:
        start, base, itemsize = columns[index]
        picked.append(np.frombuffer(data, base, n * itemsize // base.itemsize, start).reshape(n, -1)[:, 0])
    return np.stack(picked, axis=1)


def _decompressed(data: bytes) -> bytes:
    """LZF: sizes (compressed, whole), then runs of literal bytes and references to earlier ones."""
    packed, size = (int(x) for x in np.frombuffer(data, "<u4", 2))
    data, out, i = data[8 : 8 + packed], bytearray(), 0
    while i < len(data):
        control = data[i]
        i += 1
        if control < 32:
            out += data[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[i]
            i += 1
        start = len(out) - ((control & 31) << 8) - data[i] - 1
        i += 1
        if start < 0 or len(out) > size:
            raise ValueError("broken compressed data")
        length += 2
        chunk = out[start : start + length]
        out += (bytes(chunk) * (length // max(len(chunk), 1) + 1))[:length]  # a reference may reach into itself
    if len(out) != size:
        raise ValueError("compressed data end early")
    return bytes(out)


def read_ply(path: Path) -> np.ndarray:
    """Vertices of a PLY file, ascii or binary; organised where comments or obj_info state ``width`` and ``height``
    (also ``num_cols``, ``num_rows``).

    Raises ReorientError for a file without x, y, z, and ValueError for a broken one.
    """
    data = path.read_bytes()
    begin, mark, _ = data.partition(b"end_header")
    if not data.startswith(b"ply") or not mark:
        raise ValueError("no PLY header")
    place = data.index(b"\n", len(begin)) + 1
    lines = [line.split() for line in begin.decode("ascii", "replace").splitlines()]
    form = next(words[1] for words in lines if words[:1] == ["format"])
    n, properties = _vertices(lines)
    where = _places([name for name, _ in properties])
    if form == "ascii":
        rows = data[place:].split(b"\n", n)[:n]
        points = np.array([row.split() for row in rows], float)[:, where]
    else:
        order = "<" if form == "binary_little_endian" else ">"
        layout = np.dtype([(f"{i}", order + _PLY[kind]) for i, (_, kind) in enumerate(properties)])
        cloud = np.frombuffer(data, layout, n, place)
        points = np.stack([cloud[f"{i}"] for i in where], axis=1).astype(np.float64)
    if len(points) != n:
        raise ValueError(f"{len(points)} of {n} vertices")
    info = {
        words[-2].lower(): words[-1] for words in lines if words[:1] in (["obj_info"], ["comment"]) and len(words) > 2
    }
    width, height = (info.get(a, info.get(b, "")) for a, b in (("width", "num_cols"), ("height", "num_rows")))
    if width.isdecimal() and height.isdecimal() and int(width) * int(height) == n:
        return points.reshape(int(height), int(width), 3)
    return points


def _vertices(lines: list[list[str]]) -> tuple[int, list[tuple[str, str]]]:
    """The number of vertices, which must come first, and (name, type) of their properties."""
    elements = [i for i, words in enumerate(lines) if words[:1] == ["element"]]
    if not elements or lines[elements[0]][1] != "vertex":
        raise ReorientError("has no vertices first: expected a cloud of points")
    end = elements[1] if len(elements) > 1 else len(lines)
    properties = [words for words in lines[elements[0] + 1 : end] if words[:1] == ["property"]]
    if any(words[1] == "list" for words in properties):
        raise ReorientError("has lists in its vertices: expected x y z")
    return int(lines[elements[0]][2]), [(words[2], words[1]) for words in properties]
