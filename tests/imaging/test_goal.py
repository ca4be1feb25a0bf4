"""A goal checks what it is made of."""

from collections.abc import Callable

import numpy as np
import pytest

from reorient import Camera, DepthImage, Goal, GoalView, ReorientError
from reorient.imaging import as_goal

CAMERA = Camera(width=8, height=6, fx=10.0, fy=10.0, cx=4.0, cy=3.0)
IMAGE = DepthImage(np.full((6, 8), 0.5, np.float32), CAMERA)


def test_one_view_becomes_a_goal_and_a_goal_stays() -> None:
    goal = as_goal(IMAGE)
    assert goal.image is IMAGE
    assert goal.views == ()
    assert as_goal(goal) is goal


@pytest.mark.usefixtures("unchecked")
def test_views_become_a_tuple_of_floats() -> None:
    goal = Goal(IMAGE, [GoalView(IMAGE, np.eye(3, dtype=int), [0, 0, 1])])  # type: ignore[arg-type]
    (view,) = goal.views
    assert view.R_goal_view.dtype == float
    assert np.array_equal(view.t_goal_view_m, [0.0, 0.0, 1.0])  # type: ignore[arg-type]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (lambda: Goal(IMAGE.depth_m), "expected DepthImage"),
        (lambda: Goal(IMAGE, (IMAGE,)), "expected GoalView"),
        (lambda: GoalView(IMAGE.depth_m, np.eye(3)), "expected DepthImage"),
        (lambda: GoalView(IMAGE, -np.eye(3)), "rotation matrix"),
        (lambda: GoalView(IMAGE, [1, 0, 0]), "rotation matrix"),
        (lambda: GoalView(IMAGE, np.eye(3), [0, 0]), "three finite metres"),
        (lambda: GoalView(IMAGE, np.eye(3), [0, 0, np.nan]), "three finite metres"),
    ],
)
def test_wrong_parts_are_refused(wrong: Callable[[], object], expected: str) -> None:
    with pytest.raises(ReorientError, match=expected):
        wrong()
