from __future__ import annotations

import pytest
from py_trees.common import Status

from behaviours.board import Step, result_of
from behaviours.look_anyway import LookAnyway
from behaviours.session_outcome import StepResult
from hardware.codes import Code
from tests.mocks.stage import Stage, put


def judged(code: Code | None) -> Stage:
    stage = Stage()
    stage.build(lambda services: LookAnyway("look anyway?", services))
    put(result_of(Step.DISSECT), None if code is None else StepResult(0.0, code, "why"))
    stage.tick()
    return stage


@pytest.mark.parametrize("code", [Code.MOVE_TIMEOUT, Code.TENSION, Code.CUT_NOT_APPROVED, Code.GOAL_LOST])
def test_it_helps_to_look_after_a_cut_that_was_not_finished(code: Code) -> None:
    stage = judged(code)

    assert stage.root.status is Status.SUCCESS
    assert stage.noted("recovery") == [{"step": "dissect", "code": code, "recovery": "expose and estimate anyway"}]


@pytest.mark.parametrize("code", [Code.GRASP_EMPTY, Code.INTERNAL_ERROR, Code.BAD_INPUT])
def test_it_does_not_help_to_look_without_a_grasp_or_after_an_error(code: Code) -> None:
    assert judged(code).root.status is Status.FAILURE


def test_it_does_not_help_to_look_when_dissection_was_stopped_by_something_else() -> None:
    assert judged(None).root.status is Status.FAILURE
