from __future__ import annotations

import pytest
from py_trees.common import Status

from behaviours.board import CHECKLIST_PASSED
from behaviours.guard import Guard, no_trip, recorder_writing
from hardware.codes import Code
from hardware.gate import Verdict
from tests.mocks.stage import Stage, put

FINE = Verdict(True, message="1.2 N")
PASSING = Verdict(False, False, Code.CAMERA_STALE, "the newest image is 300 ms old")
LATCHED = Verdict(False, True, Code.TENSION_ABORT, "the tissue is pulled with 6.0 N")


def guarding(*verdicts: Verdict, once_checked: bool = False) -> Stage:
    stage, queue = Stage(), list(verdicts)
    stage.build(lambda services: Guard("a guard", services, lambda: queue.pop(0), once_checked=once_checked))
    return stage


def test_success_shows_the_reading() -> None:
    stage = guarding(FINE)

    assert stage.tick() is Status.SUCCESS
    assert stage.root.feedback_message == "1.2 N"


def test_a_passing_condition_is_waited_for_with_its_reason() -> None:
    stage = guarding(PASSING, PASSING, FINE)

    assert stage.tick(2) is Status.RUNNING
    assert stage.root.feedback_message == "holding: the newest image is 300 ms old"
    assert stage.gate.tripped is None
    assert stage.tick() is Status.SUCCESS


def test_each_wait_is_noted_once_with_its_code() -> None:
    stage = guarding(PASSING, PASSING, FINE, PASSING, PASSING, PASSING)

    for _ in range(6):
        stage.tick()

    told = {"guard": "a guard", "code": "camera_stale", "message": "the newest image is 300 ms old"}
    assert stage.noted("waiting") == [told, told]


def test_a_latched_condition_trips_the_gate_with_its_code() -> None:
    stage = guarding(LATCHED)

    assert stage.tick() is Status.FAILURE
    trip = stage.gate.tripped
    assert trip is not None and (trip.code, trip.message) == (LATCHED.code, LATCHED.message)


def test_a_check_that_raises_fails_closed() -> None:
    stage = guarding()

    assert stage.tick() is Status.FAILURE
    assert stage.gate.tripped is not None and stage.gate.tripped.code is Code.INTERNAL_ERROR


def test_before_the_checklist_arms_need_not_be_ready() -> None:
    stage = guarding(PASSING, PASSING, once_checked=True)

    assert stage.tick() is Status.SUCCESS
    put(CHECKLIST_PASSED, True)
    assert stage.tick() is Status.RUNNING


def test_before_the_checklist_a_fault_is_latched_all_the_same() -> None:
    assert guarding(LATCHED, once_checked=True).tick() is Status.FAILURE


def test_any_trip_and_the_emergency_stop_end_the_session() -> None:
    stage = Stage()
    assert no_trip(stage.gate).ok

    stage.bench.pressed = True
    assert no_trip(stage.gate).code is Code.EMERGENCY_STOP

    stage.gate.trip(Code.ARM_FAULT, "PSM1 has a fault")
    assert no_trip(stage.gate) == Verdict(False, True, Code.ARM_FAULT, "PSM1 has a fault")


@pytest.mark.parametrize(
    ("fault", "verdict"),
    [(None, Verdict(True)), ("the disk is full", Verdict(False, True, Code.RECORDER_FAILED, "the disk is full"))],
)
def test_a_record_that_cannot_be_written_is_latched(fault: str | None, verdict: Verdict) -> None:
    assert recorder_writing(fault) == verdict
