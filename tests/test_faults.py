"""Kinds of faults that fuzzing found, each by its smallest input; docs/reliability.md lists where the others are."""

import gzip
import io
import json
import os
import resource
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from reorient.cli import main
from reorient.errors import OutOfRange, ReorientError, check_range, unknown_name
from reorient.experiments.cells import COLUMNS
from reorient.experiments.evaluation import Evaluation
from reorient.experiments.loops import Loops
from reorient.perception.extrinsics import read_hand_eye
from reorient.plugins import in_words
from reorient.reporting import read_rows
from reorient.runs.files import locked, write_table
from reorient.runs.pool import Pool
from reorient.runs.run import RowStore, resumable
from reorient.world.meshes import load_mesh

OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
STL = (
    b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    b"endsolid x\n"
)


def refused(capsys, *words):
    """The one line with which a command line is refused."""
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    message = capsys.readouterr().err
    assert ended.value.code == 2, message
    assert len(message.splitlines()) == 1, message
    assert len(message) < 1000
    return message


@pytest.mark.parametrize("content", [b"", b"a,b\n", b"pair,object\n1\n", b"\x00\n"])
def test_empty_and_broken_rows_are_refused_in_one_line(content, tmp_path, capsys):
    for packed in (content, gzip.compress(content)):
        (tmp_path / "rows.csv.gz").write_bytes(packed)
        assert "expected" in refused(capsys, "report", str(tmp_path))


@pytest.mark.parametrize(
    "config", ['{"config": 3}', '{"config": {"objects": {}}}', "[" * 20000, '{"a": ' + "1" * 5000 + "}"]
)
def test_configs_of_the_wrong_type_are_refused_in_one_line(config, tmp_path, capsys):
    write_table(tmp_path / "rows.csv.gz", [dict.fromkeys(COLUMNS, "1")])
    (tmp_path / "config.json").write_text(config)
    assert "config of" in refused(capsys, "report", str(tmp_path))


def test_names_are_no_markup(tmp_path):
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from rich.table import Table

    from reorient.cli.progress import table_console
    from reorient.reporting.style import STYLE, svg

    console, table = table_console(), Table()
    console.file = io.StringIO()
    table.add_column("x")
    table.add_row("[/b]x.onnx [red]:smile:")
    console.print(table)
    assert "[/b]x.onnx [red]:smile:" in console.file.getvalue()
    with mpl.rc_context(STYLE):
        figure = Figure()
        figure.text(0.5, 0.5, "a$^$b.onnx")
        assert svg(figure)


def test_meshes_that_would_become_one_file_are_refused(tmp_path, capsys):
    for name in ("a/x.obj", "a__x.obj"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(OBJ)
    message = refused(capsys, "objects", "make", str(tmp_path / "out"), "--meshes", str(tmp_path))
    assert "'a/x' and 'a__x' would both become a__x.ply: expected other names" in message


@pytest.mark.parametrize(("name", "content", "faces"), [("a.OBJ", OBJ, 4), ("a.stl", STL, 1)])
def test_comments_in_latin_1_need_no_further_package(name, content, faces, tmp_path, monkeypatch):
    for package in ("charset_normalizer", "chardet"):
        monkeypatch.setitem(sys.modules, package, None)
    comment = b"solid caf\xe9\n" + content.partition(b"\n")[2] if name.endswith("stl") else b"# caf\xe9\n" + content
    (tmp_path / name).write_bytes(comment)
    assert len(load_mesh(tmp_path / name).faces) == faces


@pytest.mark.parametrize(("suffix", "package"), [(".dae", "collada"), (".3mf", "lxml")])
def test_a_mesh_format_that_needs_a_package_names_it(suffix, package, tmp_path, monkeypatch):
    for missing in ("collada", "networkx", "lxml", "lxml.etree"):
        monkeypatch.setitem(sys.modules, missing, None)
    (tmp_path / f"a{suffix}").write_bytes(b"<x/>")
    with pytest.raises(ReorientError, match=rf"{package}.*expected that package, .* or another format"):
        load_mesh(tmp_path / f"a{suffix}")


@pytest.mark.parametrize(
    ("column", "cell"), [("pair", "1.5"), ("pair", "x"), ("qw", ""), ("confidence", "x"), ("noise_mm", "inf")]
)
def test_a_bad_cell_is_named(column, cell, tmp_path):
    good = dict.fromkeys(COLUMNS, "1")
    write_table(tmp_path / "rows.csv.gz", [good, good | {column: cell}])
    with pytest.raises(ReorientError, match=rf"{column} of object '1', pair .* is '{cell}': expected a"):
        read_rows(tmp_path)


@dataclass(frozen=True)
class Setting:
    x: object = 1.0


@pytest.mark.parametrize(
    "x", [10**5000, 10**400, 1e308, float("inf"), float("nan"), "1", [1], (1.0, 1e300)], ids=range(8)
)
def test_absurd_numbers_and_other_types_are_out_of_range(x):
    with pytest.raises(OutOfRange, match="expected") as refusal:
        check_range(Setting(x), "x")
    assert len(str(refusal.value)) < 300


@pytest.mark.parametrize(
    "words",
    [
        ("objects", "list", "--count", "99999999999"),
        ("evaluate", "OUT", "--pairs", "99999999999"),
        ("evaluate", "OUT", "--noise-mm", "1e308"),
        ("loops", "OUT", "--objects", "1000000", "--trials", "1000000"),
        ("evaluate", "OUT", "--workers", "99999999999"),
        ("objects", "montage", "OUT", "--size-px", "99999999"),
        ("loops", "OUT", "--faults", "1e-308", "--trials", "0"),
        ("loops", "OUT", "--trials", "[" * 20000),
        ("loops", "OUT", "--trials", "9" * 5000),
        ("9" * 5000, "OUT"),
        ("loops", "OUT", "--" + "x" * 5000),
        ("loops", "OUT", "x" * 5000),
    ],
    ids=range(12),
)
def test_huge_counts_and_sizes_are_refused_at_once(words, tmp_path, capsys):
    out = str(tmp_path / "out")
    message = refused(capsys, *(out if word == "OUT" else word for word in words))
    assert "expected" in message or "--help" in message


def test_a_message_names_a_long_name_in_short():
    assert len(str(unknown_name("object", "x" * 20000, [f"name {i}" for i in range(5000)]))) < 600


def test_an_estimator_named_twice_is_refused():
    """Its rows would count twice."""
    with pytest.raises(OutOfRange, match="expected each of them once"):
        Evaluation(estimators=("icp", "icp"))
    with pytest.raises(OutOfRange, match="expected each of them once"):
        Loops(systems=("gicp/direct", "gicp/direct"))


def test_characters_that_the_terminal_lacks_end_nothing(tmp_path, monkeypatch):
    (tmp_path / "tür.obj").write_bytes(OBJ)
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    main(["objects", "list", "--meshes", str(tmp_path)])
    assert raw.getvalue() == b"t?r\n"


def test_a_lone_surrogate_in_a_message_fits_every_file(tmp_path):
    words = in_words(RuntimeError("no frame \ud800"))
    assert words.encode().decode() == "RuntimeError: no frame \\ud800"
    write_table(tmp_path / "rows.csv.gz", [{"object": "\udcff"}])
    assert gzip.decompress((tmp_path / "rows.csv.gz").read_bytes()) == b"object\r\n\\udcff\r\n"


def test_suffixes_count_in_upper_case_too(tmp_path):
    np.save(tmp_path / "T.npy", np.eye(4))
    os.rename(tmp_path / "T.npy", tmp_path / "T.NPY")
    np.testing.assert_array_equal(read_hand_eye(tmp_path / "T.NPY"), np.eye(4))


@pytest.mark.parametrize("name", ["T.npy", "T.npz", "T.json", "T.yaml"])
@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00", b"[" * 20000, b'{"x": ' + b"9" * 5000 + b"}"]
)
def test_broken_transforms_are_refused_in_one_line(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ReorientError, match="expected") as refusal:
        read_hand_eye(tmp_path / name)
    assert len(str(refusal.value).splitlines()) == 1


@contextmanager
def full_disk(most_bytes):
    """No file grows beyond this size."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def measure(task):
    return {"rows": [{"task": str(task), "text": str(task) * 2000}]}


def test_a_full_disk_is_one_line_and_costs_nothing_that_was_measured(tmp_path):
    tasks = {str(k): k for k in range(6)}

    def run():
        return list(resumable(tmp_path, Setting(), tasks, measure, RowStore()))

    with pytest.raises(ReorientError, match=r"cannot write .*partial.jsonl.: File too large"), full_disk(9000):
        run()
    assert not list(tmp_path.glob("*.gz"))
    assert run()[0] == (4, 6)
    assert len(read_table_of(tmp_path)) == 6


def read_table_of(folder):
    with gzip.open(folder / "rows.csv.gz", "rt") as text:
        return text.read().splitlines()[1:]


def test_a_folder_that_cannot_be_written_is_named_in_one_line(tmp_path):
    """Not the temporary file or the lock that failed. Root may write everywhere else, but not in /proc."""
    with pytest.raises(ReorientError, match=r"cannot make folder '/proc/self/run'"):
        list(resumable_at("/proc/self/run"))
    with pytest.raises(ReorientError, match=r"cannot write '/proc/self/rows.csv.gz': "):
        write_table("/proc/self/rows.csv.gz", [{"a": 1}])
    with pytest.raises(ReorientError, match=r"cannot write '/proc/self/.lock': "), locked(Path("/proc/self/.lock")):
        pass


def resumable_at(folder):
    return resumable(Path(folder), Setting(), {"1": 1}, measure, RowStore(), Pool())


def test_a_lock_is_held_by_one(tmp_path):
    with (
        locked(tmp_path / ".lock"),
        pytest.raises(ReorientError, match="another process is writing into"),
        locked(tmp_path / ".lock"),
    ):
        pass
    with locked(tmp_path / ".lock"):
        pass


@pytest.mark.parametrize("line", ["[1]", "{", '{"rows": []}', '{"task": "1", "rows": 3}', "[" * 20000])
def test_a_broken_line_of_a_run_is_named(line, tmp_path):
    good = json.dumps({"task": "0"} | measure(0))
    (tmp_path / "partial.jsonl").write_text(f"{good}\n{line}\n")
    with pytest.raises(ReorientError, match=r"line 2 of .*partial.jsonl' is broken .*remove this line"):
        RowStore().done(tmp_path)
