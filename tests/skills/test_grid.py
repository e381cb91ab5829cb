"""The keypoint grid: spacing, sides, edges, and an opening that is already there, tracked or seen."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skills.estimate.grid import Grid, GridConfig, grid_around, lengths
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


# Where an opening is seen

OUTER = GridConfig().rows_per_side - 1


def plain(tissue: np.ndarray | None = None, **settings: int) -> tuple[Grid, np.ndarray]:
    """A grid around the straight goal, and its points by row across the goal and column along it."""
    config = GridConfig(**settings)
    grid = grid_around(tracked_goal(straight()), 8.0, config, tissue)
    return grid, grid.points.reshape(2 * config.rows_per_side, -1, 2)


def without(*boxes: tuple[int, int, int, int]) -> np.ndarray:
    """Tissue all over the picture but for openings of columns u0 to u1 and rows v0 to v1."""
    tissue = np.ones((480, 640), dtype=bool)
    for u0, u1, v0, v1 in boxes:
        tissue[v0:v1, u0:u1] = False
    return tissue


def opening(reach: int, sides: int = 0) -> np.ndarray:
    """An opening along the middle of the goal, `reach` [px] to the near side (-1), to the far side (1), or to both (0)."""
    return without((260, 380, 240 - (reach if sides <= 0 else 0), 240 + (reach if sides >= 0 else 0)))


def rim_of(tissue: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far [px] each point (N, 2) is from what is no tissue, along rows and columns of the picture; 0 in an opening."""
    off = np.argwhere(~tissue)[:, ::-1]
    return np.array([np.abs(off - np.rint(point)).max(axis=1).min() for point in points])


@pytest.mark.parametrize("tissue", [None, np.ones((480, 640), dtype=bool)], ids=["not asked", "whole"])
def test_on_whole_tissue_nothing_moves(tissue: np.ndarray | None) -> None:
    _, rows = plain(tissue)
    assert sorted(set(np.round(rows[..., 1].ravel() - 240, 6))) == [-35, -21, -7, 7, 21, 35]


def test_an_opening_that_keeps_off_every_keypoint_moves_none() -> None:
    _, rows = plain(opening(1))
    assert rows == pytest.approx(plain()[1])


@given(st.integers(2, 40), st.sampled_from([-1, 0, 1]))
def test_no_keypoint_lies_in_an_opening_or_on_its_rim(reach: int, sides: int) -> None:
    tissue = opening(reach, sides)
    grid, _ = plain(tissue)
    assert rim_of(tissue, grid.points).min() > GridConfig().rim


@pytest.mark.parametrize("rim", [0, 5, 9])
def test_keypoints_move_no_farther_than_to_the_rim(rim: int) -> None:
    tissue = opening(25)
    _, rows = plain(tissue, rim=rim)
    inside = (rows[0, :, 0] > 262 + rim) & (rows[0, :, 0] < 378 - rim)
    near, far = rows[OUTER, inside, 1], rows[OUTER + 1, inside, 1]
    assert near == pytest.approx(214 - rim, abs=1.0)
    assert far == pytest.approx(265 + rim, abs=1.0)


@pytest.mark.parametrize("sides", [-1, 1])
def test_a_column_moves_outwards_as_a_whole_and_only_on_its_side(sides: int) -> None:
    before, after = plain()[1], plain(opening(25, sides))[1]
    moved = after - before
    near, far = moved[: OUTER + 1], moved[OUTER + 1 :]
    here, there = (near, far) if sides < 0 else (far, near)
    assert (here == here[:1]).all()  # the rows of one side keep their distances
    assert (sides * here[0, :, 1] >= 0).all() and (sides * here[0, :, 1]).max() > 15
    assert (there == 0).all()
    assert (moved[..., 0] == 0).all()


def test_stations_beside_the_opening_stay_where_they_were() -> None:
    before, after = plain()[1], plain(opening(25))[1]
    rim = GridConfig().rim
    u = np.rint(before[0, :, 0])
    beside = (u < 260 - rim) | (u >= 380 + rim)
    assert beside.sum() > 10
    assert (after[:, beside] == before[:, beside]).all()
    assert (after[:, ~beside] != before[:, ~beside]).any(axis=(0, 2)).all()


def test_the_edges_and_the_closed_length_are_those_of_the_closed_goal() -> None:
    closed, opened = plain()[0], plain(opening(30))[0]
    assert (opened.edges == closed.edges).all()
    assert (opened.crosses_goal == closed.crosses_goal).all()
    assert np.array_equal(opened.station, closed.station, equal_nan=True)
    assert opened.closed_length == closed.closed_length
    assert lengths(opened.points, opened.edges[opened.crosses_goal]).max() > 60


@pytest.mark.parametrize("farthest", [20, 60])
def test_where_tissue_is_too_far_a_keypoint_is_left_where_it_was(farthest: int) -> None:
    reach = 7 + farthest + 3  # from the goal, the innermost rows being 7 px from it
    assert plain(opening(reach), farthest=farthest)[1] == pytest.approx(plain()[1])
    near_enough = opening(reach - 10)
    grid, _ = plain(near_enough, farthest=farthest)
    assert rim_of(near_enough, grid.points).min() > GridConfig().rim


def test_without_any_tissue_the_grid_is_as_the_goal_gives_it() -> None:
    assert plain(np.zeros((480, 640), dtype=bool))[1] == pytest.approx(plain()[1])


def test_keypoints_are_not_moved_off_the_picture() -> None:
    goal = tracked_goal(straight(v=20.0))
    tissue = np.ones((480, 640), dtype=bool)
    tissue[:, 260:380] = False
    assert (grid_around(goal, 8.0, None, tissue).points == grid_around(goal, 8.0).points).all()


def test_on_a_curved_goal_columns_move_along_its_normal() -> None:
    t = np.linspace(0.0, 1.0, 41)
    goal = tracked_goal(np.column_stack([480.0 - 320.0 * t, 240.0 - 60.0 * np.sin(np.pi * t)]))
    tissue = cv2.polylines(np.ones((480, 640), np.uint8), [goal.polyline.round().astype(np.int32)], False, 0, 30) > 0
    before, after = grid_around(goal, 8.0), grid_around(goal, 8.0, None, tissue)
    moved = (after.points - before.points).reshape(2 * (OUTER + 1), -1, 2)
    across = (before.points.reshape(moved.shape)[0] - before.points.reshape(moved.shape)[-1])[None]
    across = across / np.linalg.norm(across, axis=2, keepdims=True)
    sign = np.where(np.arange(len(moved)) <= OUTER, 1.0, -1.0)[:, None]
    along = (moved * across).sum(axis=2) * sign
    assert (along > 8.0).all()
    assert np.linalg.norm(moved, axis=2) == pytest.approx(along, rel=0.02)
    assert rim_of(tissue, after.points).min() >= GridConfig().rim
