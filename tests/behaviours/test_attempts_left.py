from __future__ import annotations

from py_trees.common import Status

from behaviours.attempts_left import AttemptsLeft
from behaviours.board import ATTEMPT, ESTIMATE, Attempt, Estimate, Step, read, result_of
from hardware.codes import Code
from skills.estimate.graph import EdgeState
from tests.mocks.skills import graph
from tests.mocks.stage import Stage, put


def counting(number: int) -> Stage:
    stage = Stage(max_attempts=3)
    stage.build(lambda services: AttemptsLeft(Step.ATTEMPTS_LEFT, services))
    put(ATTEMPT, Attempt(number, True, 0))
    put(ESTIMATE, Estimate(graph(EdgeState.CONNECTED), number, 0))
    return stage


def test_success_while_attempts_are_left() -> None:
    stage = counting(2)

    assert stage.tick() is Status.SUCCESS
    assert stage.root.feedback_message == "1 of 3 attempts left"


def test_failure_after_the_last_attempt_says_what_is_left() -> None:
    stage = counting(3)

    assert stage.tick() is Status.FAILURE
    result = read(result_of(Step.ATTEMPTS_LEFT))
    assert result is not None and result.code is Code.ATTEMPTS_USED
    assert result.message == "all 3 attempts are used and 1 edge across the goal is not known to be severed"
