from __future__ import annotations

import pytest
from py_trees.behaviours import StatusQueue
from py_trees.common import Status

from behaviours.board import ATTEMPT, LOOKED_AGAIN, Attempt, Step, read, result_of
from behaviours.look_again import LookAgain
from behaviours.session_outcome import StepResult
from hardware.codes import Code
from tests.mocks.stage import Stage, put


def looking(code: Code, *statuses: Status) -> Stage:
    stage = Stage()
    stage.build(lambda services: LookAgain("look", services, StatusQueue("child", list(statuses), statuses[-1])))
    put(ATTEMPT, Attempt(1, True, 0))
    put(result_of(Step.ESTIMATE), StepResult(1.0, code, "why"))
    return stage


def test_success_and_running_pass_through() -> None:
    stage = looking(Code.OK, Status.RUNNING, Status.SUCCESS)

    assert [stage.tick(), stage.tick()] == [Status.RUNNING, Status.SUCCESS]
    assert read(LOOKED_AGAIN) == 0


def test_too_many_unknown_edges_are_looked_at_once_more() -> None:
    stage = looking(Code.TOO_MANY_UNKNOWN, Status.FAILURE, Status.SUCCESS)

    assert [stage.tick(), stage.tick()] == [Status.RUNNING, Status.SUCCESS]
    assert read(LOOKED_AGAIN) == 1
    assert stage.noted("recovery") == [{"step": "look", "code": "too_many_unknown", "recovery": "expose and estimate anyway"}]


def test_but_only_once_in_an_attempt() -> None:
    stage = looking(Code.TOO_MANY_UNKNOWN, Status.FAILURE, Status.FAILURE)

    assert [stage.tick(), stage.tick()] == [Status.RUNNING, Status.FAILURE]


def test_an_interruption_gives_no_fresh_budget() -> None:
    stage = looking(Code.TOO_MANY_UNKNOWN, Status.FAILURE, Status.FAILURE)
    stage.tick()

    stage.root.stop(Status.INVALID)

    assert stage.tick() is Status.FAILURE


def test_the_next_attempt_may_look_again() -> None:
    stage = looking(Code.TOO_MANY_UNKNOWN, Status.FAILURE, Status.FAILURE, Status.FAILURE)
    stage.tick()
    stage.tick()
    put(ATTEMPT, Attempt(2, True, 0))

    assert stage.tick() is Status.RUNNING


@pytest.mark.parametrize("code", [Code.GRASP_SLIPPED, Code.INTERNAL_ERROR])
def test_looking_again_is_not_tried_where_it_cannot_help(code: Code) -> None:
    assert looking(code, Status.FAILURE).tick() is Status.FAILURE
