from __future__ import annotations

import numpy as np
import pytest

from hardware.codes import Code
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.stretches import MOST_TOLD, attachments, located

C, S, U = EdgeState.CONNECTED, EdgeState.SEVERED, EdgeState.UNKNOWN


def graph(*states: EdgeState) -> ConnectivityGraph:
    """One edge across the goal for each state, evenly along it from its start to its end."""
    count = len(states)
    nothing = np.full(count, 0.5)
    return ConnectivityGraph(
        code=Code.OK,
        message="Judged.",
        reference=np.zeros((2, 2)),
        points=np.zeros((2, 2)),
        edges=np.zeros((count, 2), np.int64),
        elongation=nothing,
        state=np.array(states, dtype=np.int64),
        probability=nothing,
        crosses_goal=np.ones(count, dtype=bool),
        station=np.linspace(0.0, 1.0, count),
    )


def test_the_message_says_in_millimetres_where_the_goal_is_attached() -> None:
    told = located(graph(S, C, C, S, S, U, C, S, S, S, S), 20e-3)

    assert told.message == "Judged. Attached at 1.0 to 5.0, 11.0 to 13.0 mm along the goal."
    assert told.goal_length == 20e-3


def test_without_a_length_it_says_so_in_percent() -> None:
    told = located(graph(S, C, C, S, S, S, S, S, S, S, S), None)

    assert told.message == "Judged. Attached at 5 to 25 % of the goal."
    assert told.goal_length is None


@pytest.mark.parametrize("states", [(S, S, S), (S, U, S)])
def test_nothing_is_said_of_stretches_where_none_is_known_to_be_attached(states: tuple[EdgeState, ...]) -> None:
    assert attachments(graph(*states)) == []
    assert located(graph(*states), 20e-3).message == "Judged."


def test_many_stretches_are_not_all_told() -> None:
    told = located(graph(*[C, S] * (MOST_TOLD + 2)), 20e-3)

    assert told.message.endswith("mm along the goal and 2 more.")
    assert told.message.count(" to ") == MOST_TOLD
