"""Goal coordinates: round trips, meaning, and what happens past the ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skills.tracking.goal_coordinates import from_goal_coordinates, to_goal_coordinates
from tests.skills.goals import straight, tracked_goal


def bent(curve: float, opening: float) -> tuple[np.ndarray, np.ndarray]:
    s = np.linspace(0, 1, 30)
    return np.column_stack([150 + 300 * s, 240 + curve * np.sin(np.pi * s)]), 8 + opening * np.sin(np.pi * s)


@given(st.floats(-40, 40), st.floats(0, 25), st.floats(-0.15, 1.15), st.floats(-1.5, 1.5))
def test_coordinates_survive_the_round_trip(curve: float, opening: float, station: float, lateral: float) -> None:
    goal = tracked_goal(*bent(curve, opening))
    given_coordinates = np.array([[station, lateral]])
    pixels = from_goal_coordinates(goal, given_coordinates)
    assert to_goal_coordinates(goal, pixels) == pytest.approx(given_coordinates, abs=1e-6)


@given(st.floats(-30, 30), st.floats(100, 500), st.floats(190, 290))
def test_pixels_survive_the_round_trip(curve: float, u: float, v: float) -> None:
    goal = tracked_goal(*bent(curve, 5.0))
    pixels = np.array([[u, v]])
    assert from_goal_coordinates(goal, to_goal_coordinates(goal, pixels)) == pytest.approx(pixels, abs=1e-5)


def test_mid_line_rows_and_ends_have_the_coordinates_they_are_named_for() -> None:
    goal = tracked_goal(straight())
    coordinates = to_goal_coordinates(goal, np.array([goal.polyline[0], goal.near[20], goal.far[-1]]))
    assert coordinates == pytest.approx(np.array([[0, 0], [0.5, 1], [1, -1]]), abs=1e-9)


def test_past_the_ends_the_goal_goes_straight_on() -> None:
    goal = tracked_goal(straight(length=320))
    assert to_goal_coordinates(goal, np.array([[512.0, 240.0], [128.0, 232.0]])) == pytest.approx(
        np.array([[-0.1, 0.0], [1.1, 1.0]]), abs=1e-9
    )


def test_a_segment_moves_with_the_tissue() -> None:
    before, after = tracked_goal(straight()), tracked_goal(straight(v=260.0), half=20.0)
    segment = np.array([[250.0, 240.0], [300.0, 236.0]])
    moved = from_goal_coordinates(after, to_goal_coordinates(before, segment))
    assert moved == pytest.approx(np.array([[250.0, 260.0], [300.0, 250.0]]), abs=1e-9)
