from __future__ import annotations

from py_trees.common import Status

from behaviours.board import CHECKLIST_PASSED, Step, read, result_of
from behaviours.checklist import Checklist
from hardware.codes import Code
from tests.mocks.skills import script
from tests.mocks.stage import Stage


def checking(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: Checklist(Step.CHECKLIST, services))
    return stage


def test_success_is_remembered_and_recorded_item_by_item() -> None:
    stage = checking()

    assert stage.tick(2) is Status.SUCCESS
    assert read(CHECKLIST_PASSED)
    assert stage.noted("checklist") == [{"code": "ok", "message": "all is ready", "items": ["arms", "camera"]}]


def test_failure_carries_the_code_and_is_not_remembered_as_passed() -> None:
    stage = checking(checklist="failed")

    assert stage.tick(2) is Status.FAILURE
    result = read(result_of(Step.CHECKLIST))
    assert result is not None and (result.code, result.message) == (Code.CHECKLIST, "the calibration is too old")
    assert not read(CHECKLIST_PASSED)


def test_it_runs_without_a_lease() -> None:
    stage = checking(checklist="running")

    assert stage.tick(2) is Status.RUNNING
    assert stage.gate.lease is None


def test_preempted_it_is_closed_and_commands_nothing() -> None:
    stage = checking(checklist="running")
    stage.tick(2)

    stage.root.stop(Status.INVALID)

    assert stage.skills.opened == [] and stage.bench.log == []


def test_a_later_failure_does_not_unmake_that_it_passed_once() -> None:
    stage = checking(checklist=["ok", "failed"])

    stage.tick(2)
    stage.tick(2)

    assert read(CHECKLIST_PASSED)
