from __future__ import annotations

import numpy as np
import pytest

from skills.tracking.placed import COMPANY, RADIUS, neighbours, placed
from skills.tracking.tracks import Tracks

SIZE = (200, 100)
NOTHING = np.zeros((SIZE[1], SIZE[0]), dtype=bool)
# Two rows of keypoints, one on each side of the goal.
AT = np.array([[40.0 + 10.0 * k, v] for v in (40.0, 54.0) for k in range(8)])
NEAR = np.arange(16) < 8
NEXT = neighbours(AT, NEAR)


def tracks(visible: np.ndarray, points: np.ndarray = AT) -> Tracks:
    return Tracks(0.0, points, visible, visible.astype(float))


def all_but(*hidden: int) -> np.ndarray:
    visible = np.ones(len(AT), dtype=bool)
    visible[list(hidden)] = False
    return visible


def test_a_keypoint_that_is_not_recognised_among_seen_ones_of_its_side_has_a_place() -> None:
    assert placed(tracks(all_but(3)), NEXT, NOTHING, SIZE).all()


def test_what_lies_under_a_tool_has_none() -> None:
    tool = NOTHING.copy()
    tool[30:50, 65:75] = True

    assert list(np.flatnonzero(~placed(tracks(all_but(3)), NEXT, tool, SIZE))) == [3]


def test_the_other_side_of_the_goal_says_nothing() -> None:
    assert not placed(tracks(~NEAR), NEXT, NOTHING, SIZE)[NEAR].any()


@pytest.mark.parametrize(("company", "known"), [(COMPANY - 1, False), (COMPANY, True)])
def test_a_few_seen_ones_around_are_needed(company: int, known: bool) -> None:
    around = np.flatnonzero(NEXT[3])[:company]
    visible = np.isin(np.arange(len(AT)), around)

    assert placed(tracks(visible), NEXT, NOTHING, SIZE)[3] == known


@pytest.mark.parametrize("place", [(np.nan, 10.0), (250.0, 40.0), (40.0, -1.0)])
def test_a_place_that_is_not_on_the_picture_is_none(place: tuple[float, float]) -> None:
    points = AT.copy()
    points[3] = place

    assert not placed(tracks(all_but(3), points), NEXT, NOTHING, SIZE)[3]


def test_neighbours_are_near_and_of_one_side() -> None:
    distance = np.linalg.norm(AT[:, None] - AT[None], axis=2)

    assert (NEXT == NEXT.T).all() and not NEXT.diagonal().any()
    assert distance[NEXT].max() <= RADIUS
    assert not NEXT[np.ix_(NEAR, ~NEAR)].any()
