"""The figures of docs/method.md."""

import re
from pathlib import Path

import method_figures
import numpy as np
import pytest
from method_figures import figure_name
from PIL import Image

PAGE = Path(__file__).parents[2] / "docs" / "method.md"


@pytest.mark.skipif(not PAGE.is_file(), reason="a source distribution has no docs")
def test_the_page_shows_every_figure():
    shown = re.findall(r"\(method/([\w-]+)\.png\)", PAGE.read_text())
    assert shown == [figure_name(draw) for draw in method_figures.DRAWINGS]


def test_a_figure_is_the_same_each_time(tmp_path):
    pictures = []
    for index in range(2):
        path = tmp_path / f"{index}.png"
        method_figures.save(method_figures.draw_residuals(), path)
        pictures.append(np.asarray(Image.open(path).convert("RGB")))
    assert np.array_equal(*pictures)
    colours = {tuple(colour) for colour in pictures[0].reshape(-1, 3).tolist()}
    assert len(colours) > 10  # an empty figure has few
