from __future__ import annotations

from typing import Any

import pytest
from py_trees.behaviours import StatusQueue
from py_trees.common import Status

from behaviours.attempts import Attempts
from behaviours.board import ATTEMPT, ESTIMATE, VERDICT, Attempt, Estimate, Step, read, result_of
from behaviours.session_outcome import SessionOutcome, StepResult
from hardware.codes import Code
from hardware.gate import Approval
from skills.estimate.graph import EdgeState
from tests.mocks.skills import graph
from tests.mocks.stage import Stage, put


def attempting(number: int, *statuses: Status, **settings: Any) -> Stage:
    stage = Stage(**settings)
    stage.build(lambda services: Attempts("attempts", services, StatusQueue("child", list(statuses), statuses[-1])))
    put(ATTEMPT, Attempt(number, True, 0))
    return stage


def failed(code: Code) -> None:
    put(result_of(Step.EXPOSE), StepResult(1.0, code, "why"))


def verdict() -> Code:
    outcome = read(VERDICT)
    assert outcome is not None
    return outcome.code


def test_a_running_attempt_is_running() -> None:
    stage = attempting(1, Status.RUNNING)

    assert stage.tick() is Status.RUNNING
    assert stage.root.feedback_message == "attempt 1 of 3"


def test_a_complete_goal_is_the_verdict() -> None:
    stage = attempting(2, Status.SUCCESS)
    put(ESTIMATE, Estimate(graph(EdgeState.SEVERED), 2, 0))

    assert stage.tick() is Status.SUCCESS
    assert verdict() is Code.COMPLETE
    assert stage.noted("verdict")[0]["code"] == "complete"


def test_an_attempt_that_left_something_is_followed_by_another() -> None:
    stage = attempting(1, Status.SUCCESS)
    put(ESTIMATE, Estimate(graph(EdgeState.CONNECTED), 1, 0))

    assert stage.tick() is Status.RUNNING
    assert read(VERDICT) is None


def test_a_failure_is_the_verdict_and_the_tools_may_still_be_lifted() -> None:
    stage = attempting(1, Status.FAILURE)
    failed(Code.NOT_APPROVED)

    assert stage.tick() is Status.SUCCESS
    assert verdict() is Code.NOT_APPROVED


@pytest.mark.parametrize("code", [Code.GRASP_SLIPPED, Code.GRASP_EMPTY, Code.NO_CANDIDATE])
def test_what_another_attempt_may_mend_is_tried_again_while_attempts_are_left(code: Code) -> None:
    stage = attempting(2, Status.FAILURE)
    failed(code)

    assert stage.tick() is Status.RUNNING
    put(ATTEMPT, Attempt(3, True, 0))
    assert stage.tick() is Status.SUCCESS
    assert verdict() is code


def test_without_feedback_the_last_attempt_is_unverified() -> None:
    stage = attempting(2, Status.SUCCESS, feedback=False, max_attempts=3)

    assert stage.tick() is Status.RUNNING
    put(ATTEMPT, Attempt(3, True, 0))
    assert stage.tick() is Status.SUCCESS
    assert verdict() is Code.UNVERIFIED


def test_the_verdict_stays_and_ends_the_approval() -> None:
    stage = attempting(1, Status.FAILURE)
    failed(Code.NOT_APPROVED)
    stage.gate.approve(Approval("goal", "the operator", 0, 0.0, 10.0))
    stage.tick()
    assert stage.gate.approval is None
    failed(Code.MOVE_TIMEOUT)

    stage.root.stop(Status.INVALID)

    assert stage.tick() is Status.SUCCESS
    assert read(VERDICT) == SessionOutcome(Code.NOT_APPROVED, "why")
    assert len(stage.noted("verdict")) == 1


def test_a_failure_without_a_reason_is_an_internal_error() -> None:
    stage = attempting(1, Status.FAILURE)

    stage.tick()

    assert verdict() is Code.INTERNAL_ERROR
