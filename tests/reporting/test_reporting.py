import csv
import gzip
import io
import json
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from reorient.errors import ReorientError
from reorient.experiments.cells import COLUMNS
from reorient.experiments.evaluation import Evaluation
from reorient.reporting import (
    OVERLAP,
    figures,
    markdown_table,
    print_tables,
    read_rows,
    summarise,
    trust,
)
from reorient.reporting.rows import OPTIONAL


def row(error_deg: float, **cells: object) -> dict[str, str]:
    default = dict.fromkeys(COLUMNS, "0") | {
        "goal_views": "1",
        "object": "generated-0-000000",
        "world": "benchmark",
        "noise_mm": "0.0",
        "low_deg": "0",
        "high_deg": "30",
        "estimator": "gicp",
        "angle_deg": "12.5",
        "error_deg": str(error_deg),
        "error_sym_deg": str(error_deg),
        "qw": "1",
        "seconds": "0.02",
        "confidence": "",
        "message": "",
        "overlap": "",
    }
    return default | {name: str(value) for name, value in cells.items()}


def write_rows(folder: Path, rows: list[dict[str, str]]) -> Path:
    with gzip.open(folder / "rows.csv.gz", "wt", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    return folder


def write_config(folder: Path, config: Evaluation) -> None:
    asked = json.loads(json.dumps(asdict(config), default=str))
    (folder / "config.json").write_text(json.dumps({"config": asked, "version": "0", "commit": "<abc>"}))


# --- summaries ------------------------------------------------------------------------------------------------------


def test_summary_by_hand():
    errors_deg = [20.0, 0.5, 5.0, 1.0, 4.0]
    rows = [row(error, seconds=0.1 * index, error_sym_deg=0.25) for index, error in enumerate(errors_deg)]
    (summary,) = summarise(rows)
    assert (summary.estimator, summary.noise_mm, summary.low_deg, summary.high_deg, summary.n) == ("gicp", 0, 0, 30, 5)
    assert summary.mean_deg == pytest.approx(30.5 / 5)
    assert summary.median_deg == 4.0
    assert summary.rms_deg == pytest.approx(np.sqrt((400 + 0.25 + 25 + 1 + 16) / 5))
    assert summary.p90_deg == pytest.approx(5 + 0.6 * 15)
    assert (summary.within1, summary.within5) == (0.2, 0.6)  # 1 and 5 themselves are not below
    assert summary.within5_interval == pytest.approx((0.23072, 0.88238), abs=1e-5)
    assert summary.seconds == pytest.approx(0.2)
    (aware,) = summarise(rows, "error_sym_deg")
    assert (aware.mean_deg, aware.within1) == (0.25, 1.0)


@pytest.mark.parametrize(
    ("hits", "n", "interval"),
    [(0, 10, (0.0, 0.27753)), (10, 10, (0.72247, 1.0)), (81, 263, (0.25527, 0.36621))],  # the last: Newcombe 1998
)
def test_the_interval_is_wilsons(hits, n, interval):
    (summary,) = summarise([row(1.0 if index < hits else 9.0) for index in range(n)])
    assert summary.within5_interval == pytest.approx(interval, abs=2e-5)


def test_one_summary_for_each_cell_whatever_the_order_of_the_rows(rng):
    rows = [
        row(error, estimator=name, noise_mm=noise, low_deg=low, high_deg=low + 30)
        for error, (name, noise, low) in enumerate(
            (name, noise, low) for name in ("zeta", "alpha") for noise in (1.0, 0.0, 10.0) for low in (30, 0)
        )
        for _ in range(error + 1)
    ]
    summaries = summarise(rows)
    keys = [(s.noise_mm, s.low_deg, s.estimator) for s in summaries]
    assert keys == [(noise, low, name) for noise in (0, 1, 10) for low in (0, 30) for name in ("zeta", "alpha")]
    assert all(s.n == s.mean_deg + 1 for s in summaries)
    shuffled = [rows[index] for index in rng.permutation(len(rows))]
    assert sorted(summarise(shuffled), key=str) == sorted(summaries, key=str)


# --- reading --------------------------------------------------------------------------------------------------------


def test_rows_come_back(tmp_path):
    rows = [row(1.0, message='no, "really"'), row(2.0)]
    assert read_rows(write_rows(tmp_path, rows)) == rows


def test_rows_of_before_the_overlap_are_read(tmp_path):
    with gzip.open(tmp_path / "rows.csv.gz", "wt", newline="") as file:
        writer = csv.DictWriter(file, [name for name in COLUMNS if name not in OPTIONAL], extrasaction="ignore")
        writer.writeheader()
        writer.writerow(row(1.0))
    (old,) = read_rows(tmp_path)
    assert old == row(1.0) | dict.fromkeys(OPTIONAL, "")
    assert markdown_table([old]).count("gicp") == 1


def test_broken_folders_say_what_is_wrong(tmp_path):
    def said() -> str:
        with pytest.raises(ReorientError) as caught:
            read_rows(tmp_path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    file = tmp_path / "rows.csv.gz"
    assert "expected config.json and rows.csv.gz" in said()
    write_rows(tmp_path, [])
    assert "no rows" in said()
    write_rows(tmp_path, [row(x / 7) for x in range(300)])
    file.write_bytes(file.read_bytes()[:-200])
    assert "complete gzip" in said()
    file.write_text("object,pair")
    assert "complete gzip" in said()
    file.write_bytes(gzip.compress(b"object,pair,world\r\na,1,paper\r\n"))
    assert "no column noise_mm, low_deg" in said()
    write_rows(tmp_path, [row(1.0)])
    file.write_bytes(gzip.compress(gzip.decompress(file.read_bytes()) + b"generated-0-000001,3,bench\r\n"))
    assert said().startswith("line 3 of")


@pytest.mark.parametrize("value", ["", "nan", "inf", "much"])
def test_a_cell_without_a_number_is_named(value):
    with pytest.raises(ReorientError, match=r"error_deg of object 'mug', pair 7 is .*: expected a finite number"):
        summarise([row(1.0), row(0.0, object="mug", pair=7) | {"error_deg": value}])


# --- tables ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def rows() -> list[dict[str, str]]:
    return [
        row(error, estimator=name, noise_mm=noise, low_deg=low, high_deg=low + 30, angle_deg=low + 3 * error)
        for name in ("gicp", "a|b<c>")
        for noise in (0.0, 1.5)
        for low in (0, 150)
        for error in range(10)
    ] + [row(140.0, error_sym_deg=0.5, message="too few returns")]


def test_screen_tables_are_complete_in_120_columns(rows):
    screen = io.StringIO()
    print_tables(rows, Console(file=screen, width=120))
    text = screen.getvalue()
    assert text.count("depth noise") == 2
    assert text.count("a|b<c>") == 5  # in the rows, and in the note of the ellipsoids
    assert "50.0% (24–76)" in text
    assert "150–180°" in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 120


def test_overlap_divides_the_rows_in_quarters(rows):
    shares = {0.0: "0–25%", 0.2499: "0–25%", 0.25: "25–50%", 0.5: "50–75%", 0.75: "75–100%", 1.0: "75–100%"}
    known = [row(index, overlap=share, low_deg=60) for index, share in enumerate(shares)]
    for share, quarter in shares.items():
        (line,) = (x for x in markdown_table([row(9.0, overlap=share)], OVERLAP).splitlines() if "gicp" in x)
        assert line.startswith(f"| 0 mm | {quarter} | gicp | 1 | 9.00 |")
    table = markdown_table([*rows, *known], OVERLAP)  # those of before have none, and are left out
    assert table.splitlines()[0].startswith("| noise | overlap | estimator | pairs |")
    assert [line.split(" | ")[3] for line in table.splitlines()[2:6]] == ["2", "1", "1", "2"]
    assert "rays cast at the mesh" in table
    screen = io.StringIO()
    print_tables([*rows, *known], Console(file=screen, width=120))
    assert screen.getvalue().count("75–100%") == 1


# --- confidence -----------------------------------------------------------------------------------------------------


def test_reliability_and_risk_by_hand():
    said = np.array([0.95, 0.91, 0.55, 0.51, 0.05])
    right = np.array([True, True, False, True, False])
    bins = trust.reliability(said, right)
    assert [(x.low, x.n, x.hits, x.accuracy) for x in bins] == [(0.0, 1, 0, 0.0), (0.5, 2, 1, 0.5), (0.9, 2, 2, 1.0)]
    assert trust.calibration_error(bins) == pytest.approx((0.05 + 2 * 0.03 + 2 * 0.07) / 5)
    assert trust.risk(said, right) == pytest.approx([0, 0, 1 / 3, 1 / 4, 2 / 5])
    assert trust.reliability(np.ones(3), np.ones(3, bool))[0].high == 1  # certainty is in the last bin


def test_the_figure_shows_every_confident_estimator(rng):
    rows = [
        row(0.0, estimator=name, confidence=said, error_sym_deg=9 * (rng.random() > said))
        for name in ("default", "fast")
        for said in rng.random(200)
    ]
    sure = trust.confident([*rows, row(3.0)])
    assert sure == rows
    left, right = trust.figure(sure).axes
    curves = [line.get_ydata() for line in right.lines if line.get_linestyle() == "-"]
    assert [len(curve) for curve in curves] == [200, 200]
    assert [curve[-1] for curve in curves] == pytest.approx([0.5, 0.5], abs=0.1)
    errors = [float(text.get_text()) for text in left.get_legend().get_texts()]
    assert max(errors) < 0.12


def test_markdown_table(rows):
    lines = markdown_table(rows).splitlines()
    table = [line for line in lines if line.startswith("|")]
    assert len(table) == 2 + 8
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in table} == {13}
    assert "| 0 mm | 0–30° | gicp | 11 | 5.00 | 16.82 |" in table[2]
    assert "| 9.1% | 45.5% (21–72) | 54.5% | 20 |" in table[2]
    assert "(refused: gicp 1)" in lines[-1]
    assert "none was refused" in markdown_table(rows[:-1])


# --- figures --------------------------------------------------------------------------------------------------------


def test_histograms_hold_every_pair_of_each_estimator_and_panel(rows):
    figure = figures.error_histograms([*rows, row(180.0), row(0.0, noise_mm=1.5)])
    assert len(figure.axes) == 4  # two ranges, two noises
    outlines = [[bars for bars in axes.patches if not bars.get_fill()] for axes in figure.axes]
    assert [len(bars) for bars in outlines] == [2] * 4
    assert len({bars.get_edgecolor() for axes in outlines for bars in axes}) == 2  # two estimators
    for share, edges, _ in (bars.get_data() for axes in outlines for bars in axes):
        assert share.sum() == pytest.approx(1)
        assert np.allclose(np.diff(np.log(edges)), np.log(edges[1] / edges[0]))
    share, edges, _ = outlines[0][0].get_data()  # gicp without noise, 0–30°: 0 to 9, 140 and 180
    assert share[edges[:-1] > 9].sum() == pytest.approx(2 / 12)
