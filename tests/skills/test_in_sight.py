"""After a pull the tissue is left where enough of what is still undecided can be seen."""

import numpy as np
import pytest

from skills.estimate.grid import grid_around
from skills.estimate.in_sight import last_in_sight
from skills.estimate.look import Look
from skills.tracking.tracks import Tracks
from tests.skills.test_planning import goal

GRID = grid_around(goal(), 18.0)
CROSSING = np.flatnonzero(GRID.crosses_goal)


def look(step: int, hidden: list[int], opened: list[int] | None = None, doubted: list[int] | None = None) -> Look:
    """After `step`: the near ends of these edges across the goal `hidden` or seen with little confidence, and these seen to part."""
    visible, confidence = np.ones(len(GRID.points), dtype=bool), np.ones(len(GRID.points))
    visible[GRID.edges[CROSSING[hidden], 0]] = False
    confidence[GRID.edges[CROSSING[doubted or []], 0]] = 0.1
    bed = np.zeros(len(GRID.edges))
    bed[CROSSING[opened or []]] = 4.0
    return Look(
        step, Tracks(float(step), GRID.points, visible, confidence), visible, bed, bed, bed, np.zeros(len(bed), dtype=bool)
    )


def test_the_last_step_is_kept_while_everything_is_in_sight():
    assert last_in_sight(GRID, [look(step, []) for step in range(1, 9)], 0.2, 2) == 8


MOST = list(range(len(CROSSING) // 2 + 1))


@pytest.mark.parametrize("how", ["hidden", "doubted"])
def test_tissue_that_hides_most_of_it_is_taken_back_to_before_it_did(how):
    lost = {"hidden": [], how: MOST}
    looks = [look(step, []) if step < 6 else look(step, **lost) for step in range(1, 9)]

    assert last_in_sight(GRID, looks, 0.2, 2) == 5


def test_a_few_hidden_edges_are_worth_no_way_back():
    looks = [look(step, []) if step < 6 else look(step, MOST[:-2]) for step in range(1, 9)]

    assert last_in_sight(GRID, looks, 0.2, 2) == 8


def test_edges_that_were_seen_to_part_may_be_hidden():
    opened = MOST[:-1]
    rest = [k for k in range(len(CROSSING)) if k not in opened]
    looks = [look(step, []) if step < 6 else look(step, opened, opened=opened) for step in range(1, 9)]

    assert last_in_sight(GRID, looks, 0.2, 2) == 8
    assert last_in_sight(GRID, [*looks, look(9, rest, opened=opened)], 0.2, 2) == 8


def test_it_goes_back_no_farther_than_the_least_step():
    looks = [look(step, [] if step == 1 else MOST) for step in range(1, 9)]

    assert last_in_sight(GRID, looks, 0.2, 2) == 8
    assert last_in_sight(GRID, looks, 0.2, 1) == 1


def test_a_pull_shorter_than_that_is_left_where_it_ended():
    assert last_in_sight(GRID, [look(1, []), look(2, MOST)], 0.2, 6) == 2
