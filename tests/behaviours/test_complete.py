from __future__ import annotations

import numpy as np
import pytest
from py_trees.common import Status

from behaviours.board import ATTEMPT, ESTIMATE, INTERRUPTIONS, Attempt, Estimate
from behaviours.complete import Complete, what_is_left
from skills.estimate.graph import EdgeState
from tests.mocks.skills import graph
from tests.mocks.stage import Stage, put


def judged(estimate: Estimate | None, interruptions: int = 0) -> Stage:
    stage = Stage()
    stage.build(lambda services: Complete("complete?", services))
    put(ATTEMPT, Attempt(1, True, 0))
    put(INTERRUPTIONS, interruptions)
    put(ESTIMATE, estimate)
    stage.tick()
    return stage


def test_it_is_complete_when_every_edge_is_severed() -> None:
    assert judged(Estimate(graph(EdgeState.SEVERED), 1, 0)).root.status is Status.SUCCESS


@pytest.mark.parametrize("state", [EdgeState.CONNECTED, EdgeState.UNKNOWN])
def test_it_is_not_complete_while_an_edge_is_connected_or_unknown(state: EdgeState) -> None:
    stage = judged(Estimate(graph(state), 1, 0))

    assert stage.root.status is Status.FAILURE
    assert stage.root.feedback_message == "1 edge across the goal is not known to be severed"


def test_it_is_not_complete_without_an_estimate() -> None:
    assert judged(None).root.status is Status.FAILURE


def test_an_estimate_of_another_attempt_does_not_count() -> None:
    assert judged(Estimate(graph(EdgeState.SEVERED), 2, 0)).root.status is Status.FAILURE


def test_an_estimate_from_before_an_interruption_does_not_count() -> None:
    assert judged(Estimate(graph(EdgeState.SEVERED), 1, 0), interruptions=1).root.status is Status.FAILURE


def test_what_is_left_is_said_in_words() -> None:
    both = graph(EdgeState.CONNECTED)
    twice = type(both)(
        **{
            **vars(both),
            "edges": np.array([[0, 1], [1, 0]]),
            "state": np.array([0, 2]),
            "crosses_goal": np.array([True, True]),
        }
    )

    assert what_is_left(Estimate(twice, 1, 0)) == "2 edges across the goal are not known to be severed"
    assert what_is_left(None) == "nothing was seen that crosses the goal"
