import colorsys

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.perception.colour import ColourRange, ColourTable, hsv_from_rgb


def pixels(hue_deg, saturation=0.6, value=0.7, n=400, spread=4.0, rng=None):
    rng = rng or np.random.default_rng(0)
    rgb = [colorsys.hsv_to_rgb(h % 360 / 360, saturation, value) for h in hue_deg + spread * rng.standard_normal(n)]
    return np.rint(255 * np.array(rgb)).astype(np.uint8)


def test_hsv_is_the_standard_library_s(rng):
    rgb = np.concatenate([rng.integers(0, 256, (300, 3)), np.eye(3) * 255, np.zeros((1, 3))]).astype(np.uint8)
    expected = np.array([colorsys.rgb_to_hsv(*(x / 255)) for x in rgb.astype(float)]) * [360, 1, 1]
    np.testing.assert_allclose(hsv_from_rgb(rgb), expected, atol=1e-9)


def test_hue_goes_round():
    around_red = ColourRange(hue_deg=(350.0, 10.0))
    red, green = pixels(0.0, spread=0.0, n=1), pixels(120.0, spread=0.0, n=1)
    assert around_red.contains(red).all()
    assert not around_red.contains(green).any()


@pytest.mark.parametrize("hue_deg", [0.0, 120.0, 235.0, 359.0])
def test_a_learned_range_holds_its_colours_and_no_other(hue_deg):
    learned = ColourRange.learned(pixels(hue_deg))
    assert learned.contains(pixels(hue_deg, rng=np.random.default_rng(1))).mean() > 0.85
    assert not learned.contains(pixels(hue_deg + 90)).any()
    assert learned.contains(pixels(hue_deg, value=0.2)).mean() > 0.8  # the light may change


def test_of_grey_only_saturation_is_learned():
    learned = ColourRange.learned(pixels(200.0, saturation=0.04))
    assert learned.hue_deg == (0.0, 360.0)
    assert learned.contains(pixels(20.0, saturation=0.03)).all()
    assert not learned.contains(pixels(200.0, saturation=0.5)).any()


@pytest.mark.parametrize(
    "limits",
    [{"hue_deg": (-10.0, 20.0)}, {"saturation": (0.5, 0.2)}, {"value": (0.0, 255.0)}, {"hue_deg": (0.0, 400.0)}],
)
def test_limits_that_are_none_are_refused(limits):
    with pytest.raises(ReorientError, match="expected degrees"):
        ColourRange(**limits)


def test_too_few_pixels_are_refused():
    with pytest.raises(ReorientError, match="3 pixels to learn a colour from: expected at least"):
        ColourRange.learned(pixels(0.0, n=3))


def test_a_table_tells_a_thing_of_two_colours_from_its_surroundings(rng):
    thing = np.concatenate([pixels(20.0, rng=rng), pixels(220.0, rng=rng)])
    table = ColourTable.learned(thing, pixels(120.0, n=2000, rng=rng))
    assert table.contains(pixels(20.0, rng=rng)).mean() > 0.9
    assert table.contains(pixels(220.0, rng=rng)).mean() > 0.9
    assert not table.contains(pixels(120.0, rng=rng)).any()
    assert not table.contains(pixels(300.0, rng=rng)).any()  # never seen


def test_a_table_of_what_looks_like_its_surroundings_holds_little(rng):
    table = ColourTable.learned(pixels(120.0, n=400, rng=rng), pixels(120.0, n=4000, rng=rng))
    assert table.contains(pixels(120.0, rng=rng)).mean() < 0.2


def test_with_nothing_around_a_table_holds_what_was_seen(rng):
    table = ColourTable.learned(pixels(120.0, rng=rng), np.zeros((0, 3), np.uint8))
    assert table.contains(pixels(120.0, rng=rng)).mean() > 0.9
