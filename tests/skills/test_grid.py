"""The keypoint grid: spacing, sides, edges, and an opening that is already there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skills.estimate.grid import GridConfig, grid_around, lengths
from skills.scene.segments import touch
from tests.skills.goals import straight, tracked_goal


def test_rows_lie_where_configured_and_none_on_the_goal() -> None:
    grid = grid_around(tracked_goal(straight()), 8.0)
    assert sorted(set(np.round(grid.points[:, 1] - 240, 6))) == [-35, -21, -7, 7, 21, 35]
    assert (grid.near_side == (grid.points[:, 1] < 240)).all()


def test_stations_are_even_and_keep_off_the_ends() -> None:
    config = GridConfig(station_spacing=8.0, end_inset=12.0)
    grid = grid_around(tracked_goal(straight(length=320)), 8.0, config)
    station = np.sort(grid.station[grid.crosses_goal])
    assert station[[0, -1]] == pytest.approx([12 / 320, 1 - 12 / 320])
    assert np.diff(station) == pytest.approx(grid.spacing)
    assert grid.spacing * 320 == pytest.approx(8.0, rel=0.05)


@given(st.integers(1, 4), st.floats(6, 20), st.floats(60, 400))
def test_the_crossing_edges_are_exactly_those_that_meet_the_goal(rows: int, spacing: float, length: float) -> None:
    goal = tracked_goal(straight(length=length))
    grid = grid_around(goal, 8.0, GridConfig(station_spacing=spacing, rows_per_side=rows))
    pieces = np.stack([goal.polyline[:-1], goal.polyline[1:]], axis=1)
    assert (touch(grid.points[grid.edges], pieces).any(axis=1) == grid.crosses_goal).all()
    assert np.isnan(grid.station[~grid.crosses_goal]).all()
    count = grid.crosses_goal.sum()
    assert len(grid.points) == 2 * rows * count
    assert len(grid.edges) == 2 * rows * (count - 1) + (2 * rows - 1) * count
    assert len({tuple(sorted(e)) for e in grid.edges.tolist()}) == len(grid.edges)


def test_an_opening_that_is_there_already_holds_no_keypoint() -> None:
    half = 8 + 15 * np.sin(np.linspace(0, np.pi, 41))  # rows 8 px from lips that gape by up to 30 px
    grid = grid_around(tracked_goal(straight(), half), 8.0)
    gape = np.interp(grid.points[:, 0], np.linspace(160, 480, 41), half - 8)
    assert (np.abs(grid.points[:, 1] - 240) >= gape + 6.9).all()


def test_lengths_are_distances() -> None:
    assert lengths(np.array([[0.0, 0.0], [3.0, 4.0]]), np.array([[0, 1]])) == pytest.approx([5.0])


def test_a_senseless_grid_is_refused() -> None:
    with pytest.raises(ValueError, match="positive"):
        GridConfig(row_spacing=0.0)
