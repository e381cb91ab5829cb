from __future__ import annotations

from typing import Any

import pytest
from py_trees.common import Status

from behaviours.begin_attempt import BeginAttempt
from behaviours.board import (
    ATTEMPT,
    CUTTING_BEGAN,
    ESTIMATE,
    INTERRUPTIONS,
    PLAN,
    VERDICT,
    Attempt,
    Estimate,
    Plan,
    Step,
    read,
    result_of,
)
from behaviours.session_outcome import SessionOutcome
from hardware.codes import Code
from skills.estimate.graph import EdgeState
from skills.replan.next_goal import NextGoal
from tests.mocks.skills import SEGMENTS, graph
from tests.mocks.stage import Stage, put


def beginning(**settings: Any) -> Stage:
    stage = Stage(**settings)
    stage.build(lambda services: BeginAttempt(Step.BEGIN_ATTEMPT, services))
    return stage


def test_attempts_are_counted_on_the_blackboard() -> None:
    stage = beginning()

    stage.tick()
    assert read(ATTEMPT) == Attempt(1, True, 0)
    stage.tick()

    assert read(ATTEMPT) == Attempt(2, True, 0)
    assert stage.noted("attempt")[-1] == {"number": 2, "limit": 3, "resumed": False, "cut": True}


def test_no_attempt_begins_beyond_the_limit() -> None:
    stage = beginning(max_attempts=2)

    assert [stage.tick() for _ in range(3)] == [Status.SUCCESS, Status.SUCCESS, Status.FAILURE]
    assert read(ATTEMPT).number == 2
    result = read(result_of(Step.BEGIN_ATTEMPT))
    assert result is not None and result.code is Code.ATTEMPTS_USED


def test_resuming_after_an_interruption_is_not_counted_and_looks_first() -> None:
    stage = beginning()
    stage.tick()
    put(CUTTING_BEGAN, True)
    put(INTERRUPTIONS, 1)

    assert stage.tick() is Status.SUCCESS
    assert read(ATTEMPT) == Attempt(1, False, 1)
    assert stage.root.feedback_message == "attempt 1 of 3 resumed, looking first"


def test_an_attempt_after_a_resumed_one_counts_and_cuts_again() -> None:
    stage = beginning()
    stage.tick()
    put(CUTTING_BEGAN, True)
    put(INTERRUPTIONS, 1)
    stage.tick()

    stage.tick()

    assert read(ATTEMPT) == Attempt(2, True, 1)


def test_an_attempt_after_one_that_could_plan_nothing_looks_first() -> None:
    stage = beginning()
    stage.tick()
    put(ESTIMATE, Estimate(graph(EdgeState.UNKNOWN), 1, 0))

    stage.tick()
    assert read(ATTEMPT) == Attempt(2, False, 0)
    assert stage.root.feedback_message == "attempt 2 of 3 begun, looking first"
    assert stage.noted("attempt")[-1] == {"number": 2, "limit": 3, "resumed": False, "cut": False}

    # The next one has an older estimate: the one before ended without looking.
    stage.tick()
    assert read(ATTEMPT) == Attempt(3, True, 0)


def test_an_attempt_after_one_that_made_a_plan_cuts() -> None:
    stage = beginning()
    stage.tick()
    put(ESTIMATE, Estimate(graph(EdgeState.CONNECTED), 1, 0))
    put(PLAN, Plan(NextGoal(Code.OK, "1 segment", SEGMENTS, ((0,),)), None, 0))

    stage.tick()

    assert read(ATTEMPT) == Attempt(2, True, 0)


def test_resuming_before_anything_was_cut_cuts() -> None:
    stage = beginning()
    stage.tick()
    put(INTERRUPTIONS, 1)

    stage.tick()

    assert read(ATTEMPT) == Attempt(1, True, 1)


def test_without_feedback_a_resumed_attempt_cuts() -> None:
    stage = beginning(feedback=False)
    stage.tick()
    put(CUTTING_BEGAN, True)
    put(INTERRUPTIONS, 1)

    stage.tick()

    assert read(ATTEMPT) == Attempt(1, True, 1)


@pytest.mark.parametrize("code", [Code.COMPLETE, Code.NOT_APPROVED])
def test_after_the_verdict_no_attempt_begins(code: Code) -> None:
    stage = beginning()
    put(VERDICT, SessionOutcome(code, "it is over"))

    assert stage.tick() is Status.FAILURE
    assert read(ATTEMPT).number == 0
