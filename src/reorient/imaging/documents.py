"""Camera files as plain Python data (dicts, lists, numbers, text): JSON, YAML, OpenCV's XML, MATLAB, NumPy, text.

Nothing in a file is executed: pickles are refused, YAML is read without objects and aliases, XML without entities.
"""

import json
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from reorient.errors import ReorientError
from reorient.imaging.matlab import read_mat

_LARGEST_BYTES = 50_000_000  # a BOP scene of 10,000 frames has 3 MB
_PICKLES = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")  # the first bytes of protocols 2 to 5
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\Z")


def existing(path: str | Path, what: str) -> Path:
    """The path of a file. Raises ReorientError where there is none, and for a folder."""
    path = Path(path)
    if os.path.isdir(path):
        raise ReorientError(f"{str(path)!r} is a folder: expected a file")
    if not os.path.isfile(path):
        raise ReorientError(f"no {what} at {str(path)!r}: expected an existing file")
    return path


def refuse_pickle(path: Path) -> None:
    """Raise ReorientError for a pickle: loading it could run code."""
    with path.open("rb") as file:
        begin = file.read(2)
    if begin in _PICKLES or path.suffix.lower() in (".pkl", ".pickle"):
        raise ReorientError(
            f"{str(path)!r} is a pickle, which can run code when it is loaded: expected numbers (numpy.save, JSON)"
        )


def read_document(path: Path) -> Any:
    """The content of a camera file. Raises ReorientError, in one line, for whatever cannot be read."""
    refuse_pickle(path)
    if path.stat().st_size > _LARGEST_BYTES:
        raise ReorientError(f"camera file {str(path)!r} is larger than 50 MB: expected intrinsics")
    suffix = path.suffix.lower()
    try:
        if suffix in (".npy", ".npz", ".mat"):
            return {".npy": _from_npy, ".npz": _from_npz, ".mat": _from_mat}[suffix](path)
        return _from_text(path.read_text(encoding="utf-8-sig", errors="replace"), suffix)
    except ReorientError as error:
        raise ReorientError(f"camera file {str(path)!r} {error}") from error
    except RecursionError as error:
        raise ReorientError(f"camera file {str(path)!r} is nested too deep: expected intrinsics") from error
    except Exception as error:  # the parsers raise many kinds of errors on broken files
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ReorientError(f"cannot read camera file {str(path)!r} ({reason}): expected intrinsics") from error


def parse_json(text: str) -> Any:
    """JSON as Python data. Raises ValueError with a readable message, also for deep nesting and endless numbers."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deep") from error


def _from_npy(path: Path) -> Any:
    return np.load(path, allow_pickle=False).tolist()


def _from_npz(path: Path) -> Any:
    with np.load(path, allow_pickle=False) as arrays:
        return {name: arrays[name].tolist() for name in arrays}


def _from_mat(path: Path) -> Any:
    """Arrays of one number as the number."""
    return {
        name: array.item() if array.size == 1 else array.tolist() for name, array in read_mat(path.read_bytes()).items()
    }


def _from_text(text: str, suffix: str) -> Any:
    """A document by its first characters, its suffix where these do not tell."""
    begin = text.lstrip()[:1]
    if begin == "<":
        return _from_xml(text)
    if suffix in (".yaml", ".yml") or text.startswith("%YAML"):
        return _from_yaml(text)
    if begin == "{" or suffix in (".json", ".intr"):
        try:
            return parse_json(text)
        except ValueError as error:
            raise ReorientError(f"is not JSON ({str(error)[:100]}): expected intrinsics") from error
    return _from_words(text)


def _from_yaml(text: str) -> Any:
    """The first document that is not empty. OpenCV begins with ``%YAML:1.0``, which is no YAML."""
    import yaml

    def without_aliases(loader: Any, parent: Any, index: Any) -> Any:
        if loader.check_event(yaml.AliasEvent):  # a few aliases of aliases make gigabytes
            raise ReorientError("has a YAML alias: expected plain values")
        return yaml.SafeLoader.compose_node(loader, parent, index)

    def opencv_matrix(loader: Any, suffix: str, node: Any) -> Any:
        return loader.construct_mapping(node, deep=True) if isinstance(node, yaml.MappingNode) else None

    Loader: Any = type("Loader", (yaml.SafeLoader,), {"compose_node": without_aliases})
    Loader.add_multi_constructor("tag:yaml.org,2002:opencv", opencv_matrix)
    text = re.sub(r"\A%YAML:?\s*[\d.]+[^\n]*\n", "", text)
    return next((data for data in yaml.load_all(text, Loader) if data is not None), None)


def _from_xml(text: str) -> Any:
    if "<!" in text.replace("<!--", ""):
        raise ReorientError("has an XML document type: expected OpenCV's XML without one")
    return _element(ElementTree.fromstring(text))


def _element(element: ElementTree.Element) -> Any:
    """A dict of the children; without any the numbers of the text, one or a list, or the text."""
    if len(element):
        return {child.tag: _element(child) for child in element}
    words = (element.text or "").split()
    if words and all(map(_NUMBER.match, words)):
        numbers = list(map(float, words))
        return numbers[0] if len(numbers) == 1 else numbers
    return (element.text or "").strip().strip('"')


def _from_words(text: str) -> Any:
    """A matrix of numbers with any separators, or "name: value" and "name,value" lines (RealSense's tools)."""
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    bare = [re.sub(r"[\[\](),;]", " ", line).split() for line in lines]
    rows = [words for words in bare if words]
    if rows and all(_NUMBER.match(word) for words in rows for word in words):
        values = [[float(word) for word in words] for words in rows]
        return values[0] if len(values) == 1 else values
    return _sections(line for line in lines if line)


def _sections(lines: Iterable[str]) -> dict[str, Any]:
    """Lines "name: value" as a dict, nested below lines that are no such pair (headings)."""
    document: dict[str, Any] = {}
    section = document
    for line in lines:
        separator = re.search("[:,]", line)
        if separator is None:
            section = document.setdefault(line, {})
            continue
        name, value = line[: separator.start()].strip(), line[separator.end() :]
        words = value.replace(",", " ").split()
        if words and all(map(_NUMBER.match, words)):
            numbers = list(map(float, words))
            section[name] = numbers[0] if len(numbers) == 1 else numbers
        else:
            section[name] = value.strip(" ,")
    return document
