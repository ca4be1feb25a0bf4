"""Text of probabilities, shares and numbers."""

import math

import numpy as np
import pytest

from reorient.formatting import format_number, format_probability, format_share


@pytest.mark.parametrize(
    ("probability", "text"),
    [(0.9989, "99.9%"), (0.99996, "99.9%"), (1.0, "99.9%"), (0.997, "99.7%"), (0.0, "0.0%"), (0.123, "12.3%")],
)
def test_a_probability_is_never_certain(probability, text):
    assert format_probability(probability) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.304, "30%"), (0.86, "86%"), (0.9989, ">99%"), (0.994, "99%"), (0.002, "<1%"), (1.0, "100%"), (0.0, "0%")],
)
def test_a_share_is_0_or_100_percent_only_where_it_is_none_or_all(share, text):
    assert format_share(share) == text


@pytest.mark.parametrize("value", [None, math.nan, np.float64("nan")])
@pytest.mark.parametrize("function", [format_probability, format_share, format_number])
def test_a_missing_value_is_a_dash(function, value):
    assert function(value) == "-"


def test_numbers_have_the_decimals_asked_for():
    assert format_number(2.25) == "2.25"
    assert format_number(2.5, 3) == "2.500"
