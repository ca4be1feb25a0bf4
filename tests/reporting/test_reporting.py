import base64
import csv
import gzip
import io
import json
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from reorient import Algorithm1, load_estimator, orient, so3
from reorient.controller import OrientResult
from reorient.errors import ReorientError
from reorient.experiments.evaluation import COLUMNS, Evaluation, regenerate
from reorient.formatting import format_share
from reorient.imaging import DepthImage
from reorient.registration import Evidence
from reorient.reporting import (
    OVERLAP,
    figures,
    markdown_table,
    print_tables,
    read_rows,
    summarise,
    trust,
    write_loop,
    write_report,
)
from reorient.reporting.loop import evidence_in_words
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import ObjectSource
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised


def row(error_deg: float, **cells: object) -> dict[str, str]:
    default = dict.fromkeys(COLUMNS, "0") | {
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
    write_rows(tmp_path, [row(1.0, overlap=0.3)])
    file = tmp_path / "rows.csv.gz"
    lines = gzip.decompress(file.read_bytes()).splitlines()
    file.write_bytes(gzip.compress(b"\r\n".join(line.rpartition(b",")[0] for line in lines)))
    (old,) = read_rows(tmp_path)
    assert old == row(1.0)
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
    assert text.count("a|b<c>") == 4
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


# --- pages ----------------------------------------------------------------------------------------------------------


def pictures_of(html: str) -> list[str]:
    """The addresses of all images; fails where the page would load anything from elsewhere."""
    assert not re.search(r"<(script|link|iframe|object)\b|@import|url\(", html)
    addresses = re.findall(r'(?:src|href)\s*=\s*"([^"]*)"', html)
    assert all(address.startswith("data:image/") for address in addresses)
    assert len(addresses) == html.count("<img ")
    return addresses


def decoded(address: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2]))), float)


def test_report_holds_everything_and_rotates_the_start_by_the_estimate(tmp_path):
    config = Evaluation(ObjectSource(count=2), ("gicp",), ranges_deg=((40, 60),), noise_mm=(0.0,), pairs=2)
    cell = {"low_deg": 40, "high_deg": 60}
    rows = [row(0.0, pair=index, object=f"generated-0-00000{index}", **cell) for index in (0, 1)]
    quat_wxyz = so3.quat_from_matrix(regenerate(config, rows[0])[0].R_goal_current)
    rows[0] |= {f"q{part}": str(x) for part, x in zip("wxyz", quat_wxyz, strict=True)}
    rows[1] |= {"error_deg": "47.5", "error_sym_deg": "46.25", "message": "gave <up>"}
    write_config(tmp_path, config)
    path = write_report(write_rows(tmp_path, rows))
    assert path == tmp_path / "report.html"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["config.json", "report.html", "rows.csv.gz"]
    html = path.read_text()
    charts, cards = pictures_of(html)[:3], pictures_of(html)[3:]
    assert all(address.startswith("data:image/svg") for address in charts)
    assert "Calibration of the confidence" not in html
    headings = ["Results", "Error against angle", "Error histograms", "Cumulative errors", "Best and worst pairs"]
    assert re.findall("<h2>(.*?)</h2>", html) == [*headings, "Configuration"]
    assert len(cards) == 4  # two worst, then two best
    assert "error 47.50°</b> (46.25° symmetry-aware)" in html
    assert "gave &lt;up&gt;" in html
    assert "&lt;abc&gt;" in html
    assert cards[0] == cards[3] != cards[1] == cards[2]

    def panels(card: str) -> list[np.ndarray]:
        pixels = decoded(card)
        step = (pixels.shape[1] - 240) // 2
        return [pixels[-240:, left : left + 240] for left in (0, step, 2 * step)]

    start, goal, rotated = panels(cards[1])
    assert np.abs(rotated - goal).mean() < 0.15 * np.abs(start - goal).mean()
    start, goal, rotated = panels(cards[0])  # no rotation: the start without its occluder
    assert np.abs(rotated - start).mean() < 0.5 * np.abs(rotated - goal).mean()


def test_report_shows_overlap_and_confidence_where_they_are_known(tmp_path):
    write_config(tmp_path, Evaluation(ObjectSource(meshes=tmp_path / "gone"), ("default",)))
    rows = [row(x, estimator="default", confidence=1 - x / 10, overlap=x / 10) for x in range(10)]
    html = write_report(write_rows(tmp_path, rows)).read_text()
    headings = re.findall("<h2>(.*?)</h2>", html)
    assert headings[:3] == ["Results", "By overlap of the views", "Calibration of the confidence"]
    assert '<td class="word">25–50%</td>' in html
    assert len(set(pictures_of(html))) == 4


def test_report_stands_without_the_meshes(tmp_path):
    write_config(tmp_path, Evaluation(ObjectSource(meshes=tmp_path / "gone"), ("gicp",)))
    rows = [row(x / 3, noise_mm=x % 2, angle_deg=x, object=f"o{x}", estimator=f"new{x % 3 % 2}") for x in range(30)]
    html = write_report(write_rows(tmp_path, rows)).read_text()
    assert len(set(pictures_of(html))) == 3
    assert html.count("no picture: no folder") == 16


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


@pytest.fixture(scope="module")
def loop() -> tuple[DepthImage, OrientResult, list[float]]:
    """Four moves of the share 0.6, ended by the limit."""
    rng = np.random.default_rng(3)
    mesh = ObjectSource(count=5).open().load("generated-0-000004")
    station = RenderedStation(mesh, load_world("benchmark"), randomised(), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    station.R_camera_object = so3.exp(np.radians([0.0, 24.0, 32.0])) @ R_goal
    errors_deg = [40.0]

    def follow(step: object) -> None:
        errors_deg.append(float(np.degrees(so3.angle_difference(R_goal, station.R_camera_object))))

    strategy = Algorithm1(max_images=4, eta=0.6)
    return goal, orient(station, goal, load_estimator("gicp"), strategy, subscribers=[follow]), errors_deg


def test_loop_is_drawn(tmp_path, loop):
    goal, result, errors_deg = loop
    gif, page = write_loop(tmp_path, goal, result, errors_deg, "A <chair>")
    assert (gif, page) == (tmp_path / "loop.gif", tmp_path / "loop.html")
    with Image.open(gif) as animation:
        assert animation.n_frames == len(result.steps) == 4
        assert animation.size[0] == 3 * 256 + 2 * 4
        first = np.asarray(animation.convert("RGB"), float)
        animation.seek(3)
        last = np.asarray(animation.convert("RGB"), float)
    goals, currents = slice(0, 256), slice(260, 516)
    assert np.abs(first[:, goals] - last[:, goals]).mean() < 0.5
    away, there = (np.abs(frame[30:, goals] - frame[30:, currents]).mean() for frame in (first, last))
    assert there < 0.7 * away
    html = page.read_text()
    stills, curve = pictures_of(html)
    assert curve.startswith("data:image/svg")
    start, middle, end = (decoded(stills)[-352:, left : left + 352] for left in (0, 357, 714))
    assert np.abs(end - middle).mean() < 0.7 * np.abs(start - middle).mean()
    assert "<title>A &lt;chair&gt;</title>" in html
    assert "Max images after 4 moves: limit of 4 images." in html
    assert f"The true remaining angle went from 40.00 to {errors_deg[-1]:.2f} deg." in html
    assert html.count("<tr>") == 1 + 4
    seen_deg = np.degrees(result.steps[0].estimate.angle_rad)
    assert f"<td>0</td><td>{seen_deg:.2f}°</td><td>40.00°</td><td>{0.6 * seen_deg:.2f}°</td>" in html


def test_loop_without_the_truth(tmp_path, loop):
    goal, result, _ = loop
    _, page = write_loop(tmp_path, goal, result, [], "robot")
    html = page.read_text()
    assert "true" not in html
    assert len(pictures_of(html)) == 2


def test_loop_refuses(tmp_path, loop):
    goal, result, errors_deg = loop
    with pytest.raises(ReorientError, match="3 errors for 4 steps: expected one for each image, or none"):
        write_loop(tmp_path, goal, result, errors_deg[:3], "")
    with pytest.raises(ReorientError, match=r"without a step \(no camera\)"):
        write_loop(tmp_path, goal, OrientResult((), "station_failed", "no camera"), [], "")
    with pytest.raises(ReorientError, match="existing folder"):
        write_loop(tmp_path / "gone", goal, result, errors_deg, "")
    assert not list(tmp_path.iterdir())


def test_evidence_in_words(loop):
    evidence = replace(loop[1].steps[0].estimate.evidence, converged=False)
    violations = evidence.free_space_violation + evidence.silhouette_violation
    assert evidence_in_words(evidence) == (
        f"inliers {format_share(evidence.inlier_ratio)} ({format_share(evidence.covisible_inlier_ratio)} of co-visible "
        f"points), violations {format_share(violations)}, occluded {format_share(evidence.occluded)}, residual "
        f"{1000 * evidence.residual_m:.1f} mm; registration not converged"
    )
    assert "residual - mm" in evidence_in_words(Evidence(0.0, 0.3, 0.7, 0.0, float("nan")))
