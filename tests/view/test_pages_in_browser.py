"""Pages in a real browser: drag, slide, choose, scrub; sizes, themes and accessibility."""

from pathlib import Path

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe

from conftest import canvas_pixels
from reorient import so3
from reorient.cli import main
from reorient.experiments.evaluation import Evaluation, evaluate
from reorient.reporting import write_loop, write_report
from reorient.world.objects import ObjectSource

SERIOUS = {"serious", "critical"}


@pytest.fixture(scope="module")
def pages(tmp_path_factory, loop) -> dict[str, Path]:
    """A loop with alternatives and a hostile title, an evaluation, an estimate."""
    from dataclasses import replace

    folder = tmp_path_factory.mktemp("pages")
    goal, result = loop
    R = so3.exp(np.radians([0.0, 70.0, 0.0]))
    steps = [
        replace(step, estimate=replace(step.estimate, alternatives=((R @ step.estimate.R_goal_current, 0.2),)))
        for step in result.steps
    ]
    errors_deg = [float(np.degrees(step.estimate.angle_rad)) for step in steps]
    _, loop_page = write_loop(folder, goal, replace(result, steps=tuple(steps)), errors_deg, "<b>A</b> & co")
    config = Evaluation(ObjectSource(count=2), ("gicp", "fast"), ranges_deg=((0, 60),), noise_mm=(1.0,), pairs=4)
    for _ in evaluate(config, folder / "evaluation"):
        pass
    return {"loop": loop_page, "evaluation": write_report(folder / "evaluation")}


def opened(page, path: Path, anchor: str = ""):
    page.goto(f"file://{path}{anchor}")
    page.wait_for_function("document.documentElement.dataset.ready")
    return page


def test_the_loop_page_is_driven_by_mouse_and_keyboard(page, pages):
    opened(page, pages["loop"])
    assert page.title() == "<b>A</b> & co"
    canvas = page.locator(".plate canvas")
    before = canvas_pixels(canvas)
    assert before.std() > 10  # something is drawn
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 320, box["y"] + 250, steps=5)
    page.mouse.up()
    dragged = canvas_pixels(canvas)
    assert np.abs(dragged - before).mean() > 1
    align = page.get_by_label("from as captured to aligned")
    align.fill("0")
    assert np.abs(canvas_pixels(canvas) - dragged).mean() > 0.5
    assert align.get_attribute("aria-valuetext") == "as captured"
    align.fill("100")
    assert np.abs(canvas_pixels(canvas) - dragged).max() < 1
    canvas.focus()
    page.keyboard.press("ArrowLeft")
    assert np.abs(canvas_pixels(canvas) - dragged).mean() > 0.2


def test_alternatives_and_steps(page, pages, loop):
    opened(page, pages["loop"])
    read = page.locator(".read")
    angle_deg = np.degrees(loop[1].steps[0].estimate.angle_rad)
    assert f"answer: rotation by {angle_deg:.2f}°" in read.inner_text()
    inliers = page.locator(".legend li").first.inner_text()
    page.get_by_label("alternative 1").check()
    assert read.inner_text().startswith("alternative 1: rotation by")
    assert page.locator(".legend li").first.inner_text() != inliers
    step = page.get_by_label("step", exact=True)
    step.fill(str(len(loop[1].steps) - 1))
    page.wait_for_function("document.querySelector('.read').textContent.startsWith('answer')")
    assert loop[1].steps[-1].message in page.locator(".scrub p").inner_text()
    page.locator("[data-part=images] button").nth(1).click()
    assert step.input_value() == "1"


def test_a_ghost_is_chosen_by_a_click(page, pages):
    opened(page, pages["loop"])
    canvas = page.locator(".plate canvas")
    pixels, box = canvas_pixels(canvas), canvas.bounding_box()
    ghost = (pixels[..., 0] > 1.25 * pixels[..., 1]) & (pixels[..., 2] > 1.1 * pixels[..., 1]) & (pixels[..., 0] > 60)
    rows, columns = np.nonzero(ghost)
    page.mouse.click(box["x"] + np.median(columns), box["y"] + np.median(rows))
    page.wait_for_function("document.querySelector('.read').textContent.startsWith('alternative')")


def test_the_axis_of_the_errors_is_logarithmic_or_linear(page, pages):
    opened(page, pages["loop"])
    chart = page.locator("[data-part=curve]")
    ticks = chart.locator("svg text").all_inner_texts()
    chart.get_by_role("button", name="linear").click()
    assert chart.locator("svg text").all_inner_texts() != ticks
    assert chart.get_by_role("button", name="linear").get_attribute("aria-pressed") == "true"


def test_a_mark_of_the_evaluation_opens_its_pair(page, pages):
    opened(page, pages["evaluation"])
    chart = page.locator("[data-part=charts] .chart > svg").first
    chart.focus()
    page.keyboard.press("ArrowRight")
    named = page.locator("[data-part=charts] .named").first.inner_text()
    page.keyboard.press("Enter")
    page.locator("[data-part=pair] h3").first.wait_for()
    assert page.locator("[data-part=pair] h3").first.inner_text() == named
    page.get_by_label("truth").wait_for()
    assert "#row=" in page.url


def test_the_filter_counts_and_orders(page, pages):
    opened(page, pages["evaluation"])
    count = page.locator("[data-part=filter] .note")
    assert count.inner_text() == "8 of 8 estimates"
    page.get_by_label("estimator").select_option(label="gicp")
    assert count.inner_text() == "4 of 8 estimates"
    errors = [float(text[:-1]) for text in page.locator("tbody tr td:nth-child(7)").all_inner_texts()[-4:]]
    assert errors == sorted(errors, reverse=True)
    page.get_by_label("order").select_option("best")
    page.get_by_label("largest angle").fill("0")
    assert count.inner_text() == "0 of 8 estimates"


@pytest.mark.parametrize("name", ["loop", "evaluation"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_serious_accessibility_issue_at_any_width(browser, pages, name, scheme):
    context = browser.new_context(color_scheme=scheme)
    page = context.new_page()
    opened(page, pages[name], "#row=0" if name == "evaluation" else "")
    for width in (360, 768, 1440, 2560):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page).response["violations"]
    assert [(each["id"], each["nodes"][0]["html"]) for each in found if each["impact"] in SERIOUS] == []
    context.close()


def test_the_page_of_an_estimate(page, tmp_path, record):
    path = tmp_path / "estimate.html"
    main(["estimate", str(record / "000.npz"), str(record / "goal.npz"), "--explain", str(path)])
    opened(page, path)
    assert page.locator("[data-part=images] canvas").count() == 2
    assert page.locator(".scrub").is_hidden()
