"""Strategies by name."""

import pytest

from reorient import Algorithm1, Fusing, load_strategy
from reorient.controller import Strategy
from reorient.errors import ReorientError


def test_strategies_by_name():
    assert load_strategy() == load_strategy("fusing") == Fusing()
    assert load_strategy("fusing", max_moves=5) == Fusing(max_moves=5)
    assert load_strategy("algorithm1") == Algorithm1()
    assert load_strategy("direct", max_images=9) == Algorithm1(eta=1.0, max_images=9)
    assert all(isinstance(load_strategy(name), Strategy) for name in ("fusing", "algorithm1", "direct"))


@pytest.mark.parametrize(
    ("name", "settings", "expected"),
    [
        ("fusng", {}, "unknown strategy 'fusng'.*did you mean 'fusing'"),
        ("fusing", {"max_move": 3}, "setting of strategy 'fusing': 'max_move'.*did you mean 'max_moves'"),
        ("algorithm1", {"tolerance_rad": 1.0}, "setting of strategy 'algorithm1': 'tolerance_rad'"),
        ("algorithm1", {"eta": 1.5}, "expected K >= 1, 0 < eta <= 1"),
        ("fusing", {"max_images": 1}, "expected at least 2 images"),
        ("fusing", {"max_images": "many"}, "expected numbers"),
    ],
)
def test_unknown_names_settings_and_values_are_refused(name, settings, expected, unchecked):
    with pytest.raises(ReorientError, match=expected):
        load_strategy(name, **settings)
