from __future__ import annotations

from py_trees.behaviours import StatusQueue
from py_trees.common import Status

from behaviours.board import INTERRUPTIONS, read
from behaviours.procedure import Procedure
from hardware.codes import Code
from hardware.gate import Approval
from tests.mocks.stage import Stage


def proceeding(*statuses: Status) -> Stage:
    stage = Stage()
    stage.build(lambda services: Procedure("procedure", services, [StatusQueue("child", list(statuses), statuses[-1])]))
    stage.gate.approve(Approval("goal", "the operator", 0, 0.0, 10.0))
    return stage


def test_an_interruption_is_counted_and_withdraws_the_approval() -> None:
    stage = proceeding(Status.RUNNING)
    stage.tick()

    stage.root.stop(Status.INVALID)

    assert read(INTERRUPTIONS) == 1 and stage.gate.approval is None
    assert stage.noted("interruption") == [{"count": 1}]


def test_an_end_is_no_interruption() -> None:
    stage = proceeding(Status.SUCCESS)
    stage.tick()

    stage.root.stop(Status.INVALID)

    assert read(INTERRUPTIONS) == 0


def test_being_stopped_before_it_began_is_no_interruption() -> None:
    stage = proceeding(Status.RUNNING)

    stage.root.stop(Status.INVALID)

    assert read(INTERRUPTIONS) == 0 and stage.gate.approval is not None


def test_an_interruption_that_cannot_be_recorded_trips() -> None:
    stage = proceeding(Status.RUNNING)
    stage.tick()
    stage.notes_fail = True

    stage.root.stop(Status.INVALID)

    assert read(INTERRUPTIONS) == 1
    assert stage.gate.tripped is not None and stage.gate.tripped.code is Code.RECORDER_FAILED
