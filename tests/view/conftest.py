"""A loop, its record, and a real Chromium (Debian's)."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from reorient.cli import main
from reorient.cli.robot import Replay
from reorient.controller import OrientResult
from reorient.imaging import DepthImage

# WebGL in software, as a machine without a screen has no other
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def record(tmp_path_factory) -> Path:
    """The record of a loop at the simulated station, from 75 degrees."""
    folder = tmp_path_factory.mktemp("record")
    goal, station = str(folder / "goal.npz"), ["--station", "rendered", "--noise-mm", "1"]
    main(["capture", goal, *station])
    main(["orient", goal, *station, "--start-deg", "75", "--pose-seed", "0", "--record", str(folder / "run")])
    return folder / "run"


@pytest.fixture(scope="session")
def loop(record) -> tuple[DepthImage, OrientResult]:
    """The goal and the loop of the record."""
    return Replay(record).result()


@pytest.fixture(scope="session")
def browser() -> Iterator:
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium")
    assert path, "no chromium: expected `apt-get install chromium`"
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def page(browser) -> Iterator:
    """A page of 1200 px whose console must stay without an error."""
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    opened, errors = context.new_page(), []
    opened.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    opened.on("pageerror", lambda error: errors.append(str(error)))
    yield opened
    context.close()
    assert not errors


def canvas_pixels(canvas) -> np.ndarray:
    """What a canvas shows, (height, width, 3)."""
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB"), float)
