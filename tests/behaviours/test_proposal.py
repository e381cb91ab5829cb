from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from behaviours.proposal import displacement, goal_id
from tests.mocks.skills import GOAL


@given(st.floats(-50, 50), st.floats(-50, 50))
def test_displacement_of_a_shifted_line_is_the_shift(u: float, v: float) -> None:
    assert np.isclose(displacement(GOAL.polyline, GOAL.polyline + np.array([u, v])), np.hypot(u, v), atol=1e-9)


def test_displacement_does_not_depend_on_how_many_points_the_lines_have() -> None:
    dense = np.column_stack([np.linspace(200.0, 400.0, 41), np.full(41, 240.0)])

    assert displacement(GOAL.polyline, dense) < 1e-9


def test_displacement_is_unknown_when_a_point_is() -> None:
    assert np.isnan(displacement(GOAL.polyline, GOAL.polyline * np.nan))


def test_a_goal_is_named_by_its_pixels() -> None:
    assert goal_id(GOAL.polyline) == goal_id(GOAL.polyline + 1e-4)
    assert goal_id(GOAL.polyline) != goal_id(GOAL.polyline + 0.5)
    assert goal_id(np.zeros((4, 2))) != goal_id(np.zeros((2, 2, 2)))
    assert len(goal_id(GOAL.polyline)) == 12
