"""The goal tracker: rows, grid, and robustness of the rows to wrong points."""

import numpy as np
import pytest

from skills.estimate.elongation import estimate_connectivity
from skills.estimate.graph import EdgeState
from skills.scene.goal import Goal
from skills.tracking.goal_tracker import GoalTracker, GoalTrackerConfig
from skills.tracking.rows import RowConfig, smooth_row
from tests.skills.pictures import SIZE, coloured, frame, opened, speckle

LINE = 120.0
GOAL = Goal(np.array([[70.0, LINE], [250.0, LINE]]), np.array([160.0, 80.0]), SIZE)


def test_the_goal_stays_in_the_middle_of_an_opening() -> None:
    texture = speckle(1)
    tracker = GoalTracker()
    first = tracker.start(frame(coloured(texture, 1.5, 0), 0), GOAL)
    for k in range(1, 11):
        picture, went = opened(texture, 2.0 * k, LINE)
        tracked = tracker.update(frame(coloured(picture, 1.5, k), k))
    assert np.abs(first.polyline[:, 1] - LINE).max() < 1e-9
    assert np.abs(tracked.polyline[:, 1] - LINE).max() < 1.0
    assert np.abs(tracked.near - went(first.near)).max() < 1.5
    assert np.abs(tracked.far - went(first.far)).max() < 1.5
    assert tracked.near[:, 1].max() < tracked.far[:, 1].min()
    assert tracked.visible.mean() > 0.9
    assert not tracked.lost
    assert np.isnan(tracked.strain)


def test_the_goal_is_lost_when_a_tool_covers_most_of_it_and_only_then() -> None:
    texture = speckle(2)
    for width, lost in ((60, False), (140, True)):
        tracker = GoalTracker()
        tracker.start(frame(coloured(texture), 0), GOAL)
        image = coloured(texture)
        image[60:180, 160 - width // 2 : 160 + width // 2] = (100, 102, 108)
        tracked = tracker.update(frame(image, 1))
        assert tracked.lost is lost
        hidden = np.abs(tracked.polyline[:, 0] - 160) < width / 2 - 4
        assert not tracked.visible[hidden].any()
        assert not tracked.grasp_visible
        assert np.abs(tracked.polyline[:, 1] - LINE).max() < 1.5


def test_an_opening_after_the_reference_severs_every_crossing_edge_and_no_other() -> None:
    texture = speckle(3)
    tracker = GoalTracker()
    tracker.start(frame(coloured(texture, 1.5, 0), 0), GOAL)
    grid = tracker.mark_reference(frame(coloured(texture, 1.5, 1), 1))
    for k in range(1, 11):
        tracker.update(frame(coloured(opened(texture, 2.0 * k, LINE)[0], 1.5, k), k + 1))
    reference, tracks, same_grid = tracker.grid_tracks()
    graph = estimate_connectivity(grid, reference, tracks)
    assert same_grid is grid
    assert graph.complete
    assert (graph.state[~grid.crosses_goal] == EdgeState.CONNECTED).mean() > 0.98


def test_the_keypoints_go_with_tissue_that_stretches() -> None:
    texture = speckle(4)
    tracker = GoalTracker()
    tracker.start(frame(coloured(texture, 1.0, 0), 0), GOAL)
    grid = tracker.mark_reference(frame(coloured(texture, 1.0, 1), 1))
    for k in range(1, 11):
        picture, went = opened(texture, 0.0, LINE, 0.015 * k)
        tracker.update(frame(coloured(picture, 1.0, k), k + 1))
    _, tracks, _ = tracker.grid_tracks()
    error = np.linalg.norm(tracks.points - went(grid.points), axis=1)
    assert tracks.visible.mean() > 0.9
    assert np.percentile(error[tracks.visible], 90) < 1.0


@pytest.mark.parametrize("cut", ["before the goal was drawn", "after it"])
def test_a_faint_slit_at_the_reference_is_one_if_the_goal_was_drawn_on_even_tissue(cut: str) -> None:
    even = speckle(4, contrast=0.1)
    slit = even.copy()
    slit[118:122, 100:220] *= 0.75
    tracker = GoalTracker()
    tracker.start(frame(coloured(even if cut == "after it" else slit), 0), GOAL)
    tracker.mark_reference(frame(coloured(slit), 1))
    tracker.update(frame(coloured(slit), 2))
    grid, gaps = tracker.grid(), tracker.gaps()
    assert grid is not None and gaps is not None
    u = 70.0 + 180.0 * grid.station[grid.crosses_goal]
    slits = gaps.slit()[grid.crosses_goal]
    inside, outside = (u > 106.0) & (u < 214.0), (u < 94.0) | (u > 226.0)
    assert (slits[inside] > 2.0).all() == (cut == "after it")
    assert (slits[inside] == 0.0).all() == (cut != "after it")
    assert (slits[outside] == 0.0).all()
    assert (gaps.parted() == 0.0).all()


def test_a_grid_marked_while_the_goal_is_lost_is_never_seen() -> None:
    texture = speckle(5)
    tracker = GoalTracker()
    tracker.start(frame(coloured(texture), 0), GOAL)
    covered = np.full((*SIZE[::-1], 3), (100, 102, 108), np.uint8)
    tracker.mark_reference(frame(covered, 1))
    tracker.update(frame(coloured(texture), 2))
    assert not tracker.grid_tracks()[1].visible.any()


def test_a_second_reference_forgets_the_first_grid() -> None:
    texture = speckle(6)
    tracker = GoalTracker()
    tracker.start(frame(coloured(texture), 0), GOAL)
    tracker.mark_reference(frame(coloured(texture), 1))
    moved, _ = opened(texture, 8.0, LINE)
    tracker.update(frame(coloured(moved), 2))
    grid = tracker.mark_reference(frame(coloured(moved), 3))
    reference, tracks, _ = tracker.grid_tracks()
    assert np.allclose(reference, tracks.points, atol=1e-9)
    upper = grid.points[grid.near_side]
    assert upper[:, 1].max() < LINE - 4 - 5


def test_wrong_order_of_calls_is_a_clear_error() -> None:
    tracker = GoalTracker(GoalTrackerConfig())
    with pytest.raises(RuntimeError, match="started"):
        tracker.update(frame(coloured(speckle(1)), 0))
    tracker.start(frame(coloured(speckle(1)), 0), GOAL)
    with pytest.raises(RuntimeError, match="mark_reference"):
        tracker.grid_tracks()


def test_single_wrong_points_do_not_bend_a_row() -> None:
    laid = np.column_stack([np.arange(0.0, 240.0, 8.0), np.full(30, 50.0)])
    true = laid + np.column_stack([np.zeros(30), 5 * np.sin(np.linspace(0, np.pi, 30))])
    points = true.copy()
    points[[4, 13, 22]] += [[25.0, -10.0], [0.0, 18.0], [-9.0, 9.0]]
    row, good = smooth_row(laid, points, np.ones(30, bool), np.ones(30), RowConfig())
    assert np.abs(row - true).max() < 0.6
    assert np.flatnonzero(~good).tolist() == [4, 13, 22]


def test_hidden_stretches_are_filled_in_along_the_row() -> None:
    laid = np.column_stack([np.arange(0.0, 240.0, 8.0), np.full(30, 50.0)])
    true = laid + np.column_stack([np.linspace(0, 3, 30), np.linspace(0, -6, 30)])
    visible = np.ones(30, bool)
    visible[12:17] = False
    points = np.where(visible[:, None], true, 0.0)
    row, good = smooth_row(laid, points, visible, np.ones(30), RowConfig())
    assert np.abs(row - true).max() < 0.5
    assert np.array_equal(good, visible)


def test_a_row_with_nothing_seen_keeps_the_trackers_positions() -> None:
    laid = np.column_stack([np.arange(0.0, 80.0, 8.0), np.full(10, 50.0)])
    row, good = smooth_row(laid, laid + 2.0, np.zeros(10, bool), np.zeros(10), RowConfig())
    assert np.array_equal(row, laid + 2.0)
    assert not good.any()
