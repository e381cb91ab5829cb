"""A goal that jumped farther than flow can follow is searched for, and only found where it is."""

import cv2
import numpy as np
import pytest

from hardware.interface import Array
from skills.scene.goal import Goal
from skills.tracking.goal_tracker import GoalTracker
from skills.tracking.relocate import RelocateConfig, flowed, relocate
from tests.skills.pictures import SIZE, coloured, frame, speckle

ROW = np.column_stack([np.linspace(90.0, 230.0, 16), np.full(16, 110.0)])
NOTHING_HIDDEN = np.zeros((SIZE[1], SIZE[0]), dtype=bool)
GOAL = Goal(np.array([[90.0, 120.0], [230.0, 120.0]]), np.array([160.0, 80.0]), SIZE)


def moved(texture: Array, by: tuple[int, int]) -> Array:
    """The texture shifted by (u, v) pixels."""
    return np.roll(texture, (by[1], by[0]), axis=(0, 1))


@pytest.mark.parametrize("by", [(0, 0), (45, 30), (-60, -25)])
def test_a_row_is_found_where_the_tissue_sprang_to(by):
    texture = speckle(4)

    found = relocate(coloured(texture, 1.5, 0), coloured(moved(texture, by), 1.5, 1), ROW, NOTHING_HIDDEN, RelocateConfig())

    assert found is not None
    assert np.abs(found - ROW - by).max() < 1.5


def test_a_few_wrong_matches_are_put_aside():
    texture = speckle(5)
    picture = coloured(moved(texture, (30, 20)), 1.5, 1)
    picture[100:160, 150:180] = coloured(speckle(6))[100:160, 150:180]

    found = relocate(coloured(texture, 1.5, 0), picture, ROW, NOTHING_HIDDEN, RelocateConfig())

    assert found is not None
    assert np.abs(found - ROW - (30, 20)).max() < 3.0


def test_on_a_picture_of_something_else_nothing_is_found():
    assert relocate(coloured(speckle(7)), coloured(speckle(8)), ROW, NOTHING_HIDDEN, RelocateConfig()) is None


def test_matches_all_over_the_place_make_no_row():
    texture = speckle(11)
    before, now = coloured(texture), coloured(speckle(12))
    # What is beside each point turns up somewhere else: all of it is found, and none of it together.
    for k, (u, v) in enumerate(ROW[:, :].astype(int)):
        to = np.array([u + (37 * k) % 90 - 45, v + (53 * k) % 80 - 40])
        now[to[1] - 14 : to[1] + 15, to[0] - 14 : to[0] + 15] = before[v - 14 : v + 15, u - 14 : u + 15]

    assert relocate(before, now, ROW, NOTHING_HIDDEN, RelocateConfig()) is None
    anything = RelocateConfig(shrunk=0.0, stretched=np.inf)
    assert relocate(before, now, ROW, NOTHING_HIDDEN, anything) is not None


@pytest.mark.parametrize("share", [0.7, 1.4])
def test_a_row_that_shrank_or_stretched_is_found(share):
    texture = speckle(13)
    there = np.array([[share, 0.0, 160.0 * (1.0 - share)], [0.0, 1.0, 0.0]])
    now = cv2.warpAffine(texture, there, SIZE, borderMode=cv2.BORDER_REFLECT)
    config = RelocateConfig(radius=8, likeness=0.3)

    found = relocate(coloured(texture, 1.5, 0), coloured(now, 1.5, 1), ROW, NOTHING_HIDDEN, config)

    assert found is not None
    assert np.abs(found[:, 0] - (ROW[:, 0] * share + there[0, 2])).max() < 4.0


def test_under_a_tool_nothing_is_found():
    picture, hidden = coloured(speckle(9)), NOTHING_HIDDEN.copy()
    hidden[:, 80:210] = True

    assert relocate(picture, picture, ROW, hidden, RelocateConfig()) is None


ROWS = ROW, ROW + np.array([0.0, 30.0])
ALL_TISSUE = ~NOTHING_HIDDEN


def test_rows_are_found_by_flow_where_single_matches_go_astray():
    """Creased tissue: every few pixels go another way, so that no patch is nearly (0.95) alike as a whole, but nothing went far."""
    texture = speckle(14)
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=np.float32), np.arange(SIZE[1], dtype=np.float32))
    crease = 3.0 * np.sin(u / 6.0).astype(np.float32)
    now = cv2.remap(texture, u, v - crease, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    config = RelocateConfig(likeness=0.95)

    found = flowed(coloured(texture, 1.5, 0), coloured(now, 1.5, 1), ROWS, ALL_TISSUE, config)

    assert relocate(coloured(texture, 1.5, 0), coloured(now, 1.5, 1), ROW, NOTHING_HIDDEN, config) is None
    assert found is not None
    for row, there in zip(ROWS, found, strict=True):
        assert np.abs(there - row)[:, 0].max() < 1.5
        assert np.abs(there - row)[:, 1].max() < 4.5


@pytest.mark.parametrize("seed", range(16, 26))
def test_by_flow_nothing_is_found_on_another_picture(seed):
    """The way back agrees with the way there on half of all such pairs."""
    before, now = coloured(speckle(15), 1.5, 0), coloured(speckle(seed), 1.5, 1)

    assert flowed(before, now, ROWS, ALL_TISSUE, RelocateConfig()) is None


def test_by_flow_rows_are_found_only_where_there_is_tissue():
    texture, bed = speckle(15), ALL_TISSUE.copy()
    bed[100:125] = False
    before, now = coloured(texture, 1.5, 0), coloured(texture, 1.5, 1)

    assert flowed(before, now, ROWS, ALL_TISSUE, RelocateConfig()) is not None
    assert flowed(before, now, ROWS, bed, RelocateConfig()) is None


def test_a_lost_goal_is_followed_again_and_its_old_keypoints_stay_unseen():
    texture, tracker = speckle(10), GoalTracker()
    tracker.start(frame(coloured(texture, 1.5, 0), 0), GOAL)
    tracker.mark_reference(frame(coloured(texture, 1.5, 1), 1))
    sprung = moved(texture, (50, 40))

    seen = [tracker.update(frame(coloured(sprung, 1.5, k), k)) for k in range(2, 9)]

    assert seen[0].lost and not seen[-1].lost
    assert np.abs(seen[-1].polyline.mean(axis=0) - (160.0 + 50.0, 120.0 + 40.0)).max() < 3.0
    assert not tracker.grid_tracks()[1].visible.any()


def test_a_goal_that_is_nowhere_stays_lost():
    tracker = GoalTracker()
    tracker.start(frame(coloured(speckle(11), 1.5, 0), 0), GOAL)

    seen = [tracker.update(frame(coloured(speckle(12), 1.5, k), k)) for k in range(1, 9)]

    assert all(tracked.lost for tracked in seen)
