"""Pages: what they embed is what was measured, whole, escaped, and from nowhere else. Browsers: tests/browser."""

import base64
import json
import re
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from test_reporting import row, write_config, write_rows

from reorient import Algorithm1, load_estimator, orient, so3
from reorient.controller import OrientResult, Step
from reorient.errors import ReorientError
from reorient.experiments.evaluation import Evaluation, regenerate
from reorient.formatting import format_share
from reorient.imaging import DepthImage
from reorient.registration import Evidence
from reorient.reporting import write_loop, write_report
from reorient.reporting.loop import evidence_in_words, write_estimate
from reorient.reporting.page import page
from reorient.reporting.report import write_figures, write_pair
from reorient.reporting.scenes import CLASSES, Compared, at_most, image_data
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import ObjectSource
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised

MOST_BYTES = 3_000_000


def data_of(html: str) -> Any:
    """What a page embeds; fails where it is too large or would load anything from elsewhere."""
    assert len(html.encode()) < MOST_BYTES
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    rest = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    assert not re.search(r"<(script|link|iframe|object)\b|@import|url\(|src=\"(?!data:)", rest)
    assert not re.search(r"<script[^>]*\bsrc", html)
    return json.loads(text)


def decoded(image: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Depth in metres and unknown pixels of an embedded image, as the page's script decodes them."""
    shape = image["height"], image["width"]
    low, high = np.frombuffer(zlib.decompress(base64.b64decode(image["data"])), np.uint8).reshape(2, *shape).astype(int)
    steps = np.cumsum(low + 256 * high, axis=1) % 65536
    return np.where(steps > 1, image["near_m"] + image["step_m"] * (steps - 2), 0), steps == 1


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


def test_an_image_survives_its_compact_form(loop):
    image = loop[0]
    unknown = ~image.valid & (np.arange(image.camera.width) < 30)
    image = replace(image, unknown=unknown)
    data = image_data(image)
    depth_m, seen_unknown = decoded(data)
    assert np.array_equal(depth_m > 0, image.valid)
    assert np.array_equal(seen_unknown, unknown)
    assert np.abs(depth_m - image.depth_m).max() <= data["step_m"] / 2 + 1e-6
    assert data["step_m"] < 3e-4
    assert (data["seen"], data["unknown"]) == (image.valid.sum(), unknown.sum())


def test_every_point_has_its_class(loop):
    """Of the points that the evidence samples, the classes have the shares of the evidence."""
    goal, result, _ = loop
    step = result.steps[0]
    (hypothesis,) = Compared(step.image, goal).of(step.estimate)
    every = [step.image.valid.sum(), goal.valid.sum()]
    assert [len(hypothesis.current_classes), len(hypothesis.goal_classes)] == every
    both = (hypothesis.current_classes, hypothesis.goal_classes)
    shares = np.mean([np.bincount(classes, minlength=4) / len(classes) for classes in both], axis=0)
    assert shares == pytest.approx([getattr(step.estimate.evidence, each.share) for each in CLASSES], abs=0.04)


def test_alternatives_keep_the_place_and_are_measured_anew(loop):
    goal, result, _ = loop
    step = result.steps[-1]
    R_other = so3.exp(np.radians([0.0, 0.0, 90.0])) @ step.estimate.R_goal_current
    answer, other = Compared(step.image, goal).of(replace(step.estimate, alternatives=((R_other, 0.25),)))
    middle_m = step.image.points().mean(axis=0)
    places_m = [each.R_goal_current @ middle_m + each.t_goal_current_m for each in (answer, other)]
    assert np.allclose(*places_m)
    assert other.probability == 0.25
    assert other.evidence.inlier_ratio < answer.evidence.inlier_ratio - 0.2


def test_loop_is_drawn(tmp_path, loop):
    goal, result, errors_deg = loop
    gif, path = write_loop(tmp_path, goal, result, errors_deg, "A <chair>")
    assert (gif, path) == (tmp_path / "loop.gif", tmp_path / "loop.html")
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
    html = path.read_text()
    shown = data_of(html)["loop"]
    assert [step["true_deg"] for step in shown["steps"]] == pytest.approx(errors_deg[:4], abs=1e-3)
    assert shown["end_deg"] == pytest.approx(errors_deg[4], abs=1e-3)
    for step, each in zip(result.steps, shown["steps"], strict=True):
        assert each["hypotheses"][0]["R"] == pytest.approx(step.estimate.R_goal_current.ravel(), abs=1e-6)
        assert each["image"]["seen"] == step.image.valid.sum()
    assert "<title>A &lt;chair&gt;</title>" in html
    assert "Max images after 4 moves: limit of 4 images." in html
    assert f"The true remaining angle went from 40.00 to {errors_deg[-1]:.2f} deg." in html
    seen_deg = np.degrees(result.steps[0].estimate.angle_rad)
    assert f"<td>0</td><td>{seen_deg:.2f}°</td><td>40.00°</td><td>{0.6 * seen_deg:.2f}°</td>" in html
    assert html.count("data:image/gif;base64,") == 1


def test_loop_without_the_truth(tmp_path, loop):
    goal, result, _ = loop
    _, path, figure = write_loop(tmp_path, goal, result, [], "robot", "pdf")
    html = path.read_text()
    shown = data_of(html)["loop"]
    assert shown["end_deg"] is None
    assert {step["true_deg"] for step in shown["steps"]} == {None}
    assert "<th>true</th>" not in html
    assert figure.read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_a_loop_of_40_images_is_written_in_time_and_small(tmp_path, loop):
    goal, result, _ = loop
    steps = tuple(replace(result.steps[k % 4], index=k, hypotheses=((np.eye(3), 1.5),)) for k in range(40))
    began = time.process_time()
    _, path = write_loop(tmp_path, goal, replace(result, steps=steps), [], "long")
    assert time.process_time() - began < 5
    assert len(data_of(path.read_text())["loop"]["steps"]) == 40


def test_loop_refuses(tmp_path, loop):
    goal, result, errors_deg = loop
    with pytest.raises(ReorientError, match="3 errors for 4 steps: expected one for each image, or none"):
        write_loop(tmp_path, goal, result, errors_deg[:3], "")
    with pytest.raises(ReorientError, match=r"without a step \(no camera\)"):
        write_loop(tmp_path, goal, OrientResult((), "station_failed", "no camera"), [], "")
    with pytest.raises(ReorientError, match="existing folder"):
        write_loop(tmp_path / "gone", goal, result, errors_deg, "")
    assert not list(tmp_path.iterdir())


EVIL = '</script><script>document.title="<!--bad"</script><img src=x onerror=alert(1)>'


def test_no_text_ends_its_element(tmp_path, loop):
    goal, result, _ = loop
    step: Step = replace(result.steps[0], message=EVIL, error=EVIL)
    spoiled = replace(result, steps=(step,), reason=EVIL, errors=(EVIL,))
    _, path = write_loop(tmp_path, goal, spoiled, [], EVIL)
    html = path.read_text()
    assert data_of(html)["loop"]["steps"][0]["message"] == EVIL
    assert EVIL not in html
    assert "<img src=x" not in html
    assert EVIL not in page(EVIL, EVIL, {EVIL: ""}, {EVIL: EVIL})


def test_estimate_page(tmp_path, loop):
    goal, result, _ = loop
    step = result.steps[0]
    estimate = replace(step.estimate, alternatives=((np.eye(3), 0.1),), warnings=("a <warning>",))
    html = write_estimate(tmp_path / "e.html", step.image, goal, estimate, "a to b").read_text()
    (shown,) = data_of(html)["loop"]["steps"]
    assert [each["label"] for each in shown["hypotheses"]] == ["answer", "alternative 1"]
    assert '<td class="word">alternative 1</td><td>0.00°</td>' in html
    assert shown["message"] == "a <warning>"
    assert "confidence not calibrated" in html


def evaluated(folder: Path) -> tuple[Evaluation, list[dict[str, str]]]:
    """Two pairs, of which the first has the truth for its answer and the second no rotation."""
    config = Evaluation(ObjectSource(count=2), ("gicp",), ranges_deg=((40, 60),), noise_mm=(0.0,), pairs=2)
    cell = {"low_deg": 40, "high_deg": 60}
    rows = [row(0.0, pair=index, object=f"generated-0-00000{index}", **cell) for index in (0, 1)]
    quat_wxyz = so3.quat_from_matrix(regenerate(config, rows[0])[0].R_goal_current)
    rows[0] |= {f"q{part}": str(x) for part, x in zip("wxyz", quat_wxyz, strict=True)}
    rows[1] |= {"error_deg": "47.5", "error_sym_deg": "46.25", "message": "gave <up>"}
    write_config(folder, config)
    write_rows(folder, rows)
    return config, rows


def test_report_holds_every_row_and_its_pair(tmp_path):
    config, rows = evaluated(tmp_path)
    path = write_report(tmp_path)
    assert path == tmp_path / "report.html"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["config.json", "report.html", "rows.csv.gz"]
    html = path.read_text()
    shown = data_of(html)["evaluation"]
    headings = ["Results", "Filter", "Charts", "Pair", "Best and worst estimates", "Configuration"]
    assert re.findall("<h2>(.*?)</h2>", html) == headings
    assert shown["columns"]["error"] == [0.0, 46.25]
    assert shown["columns"]["message"] == ["", "gave <up>"]
    assert "&lt;abc&gt;" in html
    assert shown["bins"] is None
    right, wrong = (shown["pairs"][str(key)] for key in shown["columns"]["key"])
    for pair in (right, wrong):
        answer, truth, *_ = pair["hypotheses"]
        assert (answer["label"], truth["label"]) == ("gicp", "truth")
        assert truth["shares"][0] > 0.4
    assert right["hypotheses"][0]["R"] == pytest.approx(right["hypotheses"][1]["R"], abs=1e-5)
    assert wrong["hypotheses"][0]["shares"][0] < wrong["hypotheses"][1]["shares"][0] - 0.1
    depth_m, _ = decoded(right["goal"])
    goal = at_most(regenerate(config, rows[0])[0].goal)
    assert depth_m[depth_m > 0].mean() == pytest.approx(goal.depth_m[goal.valid].mean(), abs=2e-3)


def test_report_embeds_no_more_pairs_than_asked_and_writes_any_other(tmp_path):
    evaluated(tmp_path)
    shown = data_of(write_report(tmp_path, pairs=1).read_text())["evaluation"]
    assert len(shown["pairs"]) == 1
    path = write_pair(tmp_path, 1)
    assert path.name == "pair-1.html"
    assert list(data_of(path.read_text())["evaluation"]["pairs"]) == ["1"]
    with pytest.raises(ReorientError, match="no pair 2 in .*: expected 0 to 1"):
        write_pair(tmp_path, 2)


def test_report_shows_overlap_and_confidence_where_they_are_known(tmp_path):
    write_config(tmp_path, Evaluation(ObjectSource(meshes=tmp_path / "gone"), ("default",)))
    rows = [row(x, estimator="default", confidence=1 - x / 10, overlap=x / 10) for x in range(10)]
    html = write_report(write_rows(tmp_path, rows)).read_text()
    assert re.findall("<h2>(.*?)</h2>", html)[:2] == ["Results", "By overlap of the views"]
    assert '<td class="word">25–50%</td>' in html
    shown = data_of(html)["evaluation"]
    (bins,) = shown["bins"]
    assert sum(each["n"] for each in bins) == 10
    assert {each["accuracy"] for each in bins} == {0.0, 1.0}
    assert "no images: no folder" in html
    assert shown["pairs"] == {}


def test_figures_for_papers(tmp_path):
    write_config(tmp_path, Evaluation(ObjectSource(meshes=tmp_path / "gone"), ("default",)))
    rows = [row(x, estimator="default", confidence=1 - x / 10) for x in range(10)]
    paths = write_figures(write_rows(tmp_path, rows), "svg")
    assert [path.name for path in paths] == [
        f"{name}.svg" for name in ("error-by-angle", "error-histograms", "cumulative-errors", "confidence")
    ]
    first = [path.read_bytes() for path in paths]
    assert all(b"<svg" in content for content in first)
    assert [path.read_bytes() for path in write_figures(tmp_path, "svg")] == first


def test_evidence_in_words(loop):
    evidence = replace(loop[1].steps[0].estimate.evidence, converged=False)
    violations = evidence.free_space_violation + evidence.silhouette_violation
    assert evidence_in_words(evidence) == (
        f"inliers {format_share(evidence.inlier_ratio)} ({format_share(evidence.covisible_inlier_ratio)} of co-visible "
        f"points), violations {format_share(violations)}, occluded {format_share(evidence.occluded)}, residual "
        f"{1000 * evidence.residual_m:.1f} mm; registration not converged"
    )
    assert "residual - mm" in evidence_in_words(Evidence(0.0, 0.3, 0.7, 0.0, float("nan")))
